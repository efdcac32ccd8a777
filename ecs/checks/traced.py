"""A user's system that runs as Python on stand-ins, which refuse what its parameter list forbids (see stand_ins).

Functions that the system calls run as copies of themselves: in these, `range`, `enumerate` and `len` know rows and
indices, and random numbers are recorded.
"""

import builtins
import re
import traceback
from collections.abc import Callable, Iterable, Mapping
from types import CellType, FunctionType, ModuleType
from typing import Any

import numpy as np

from ..declarations.access import Parameter
from ..declarations.component import Component, Singleton
from ..declarations.fields import width
from ..declarations.system import System
from ..kernels import random
from ..kernels.errors import DeclarationError, ScheduleError, did_you_mean, place
from ..kernels.frozen_values import LIBRARIES, codes, is_library
from ..memory.layout import MemoryLayout
from .stand_ins import (
    READ_ONLY,
    Added,
    Array,
    Guard,
    Refused,
    Selection,
    Tag,
    Watch,
    counted,
    length,
    numbered,
    watched,
)

DRAWS = [getattr(random, name) for name in ("integer", "normal", "uniform", "uniform2", "words")]
PYTHON_ONLY: dict[str, Any] = {"range": counted, "enumerate": numbered, "len": length}
CANNOT_BE = re.compile(r"\(\) (missing|takes|got) |item assignment|integer -?\d+ out of bounds")  # in errors of Python


class Traced:
    """The function of a system, to be called as its kernel is, with the arrays of one world.

    Args:
        system: A system from outside of outlast.
        layout: The layout of the worlds.
        stand_ins: Names that mean something else in the system and in the functions that it calls; None: in these,
            all is as in Python, and changes of global variables last.

    Raises:
        EngineError: When called, the system does what it must not; with its label, file and line.
    """

    def __init__(self, system: System, layout: MemoryLayout, stand_ins: Mapping[str, Any] | None) -> None:
        self.system, self.layout, self.watch = system, layout, Watch(layout)
        self.drawn = set[tuple[int, ...]]()
        function: Any = getattr(system.function, "py_func", system.function)
        self.codes = dict.fromkeys(codes(function.__code__), function)
        self._names, self._made = stand_ins or {}, dict[Any, Any]()
        self._draws = {getattr(draw, "py_func", draw): self._drawing(draw) for draw in DRAWS}
        self.function = function if stand_ins is None else self._copy(function)
        self._own = _own_fields(system, layout)

    def __call__(self, *arguments: Any) -> None:
        """Run it in a world."""
        self.drawn.clear()
        given = [self._stand_in(*each) for each in zip(self.system.parameters, arguments, strict=True)]
        try:
            self.function(*given)
        except Refused as error:
            raise error.kind(f"{self._where(error)}{':' * (error.kind is DeclarationError)} {error}") from error
        except (NameError, AttributeError, OverflowError, TypeError, ValueError, IndexError) as error:
            self._explain(error)
            raise

    def _where(self, error: BaseException) -> str:
        """The system's label, with the lines of the calls that led to an error, outermost first."""
        steps = [(frame.f_code, line) for frame, line in traceback.walk_tb(error.__traceback__)]
        lines = [place(self.codes[code], line) for code, line in steps if code in self.codes]
        return f"{self.system.label} ({'; '.join(lines)})"

    def _explain(self, error: Exception) -> None:
        """Raise an EngineError or an IndexError for an error that machine code would have, too."""
        owner, name, text = getattr(error, "obj", None), getattr(error, "name", None), str(error)
        table = next((c for c in self.layout.components if type(owner) is c.Table), None)
        known: Iterable[str] = ()
        if isinstance(error, IndexError):
            raise IndexError(f"{self._where(error)}: {text}") from error
        if isinstance(error, ValueError) and "read-only" in text:
            what = "writes an array that its parameter list declares as Read; declare it Write"
            raise ScheduleError(f"{self._where(error)} {what}") from error
        if isinstance(error, (OverflowError, TypeError, ValueError)) and not CANNOT_BE.search(text):
            return
        if table:
            text, known = f"{table.__name__} has no column '{name}'; it has: {', '.join(table.columns)}", table.columns
        elif isinstance(owner, ModuleType):
            known = dir(owner)
        elif type(error) is NameError:
            *_, (frame, _) = traceback.walk_tb(error.__traceback__)
            known = [*frame.f_locals, *frame.f_globals, *dir(builtins)]
        elif text == "can't set attribute":
            text = "a column cannot be replaced; write into it, as in column[...] = ..."
        raise DeclarationError(f"{self._where(error)}: {text}{did_you_mean(name, known, before='; ')}") from error

    # ---- arguments

    def _stand_in(self, parameter: Parameter, value: Any) -> Any:
        """What the system gets for an argument."""
        kind, components = parameter.kind, parameter.components
        title, tag = f"'{parameter.name}'", Tag("index" if kind == "row_index" else "row", components)
        locked = "which is read-only and the same for all worlds; take a Scratch or a column of a component"
        if kind in ("read", "write", "add"):
            return components[0].Table(
                *(self._column(components[0], kind, *each) for each in zip(components[0].columns, value, strict=True))
            )
        if kind == "rows":
            guard = Guard(title, self.watch, locked, (len(value),), tag)
            return watched(value, guard, Selection)
        if kind in ("bitset", "numbers"):
            return watched(value, Guard(title, self.watch, locked)) if isinstance(value, np.ndarray) else value
        if kind == "row_index":
            return watched(value, Guard(title, self.watch, locked, ("rows",), tag))
        if kind == "number" and isinstance(value, np.ndarray) and value.ndim:
            return watched(value, Guard(parameter.name, self.watch, locked, ("rows",), computed=False))
        return value

    def _column(self, component: type[Component], access: str, name: str, array: Any) -> Any:
        title, dims = f"{component.__name__}.{name}", component.columns[name].dims
        guard = Guard(
            title,
            self.watch,
            READ_ONLY.format(component.__name__) if access == "read" else "",
            dims if issubclass(component, Singleton) else ("rows", *dims),
            column=(component, name),
        )
        if own := self._own.get((component, name)):
            guard.own, guard.places = own, np.broadcast_to(np.arange(array.shape[-1]), array.shape)
        return Added(array, guard) if access == "add" else watched(array, guard)

    # ---- functions that it calls

    def _copy(self, function: FunctionType) -> Any:
        """The function with stand-ins for what it refers to."""
        if function not in self._made:
            cells = [CellType() for _ in function.__closure__ or ()]
            names: dict[str, Any] = {**function.__globals__, **self._names}
            copy = FunctionType(
                function.__code__, names, function.__name__, function.__defaults__, tuple(cells) or None
            )
            copy.__kwdefaults__ = function.__kwdefaults__
            self._made[function] = copy
            self.codes |= dict.fromkeys(codes(function.__code__), function)
            for name in {name for code in codes(function.__code__) for name in code.co_names}:
                if name in names:
                    names[name] = self._replaced(names[name])
            for cell, was in zip(cells, function.__closure__ or (), strict=True):
                try:
                    cell.cell_contents = self._replaced(was.cell_contents)
                except ValueError:  # it is empty so far
                    continue
        return self._made[function]

    def _replaced(self, value: Any) -> Any:
        """What stands in for a value that a function refers to."""
        plain = getattr(value, "py_func", value)
        if isinstance(plain, FunctionType) and plain in self._draws:
            return self._draws[plain]
        if isinstance(plain, FunctionType) and not is_library(plain) and plain not in PYTHON_ONLY.values():
            return self._copy(plain)
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] not in LIBRARIES:
            return _Names(value, self._replaced)
        return value

    def _drawing(self, draw: Any) -> Callable[..., Any]:
        """A function of kernels.random that refuses a draw that gives the number of an earlier one."""
        plain = getattr(draw, "py_func", draw)

        def stand_in(key: Any, index: Any, bound: Any = None) -> Any:
            numbers = {"index": index} | ({} if bound is None else {"bound": bound})
            for name, value in numbers.items():
                if isinstance(value, (float, np.floating)):
                    raise Refused(
                        f"draws with a float as {name}, which cuts it off; take an integer, as in int({name})"
                    )
            if numbers.get("bound", 1) < 1:
                raise Refused(f"draws an integer below {bound}: the bound is 1 or more")
            draw = (*map(int, key), int(index))
            if draw in self.drawn:
                raise Refused(
                    f"draws at an index at which it has drawn already ({index}): both are made of the same random "
                    "number; take another index for each, as in 2 * i and 2 * i + 1, or entities.identity[e]"
                )
            self.drawn.add(draw)
            return plain(key, *numbers.values())

        return stand_in


class _Names:
    """A module whose functions are replaced."""

    def __init__(self, module: ModuleType, replaced: Callable[[Any], Any]) -> None:
        self._module, self._replaced = module, replaced

    def __getattr__(self, name: str) -> Any:
        return self._replaced(getattr(self._module, name))


def _own_fields(system: System, layout: MemoryLayout) -> dict[tuple[type[Component], str], tuple[Array, str]]:
    """By column of an observation in whose rows a system has Offsets: which columns are its own, and its Offsets.

    An Offset also stands for the fields that lie behind its own one, if the system's mechanic adds these.
    """
    (module,) = (each for each in layout.modules if each.name == system.module)
    found = dict[tuple[type[Component], str], tuple[Array, str]]()
    for (component, name), offsets in system.offsets().items():
        key = component.columns[name].key or name
        there = layout.fields[key]
        own, added = np.zeros(width(there), bool), {field.name for field in module.fields().get(key, ())}
        previous = ""
        for field in there.values():  # in the order of their columns
            behind = {previous, field.name} <= added and own[field.start - 1]
            own[field.columns] = behind or f"{key}_{field.name}" in offsets
            previous = field.name
        found[component, name] = own, f"the fields of its Offsets ({', '.join(sorted(offsets))})"
    return found
