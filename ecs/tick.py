"""The tick as code: a schedule becomes ONE function that takes a block of worlds through all of it.

The source of that function is written into a cache folder, where numba keeps the machine code beside it and where
it can be read. It loops over the worlds; for each it makes the tables and calls the kernels one after the other:

    tick(start, stop, mode, layout, constants, scratch, integers, reals)

mode: int8 (worlds,), SKIP / STEP / RESET. layout, constants and scratch say where the columns, the lists of rows and
the thread's own memory lie, in rows of numbers (see ecs.view); integers and reals are the modules' numbers. All of it
is data, so changing a scenario's numbers compiles nothing anew.
A system that stays Python splits the tick into several such functions, called in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np

from .cache import load
from .component import Clock, Component
from .jit import compiled, kernel
from .layout import Layout
from .module import Module, System
from .phase import When
from .random import stream_number
from .view import array_view, table_view

SKIP, STEP, RESET = 0, 1, 2
HEADER = "def tick(start, stop, mode, layout, constants, scratch, integers, reals):"


@kernel
def restore(world: Any, template: Any) -> None:
    """Set a world's block (uint64 words) back to the template; the clock in front of it stays."""
    for k in range(4, template.size):
        world[k] = template[k]


@dataclass
class Arguments:
    """What a generated tick is given beside the worlds: collected while its source is written."""

    constants: list[np.ndarray[Any, Any]] = field(default_factory=list)
    integers: list[int] = field(default_factory=list)
    reals: list[float] = field(default_factory=list)
    scratch: list[tuple[Module, str]] = field(default_factory=list)


class Writer:
    """Writes the source of one segment of the tick and collects the names and arguments it needs."""

    def __init__(self, layout: Layout, systems: Sequence[System], first: bool) -> None:
        self.layout, self.systems, self.first = layout, systems, first
        self.compiled = compiled() and all(system.compiled for system in systems)
        self.modules = {system.label: module for module in layout.modules for system in module.systems()}
        self.names: dict[str, Any] = {"np": np, "restore": restore}
        self.arguments = Arguments()
        self.tables: dict[str, str] = {}
        self.constants: set[str] = set()
        self.before: list[str] = []  # lines ahead of the loop over worlds

    def source(self) -> str:
        """The whole function."""
        calls = [
            (when, [self._call(s) for s in group]) for when, group in groupby(self.systems, lambda s: s.phase.when)
        ]
        clock = self._table(Clock, "w")
        start = self._start(clock) if self.first else []
        lines = [HEADER, *("    " + line for line in self.before), "    for w in range(start, stop):"]
        lines += ["        if mode[w] == 0:", "            continue", "        fresh = mode[w] == 2"]
        lines += [f"        {name} = {make}" for name, make in self.tables.items()]
        lines += start
        lines += [f"        seed, world, episode, tick = {', '.join(f'{clock}.{c}[0]' for c in Clock.columns)}"]
        for when, group in calls:
            if when is not When.ALWAYS:
                lines.append(f"        if {'fresh' if when is When.RESET else 'not fresh'}:")
            indent = " " * (8 if when is When.ALWAYS else 12)
            lines += [indent + call for call in group]
        return "\n".join(lines) + "\n"

    def _start(self, clock: str) -> list[str]:
        template = self._constant("template", self.layout.template.view(np.uint64))
        block = self._view(np.dtype("u8"), 1, True)
        return [
            "        if fresh:",
            f"            restore({block}(layout, {len(self.layout.places)}, w), {template})",
            f"            {clock}.episode[0] += np.uint64(1)",
            f"            {clock}.tick[0] = np.uint64(0)",
            "        else:",
            f"            {clock}.tick[0] += np.uint64(1)",
        ]

    def _call(self, system: System) -> str:
        name = system.label.replace(".", "_")
        self.names[name] = system.kernel
        return f"{name}({', '.join(self._argument(system, p) for p in system.parameters)})"

    def _argument(self, system: System, parameter: Any) -> str:
        module = self.modules[system.label]
        match parameter.kind:
            case "read":
                return self._table(parameter.components[0], "r")
            case "write" | "add":
                return self._table(parameter.components[0], "w")
            case "rows":
                name = "_".join(["rows", *map(self._name, parameter.components)])
                return self._constant(name, self.layout.rows(*parameter.components))
            case "random":
                return f"(seed, world, episode, tick, np.uint64({stream_number(system.label)}))"
            case "scratch":
                return self._scratch(module, parameter.name)
            case "cause":
                return self._integer(self.layout.causes.index(module.cause))
            case "numbers":
                name = f"{module.name()}_{parameter.name}"
                return self._constant(name, np.array(module.value(parameter.name), np.float32))
        return self._number(module.value(parameter.name))

    def _number(self, value: Any) -> str:
        if isinstance(value, float):
            self.arguments.reals.append(value)
            return f"reals[{len(self.arguments.reals) - 1}]"
        return self._integer(int(value)) + (" != 0" if isinstance(value, bool) else "")

    def _integer(self, value: int) -> str:
        self.arguments.integers.append(value)
        return f"integers[{len(self.arguments.integers) - 1}]"

    def _view(self, dtype: np.dtype[Any], ndim: int, writable: bool) -> str:
        name = f"{dtype.str[1:]}_{ndim}_{'w' if writable else 'r'}"
        self.names[name] = array_view(dtype, ndim, writable, python=not self.compiled)
        return name

    def _constant(self, name: str, array: np.ndarray[Any, Any]) -> str:
        """A read-only array that is the same for all worlds; asked for twice, it is made once."""
        if name not in self.constants:
            k = len(self.arguments.constants)
            self.constants.add(name)
            self.arguments.constants.append(np.ascontiguousarray(array))
            self.before.append(f"{name} = {self._view(array.dtype, 1, False)}(constants, {k}, 0)")
        return name

    def _scratch(self, module: Module, name: str) -> str:
        k = len(self.arguments.scratch)
        self.arguments.scratch.append((module, name))
        if not self.compiled:
            return f"scratch[{k}]"
        memory = module.scratch(name, self.layout.dims)  # made to learn its type
        self.before.append(f"scratch_{k} = {self._view(memory.dtype, memory.ndim, True)}(scratch, {k}, 0)")
        return f"scratch_{k}"

    def _name(self, component: type[Component]) -> str:
        """A name for the source: the class's own, with a number if another component has it too."""
        alike = [c for c in self.layout.components if c.__name__ == component.__name__]
        return component.__name__.lower() + (str(alike.index(component)) if len(alike) > 1 else "")

    def _table(self, component: type[Component], access: str) -> str:
        name = f"{self._name(component)}_{access}"
        if name not in self.tables:
            places = [k for k, place in enumerate(self.layout.places) if place.component is component]
            ndims = [len(self.layout.places[k].shape) for k in places]
            self.names[f"view_{name}"] = table_view(component, ndims, access == "w", not self.compiled)
            columns = zip(component.columns.items(), ndims, strict=True)
            types = ", ".join(f"{column} {kind.dtype.str[1:]}_{ndim}" for (column, kind), ndim in columns)
            self.tables[name] = f"view_{name}(layout, {places[0]}, w)  # {types}"
        return name


@dataclass(frozen=True)
class Segment:
    """A piece of the tick between two systems that stay Python: the function and its own arguments."""

    function: Any
    arguments: Arguments
    compiled: bool
    source: str


def segments(layout: Layout, systems: Sequence[System], split: bool = False) -> list[Segment]:
    """Generate the functions of a tick; with no Python system among them there is one; split: one a system."""
    result = []
    groups = [[system] for system in systems] if split else [list(g) for _, g in groupby(systems, lambda s: s.compiled)]
    for number, group in enumerate(groups or [[]]):  # without systems, time still goes on
        writer = Writer(layout, group, first=number == 0)
        source = writer.source()
        function = load(source, writer.names, systems, writer.compiled)
        result.append(Segment(function, writer.arguments, writer.compiled, source))
    return result
