"""What a system may touch: its parameter list is the declaration, and nothing else is reachable.

=============== =====================================================================================
annotation      the kernel receives, for one world
=============== =====================================================================================
Read[C]         the table of component C, read-only: a kernel that writes it does not compile
Write[C]        the table of C, to read and write
Add[C]          the table of C, only ever added to (additions of integers commute, so order is free)
Rows[A, B]      int32 rows of the entities whose archetype has all of A, B; where there are none, the system
                is dormant: it is not scheduled (so an item mechanic names Rows[Item] even if it needs no list)
Bits[A, B]      the same as sets of sixteen rows each: int32 words, bit j of word g is row 16 g + j (see ecs.lanes)
Rank[A, B]      the same as int32 by row: the row's index in Rows[A, B], -1 if it is not there
Random          the key of this system's random stream in this world, episode and tick
Scratch         this thread's memory, from the module's scratch()
Cause           the number of the module's own cause of harm
int float bool  the module's number of the same name
tuple[float..]  the module's numbers of the same name, as a read-only float32 array
=============== =====================================================================================
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Generic, TypeVar, TypeVarTuple, get_args, get_origin, get_type_hints

from .component import Component
from .errors import DeclarationError

C = TypeVar("C")
Parts = TypeVarTuple("Parts")

Read = Annotated[C, "read"]
Write = Annotated[C, "write"]
Add = Annotated[C, "add"]
Random = Annotated[Any, "random"]
Scratch = Annotated[Any, "scratch"]
Cause = Annotated[int, "cause"]


class Rows(Generic[*Parts]):
    """Rows of all entities that have every one of the named components (an int32 array in the kernel)."""

    size: int

    def __getitem__(self, index: int) -> Any:
        raise NotImplementedError("Rows is an annotation; kernels get an int32 array")

    def __iter__(self) -> Any:
        raise NotImplementedError("Rows is an annotation; kernels get an int32 array")


class Bits(Rows[*Parts]):
    """Sets of rows of all entities that have every one of the named components (an int32 array in the kernel)."""


class Rank(Rows[*Parts]):
    """By row, the index in Rows of the same components (an int32 array in the kernel)."""


SELECTIONS: dict[Any, str] = {Rows: "rows", Bits: "bits", Rank: "rank"}


@dataclass(frozen=True)
class Parameter:
    """One parameter of a system: `kind` is read/write/add/rows/bits/rank/random/scratch/cause/number/numbers."""

    name: str
    kind: str
    components: tuple[type[Component], ...] = ()
    type: type = object  # of a number: int, float, bool or tuple


def parameters(function: Callable[..., Any]) -> tuple[Parameter, ...]:
    """Read the declaration off a function; an annotation that means nothing here is a DeclarationError."""
    hints = get_type_hints(function, include_extras=True)
    return tuple(_parameter(function, name, hints.get(name)) for name in inspect.signature(function).parameters)


def _parameter(function: Callable[..., Any], name: str, hint: Any) -> Parameter:
    if get_origin(hint) is Annotated:
        inner, kind = get_args(hint)[:2]
        return Parameter(name, kind, (inner,) if kind in ("read", "write", "add") else ())
    if get_origin(hint) in SELECTIONS:
        return Parameter(name, SELECTIONS[get_origin(hint)], get_args(hint))
    if hint in (int, float, bool):
        return Parameter(name, "number", type=hint)
    if get_origin(hint) is tuple:
        return Parameter(name, "numbers", type=tuple)
    raise DeclarationError(
        f"{function.__module__}.{function.__qualname__}: parameter '{name}' is annotated {hint!r}; "
        "allowed are Read[C], Write[C], Add[C], Rows[A, ...], Bits[A, ...], Rank[A, ...], Random, Scratch, Cause, int, "
        "float, bool, tuple"
    )
