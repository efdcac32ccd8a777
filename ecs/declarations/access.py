"""Access declarations: the annotations of a system's parameters. They name everything that the system can access.

=============== =====================================================================================
annotation      the kernel receives, for one world
=============== =====================================================================================
Read[C]         the table of component C, read-only: writing to it is an error (checks.trial)
Write[C]        the table of C, to read and write
Add[C]          the table of C, for sums only: column[...] += integer, or -=; anything else is an error. Sums of
                integers do not depend on the order, so systems that add may run in any order
Rows[A, B]      int32 rows of the entities whose archetype has all of A, B; without any, the system is not
                scheduled (so an item mechanic takes Rows[Item] even if it does not need the list)
Bitset[A, B]    the same as a bitset: an int32 for each block of 16 rows; bit j of block b is row 16 b + j (see simd)
RowIndex[A, B]  the inverse of Rows[A, B], int32 by row: the row's index in Rows[A, B], -1 for other rows
Random          the key of this system's random stream in this world, episode and tick
Scratch         memory of this thread, from the module's scratch()
Offset          the first column of an observation's field, named by the parameter, KEY_FIELD: own_stamina is
                for the field "stamina" in the rows "own". Next to Read or Write of the observation, Offsets
                declare that the system touches only these fields; systems that touch different fields may run
                in any order
int float bool  the module's number of the same name, or another module's by its full name, as in physics_rate: float
tuple[float..]  the same for several numbers, as a read-only float32 array
... | None      one of the first six, or None in a scenario that lacks the component; also in a Service. If `table`
                is a parameter, code guarded by `if table is not None:` is then not part of the machine code
                and costs nothing
Label           the number of the module's label of a kind, as Annotated[int, Label("damage_type")]: see there
Service         a value made of other parameters, as Annotated[..., Service(function)]: see there
=============== =====================================================================================
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Generic, TypeVar, TypeVarTuple, Union, get_args, get_origin, get_type_hints

import numpy as np

from ..kernels.errors import DeclarationError
from ..kernels.jit import Array, kernel
from .component import Clock, Component, Singleton
from .event import Event

C = TypeVar("C")
Parts = TypeVarTuple("Parts")

Read = Annotated[C, "read"]
Write = Annotated[C, "write"]
Add = Annotated[C, "add"]
Random = Annotated[Any, "random"]
Scratch = Annotated[Any, "scratch"]
Offset = Annotated[int, "offset"]


class Rows(Generic[*Parts]):
    """Rows of all entities that have every one of the named components (an int32 array in the kernel)."""

    size: int

    def __getitem__(self, index: int) -> Any:
        raise NotImplementedError("Rows is an annotation; kernels get an int32 array")

    def __iter__(self) -> Any:
        raise NotImplementedError("Rows is an annotation; kernels get an int32 array")


class Bitset(Rows[*Parts]):
    """The rows of all entities that have every one of the named components, as a bitset (int32 array in the kernel)."""


class RowIndex(Rows[*Parts]):
    """The inverse of Rows: by row, its index in Rows of the same components (an int32 array in the kernel)."""


SELECTIONS: dict[Any, str] = {Rows: "rows", Bitset: "bitset", RowIndex: "row_index"}
ANNOTATED = ("random", "scratch", "offset")
PARTS = ("read", *SELECTIONS.values(), "number", "numbers")  # kinds of the parameters that services are made of


@dataclass(frozen=True)
class Parameter:
    """One parameter of a system.

    `kind`: an annotation of the table above in snake case, "number" or "numbers"; "none" for an optional one that a
    scenario lacks.
    """

    name: str
    kind: str
    components: tuple[type[Component], ...] = ()
    type: type = object  # the type of a number: int, float, bool or tuple
    optional: bool = False  # whether the kernel takes None where the scenario lacks the component
    service: "Service | None" = None
    parts: tuple["Parameter", ...] = ()  # the service's own parameters
    label: str = ""  # the class attribute of a Label

    def with_parts(self) -> tuple["Parameter", ...]:
        """Return the parameter and, for a service, its own parameters."""
        return self, *(replace(p, name=f"{self.name}.{p.name}") if p.components else p for p in self.parts)

    def among(self, brings: Callable[["Parameter"], bool]) -> "Parameter":
        """Return the parameter in a scenario: `brings` returns whether a parameter has its component there."""
        if self.optional and not brings(self):
            return Parameter(self.name, "none")
        return replace(self, parts=tuple(part.among(brings) for part in self.parts)) if self.parts else self


@dataclass(frozen=True)
class Label:
    """A kind of names of mechanics, which systems get as numbers: Kind = Annotated[int, Label("damage_type")].

    The number of a mechanic's label is its index among those of all mechanics of a scenario in alphabetical order, see
    Layout.labels. Their count is the dimension of the plural, "damage_types".

    Args:
        attribute: The class attribute of mechanics with the label; a mechanic may lack it.
    """

    attribute: str
    kinds: ClassVar[dict[str, str]] = {}  # of all labels: the dimension by attribute

    def __post_init__(self) -> None:
        self.kinds[self.attribute] = f"{self.attribute}s"


@dataclass(frozen=True, eq=False)
class Service:
    """A parameter that the engine makes out of other parameters: Seconds = Annotated[Real, Service(length)].

    Without `memory`, the system gets the result of `function`.

    With `memory`, it gets a named tuple of arrays, the first argument of `function`, which fills it before each system
    that takes the service, in each world; without `function`, the system fills it. It is memory of the thread, which
    stays in its fastest cache, and not part of a world's state. A field of the tuple with the name of a parameter of
    `function` is that parameter, so that the first kernel that needs the memory can fill it; `function` then runs
    `behind` each system, and clears the filled parts.

    Args:
        function: A function that kernels can call. Its parameters after the named tuple are annotated like those of
            systems: Read, Rows, Bitset, RowIndex, and numbers.
        memory: A function from sizes by dimension to the named tuple, with None for parameters. Numbers do not
            affect it.
        behind: Whether `function` runs after each system, not before. A store before a system would prevent the
            compiler from loading the addresses of columns only where they are needed.
    """

    function: Callable[..., Any] | None = None
    memory: Callable[[Mapping[str, int]], Any] | None = None
    behind: bool = False
    kernel: Callable[..., Any] | None = field(init=False, default=None)
    parameters: tuple[Parameter, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        if self.function is None:
            if self.memory is None:
                raise DeclarationError("a Service needs a function, or memory, or both")
            return
        function = getattr(self.function, "py_func", self.function)
        found = parameters(function, skip=1 if self.memory else 0)
        for each in found:
            if each.kind not in PARTS:
                raise DeclarationError(
                    f"{function.__module__}.{function.__qualname__}: parameter '{each.name}' is {each.kind}, but a "
                    f"service is made of {', '.join(PARTS)} alone"
                )
        object.__setattr__(self, "function", function)
        object.__setattr__(self, "kernel", kernel(function))
        object.__setattr__(self, "parameters", found)

    def arrays(self, memory: Any) -> dict[str, Array]:
        """Return the fields of the memory that are not parameters. DeclarationError if one is neither."""
        named = {each.name for each in self.parameters}
        found = {name: value for name, value in memory._asdict().items() if name not in named}
        for name, value in found.items():
            if not isinstance(value, np.ndarray):
                made: Any = self.function or self.memory
                raise DeclarationError(
                    f"{made.__module__}.{made.__qualname__}: the field '{name}' of its memory is "
                    f"{type(value).__name__}: an array is needed, or the name of a parameter"
                )
        return found


def parameters(function: Callable[..., Any], skip: int = 0) -> tuple[Parameter, ...]:
    """Read the annotations of a function, except those of the first `skip` parameters.

    Raises:
        DeclarationError: An annotation is not in the table above, a parameter has a default, or the function is a
            generator or a coroutine, which would not run when it is called.
    """
    label = f"{function.__module__}.{function.__qualname__}"
    if inspect.isgeneratorfunction(function) or inspect.iscoroutinefunction(function):
        raise DeclarationError(
            f"{label} is a generator or a coroutine: a call of it would do nothing; write a function without yield or "
            "async"
        )
    hints, own = get_type_hints(function, include_extras=True), inspect.signature(function).parameters
    for name, parameter in own.items():
        if parameter.default is not parameter.empty:
            cure = f": the default of a number stands in the class of its mechanic, as in {name}: float = number(1.0)"
            raise DeclarationError(
                f"{label}: parameter '{name}' has the default {parameter.default!r:.60}, but every call gives it; "
                "leave it out"
                + (cure if hints.get(name) in (int, float, bool) or get_origin(hints.get(name)) is tuple else "")
            )
    found = [_parameter(name, hints.get(name)) for name in [*own][skip:]]
    for name, each in zip([*own][skip:], found, strict=True):
        if isinstance(each, str):
            raise DeclarationError(f"{label}: parameter '{name}' is {each}")
    return tuple(each for each in found if isinstance(each, Parameter))


def _parameter(name: str, hint: Any) -> Parameter | str:
    """Return the parameter of an annotation; for an invalid one, a description of it and of its replacement."""
    if get_origin(hint) in (Union, UnionType) and NoneType in get_args(hint):
        found = _parameter(name, next(each for each in get_args(hint) if each is not NoneType))
        if len(get_args(hint)) == 2 and isinstance(found, Parameter) and found.components:
            return replace(found, optional=True)
    inner, kind = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
    if isinstance(kind, Service):
        return Parameter(name, "service", service=kind, parts=kind.parameters)
    if isinstance(kind, Label):
        return Parameter(name, "label", label=kind.attribute)
    if kind in ("read", "write", "add"):
        if not (isinstance(inner, type) and issubclass(inner, Component)):
            return f"{kind.title()}[{inner!r}]; a component is needed, as in {kind.title()}[Body]"
        what = f"{kind.title()}[{inner.__name__}]"
        if not inner.columns:
            rows = "" if issubclass(inner, Singleton) else f"; Rows[{inner.__name__}] are the entities that have it"
            return f"{what}, which has no columns{rows}"
        if kind == "add" and issubclass(inner, Event):
            return (
                f"{what}, but the order of events is that of the systems that emit them: annotate it "
                f"Write[{inner.__name__}]"
            )
        if kind in ("write", "add") and inner is Clock:
            return (
                f"{what}, but the engine alone sets the clock, which is the key of all random numbers: annotate it "
                "Read[Clock], and count in a component of your own"
            )
        return Parameter(name, kind, (inner,))
    if kind in ANNOTATED:
        return Parameter(name, kind)
    if get_origin(hint) in SELECTIONS:
        for part in get_args(hint):
            if not (isinstance(part, type) and issubclass(part, Component)) or issubclass(part, Singleton):
                singleton = isinstance(part, type) and issubclass(part, Singleton)
                why = "which is per world and has no rows" if singleton else "which is not a component"
                return (
                    f"{get_origin(hint).__name__}[{getattr(part, '__name__', part)}], {why}; the components of "
                    "entities are needed, as in Rows[Body]"
                )
        return Parameter(name, SELECTIONS[get_origin(hint)], get_args(hint))
    if hint in (int, float, bool):
        return Parameter(name, "number", type=hint)
    if get_origin(hint) is tuple:
        return Parameter(name, "numbers", type=tuple)
    return (
        f"annotated {hint!r}; allowed are Read[C], Write[C], Add[C], Rows[A, ...], Bitset[A, ...], RowIndex[A, ...], "
        "Random, Scratch, Offset, int, float, bool, tuple, Annotated[...] with a Label or a Service, and one that "
        "names components or None, as in Read[C] | None"
    )
