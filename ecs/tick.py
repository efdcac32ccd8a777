"""The tick as code: a schedule becomes ONE function that takes a block of worlds through all of it.

The source of that function is written into a cache folder, where numba keeps the machine code beside it and where
it can be read. It takes a few worlds at a time through all systems, so that their state stays in the processor's cache.
Every system gets a loop over these worlds, which makes the tables and calls its kernel:

    tick(frame, start, stop)

The frame (see ecs.frame) says what each world is to do (SKIP / STEP / RESET), where the columns, the lists of rows and
the thread's own memory lie, and holds the modules' numbers. All of it is data, so changing a scenario's numbers
compiles nothing anew. A system that stays Python splits the tick into several such functions, called in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from .access import Parameter
from .cache import load
from .component import Clock, Component
from .errors import DeclarationError
from .fingerprint import Code
from .frame import BLOCK, MODE, Plan
from .jit import compiled, kernel
from .layout import Layout
from .module import Module
from .phase import When
from .random import stream_number
from .system import System
from .view import array_view, number_view, table_view

SKIP, STEP, RESET = 0, 1, 2
IDLE = {When.RESET: "mode[w] != 2", When.STEP: "mode[w] != 1", When.ALWAYS: "mode[w] == 0"}
TOGETHER = 16  # worlds that are taken through all systems together


@kernel
def begin(world: Any, template: Any, mode: int) -> None:
    """Time goes on, or an episode starts. world: the block as uint64 words, the four of the clock ahead."""
    if mode == RESET:
        world[2] += np.uint64(1)  # Clock.episode
        world[3] = np.uint64(0)  # Clock.tick
        for k in range(4, template.size):
            world[k] = template[k]
    else:
        world[3] += np.uint64(1)


class Writer:
    """Writes the source of one segment of the tick, and plans its frame."""

    def __init__(self, layout: Layout, systems: Sequence[System], first: bool) -> None:
        self.layout, self.systems, self.first = layout, systems, first
        self.compiled = compiled() and all(system.compiled for system in systems)
        self.modules = {system.label: module for module in layout.modules for system in module.systems()}
        self.names: dict[str, Any] = {"np": np}
        self.plan = Plan()
        self.tables: dict[type[Component], int] = {}  # where each begins in the frame
        self.selections: dict[str, int] = {}  # and each set of rows
        self.outside: list[str] = []  # of the loop being written: what comes ahead of it
        self.inside: list[str] = []  # and what is done first for each world

    def source(self) -> str:
        """The whole function."""
        loops = [self._begin()] if self.first else []
        loops += [self._loop_of(system) for system in self.systems]
        lines = ["def tick(frame, start, stop):", f"    for first in range(start, stop, {TOGETHER}):"]
        lines += [f"        last = min(first + {TOGETHER}, stop)"]
        lines += ["        " + line for loop in loops for line in loop]
        return "\n".join(lines) + "\n"

    def _begin(self) -> list[str]:
        self.names["kernel_begin"] = begin
        template = self._array("template", self.plan.constant(self.layout.template.view(np.uint64)), np.dtype("u8"))
        world = f"{self._view(np.dtype('u8'), 1, True)}(frame, {BLOCK}, w)"
        return self._loop(When.ALWAYS, f"kernel_begin({world}, {template}, mode[w])")

    def _loop_of(self, system: System) -> list[str]:
        name = "kernel_" + system.label.replace(".", "_")  # the prefix keeps it apart from the names of numbers
        self.names[name] = system.kernel
        arguments = [self._argument(system, parameter) for parameter in system.parameters]
        return self._loop(system.phase.when, f"{name}({', '.join(arguments)})")

    def _loop(self, when: When, call: str) -> list[str]:
        """Lines that make `call` for each world that is not idle; the lists outside and inside are used up."""
        self._array("mode", MODE, np.dtype("i1"))
        lines = [*dict.fromkeys(self.outside), "for w in range(first, last):"]
        lines += [f"    if {IDLE[when]}:", "        continue"]
        lines += ["    " + line for line in dict.fromkeys([*self.inside, call])]
        self.outside, self.inside = [], []
        return lines

    def _argument(self, system: System, parameter: Any) -> str:
        module = self.modules[system.label]
        name = f"{module.name}_{parameter.name}"
        match parameter.kind:
            case "read":
                return self._table(parameter.components[0], "r")
            case "write" | "add":
                return self._table(parameter.components[0], "w")
            case "rows" | "bitset" | "row_index":
                return self._selection(parameter.kind, parameter.components)
            case "random":
                clock = self._table(Clock, "r")
                key = [f"{clock}.{column}[0]" for column in Clock.columns]
                return f"({', '.join(key)}, np.uint64({stream_number(system.stream)}))"
            case "scratch":
                return self._scratch(module, parameter.name, name)
            case "damage_type":
                return self._number(self.layout.causes.index(module.cause), name)
            case "numbers":
                values = np.array(_value(module, system, parameter), np.float32)
                return self._array(name, self.plan.constant(values), values.dtype)
        return self._number(_value(module, system, parameter), name)

    def _number(self, value: Any, name: str) -> str:
        kind = "float32" if isinstance(value, float) else "int64"
        self.names[kind] = number_view(kind, python=not self.compiled)
        place = self.plan.number(value if isinstance(value, float) else int(value))
        self.outside.append(f"{name} = {kind}(frame, {place})" + (" != 0" if isinstance(value, bool) else ""))
        return name

    def _view(self, dtype: np.dtype[Any], ndim: int, writable: bool) -> str:
        name = f"{dtype.str[1:]}_{ndim}_{'w' if writable else 'r'}"
        self.names[name] = array_view(dtype, ndim, writable, python=not self.compiled)
        return name

    def _array(self, name: str, place: int, dtype: np.dtype[Any], ndim: int = 1, writable: bool = False) -> str:
        """An array that is the same for all worlds."""
        self.outside.append(f"{name} = {self._view(dtype, ndim, writable)}(frame, {place}, 0)")
        return name

    def _selection(self, kind: str, components: tuple[type[Component], ...]) -> str:
        name = "_".join([kind, *map(self._named, components)])
        if name not in self.selections:
            self.selections[name] = self.plan.constant(getattr(self.layout, kind)(*components))
        return self._array(name, self.selections[name], np.dtype("i4"))

    def _scratch(self, module: Module, asked: str, name: str) -> str:
        place = self.plan.scratch(module, asked)
        if not self.compiled:
            return f"frame.objects[{place}]"
        memory = module.scratch(asked, self.layout.dims)  # made to learn its type
        return self._array(name, place, memory.dtype, memory.ndim, writable=True)

    def _named(self, component: type[Component]) -> str:
        """A name for the source: the class's own, with a number if another component has it too."""
        alike = [c for c in self.layout.components if c.__name__ == component.__name__]
        return component.__name__.lower() + (str(alike.index(component)) if len(alike) > 1 else "")

    def _table(self, component: type[Component], access: str) -> str:
        name = f"{self._named(component)}_{access}"
        if component not in self.tables:
            self.tables[component] = min([self.plan.column(component, column) for column in component.columns])
        ndims = tuple(len(component.row_shape(column, self.layout.dims)) for column in component.columns)
        hashable: Any = component  # as every class is, but mypy does not know
        self.names[f"view_{name}"] = table_view(hashable, ndims, access == "w", python=not self.compiled)
        columns = zip(component.columns.items(), ndims, strict=True)
        types = ", ".join(f"{column} {kind.dtype.str[1:]}_{ndim}" for (column, kind), ndim in columns)
        self.inside.append(f"{name} = view_{name}(frame, {self.tables[component]}, w)  # {types}")
        return name


def _value(module: Module, system: System, parameter: Parameter) -> Any:
    """The number that a parameter asks for. DeclarationError if it is of another type than annotated."""
    value = module.value(parameter.name)
    if type(value) is not parameter.type:
        raise DeclarationError(
            f"{system.label}: parameter '{parameter.name}' is annotated {parameter.type.__name__}, but kernels get "
            f"this number as {type(value).__name__}; annotate it so"
        )
    return value


@dataclass(frozen=True)
class Segment:
    """A piece of the tick between two systems that stay Python: the function and its own arguments."""

    function: Any
    plan: Plan
    compiled: bool
    source: str


def segments(layout: Layout, systems: Sequence[System], split: bool = False) -> list[Segment]:
    """Generate the functions of a tick; with no Python system among them there is one; split: one a system."""
    result = []
    groups = [[system] for system in systems] if split else [list(g) for _, g in groupby(systems, lambda s: s.compiled)]
    code = Code(systems) if compiled() else None
    for number, group in enumerate(groups or [[]]):  # without systems, time still goes on
        writer = Writer(layout, group, first=number == 0)
        source = writer.source()
        function = load(source, writer.names, systems, code if writer.compiled else None)
        result.append(Segment(function, writer.plan, writer.compiled, source))
    return result
