"""The code generator: a schedule becomes one function that takes a range of worlds through all systems.

The source of that function is written into the cache folder, where it can be read and where numba keeps the machine
code beside it. It takes a few worlds at a time through all systems, so that their state stays in the processor's cache.
Every system has a loop over these worlds, which makes the tables and calls its kernel:

    tick(arguments, start, stop)

The argument block (see ecs.arguments) has the mode of each world (SKIP, STEP or RESET), the addresses of columns, lists
of rows and scratch memory, and the modules' numbers. As these are data, a change of a scenario's numbers recompiles
nothing. A system that stays Python splits the tick into several such functions, called in turn.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from .access import Parameter
from .arguments import BLOCK, EVENTS, MODE, ArgumentLayout, array_view, number_view, table_view
from .cache import load
from .cache_key import CacheKey
from .component import Clock, Component
from .errors import DeclarationError
from .event import clear, list_spans
from .jit import compiled, kernel
from .layout import Layout
from .module import Module
from .phase import When
from .random import stream_number
from .system import System

SKIP, STEP, RESET = 0, 1, 2
IDLE = {When.RESET: "mode[w] != 2", When.STEP: "mode[w] != 1", When.ALWAYS: "mode[w] == 0"}
CHUNK = 16  # worlds that go through all systems together
EPISODE, TICK, CLOCK_SIZE = 2, 3, 4  # of the Clock, whose columns a world's state begins with


@kernel
def advance_clock(world: Any, initial_image: Any, events: Any, event_spans: Any, mode: int) -> None:
    """Count a tick, or start an episode, and forget the events of the tick before.

    world: its state as uint64, as is initial_image. events, event_spans: see ecs.event.clear.
    """
    clear(events, event_spans)
    if mode == RESET:
        world[EPISODE] += np.uint64(1)
        world[TICK] = np.uint64(0)
        load_initial_state(world, initial_image)
    else:
        world[TICK] += np.uint64(1)


@kernel
def load_initial_state(world: Any, initial_image: Any) -> None:
    """Set all state but the clock to what it is at the start of an episode."""
    for k in range(CLOCK_SIZE, initial_image.size):
        world[k] = initial_image[k]


class Generator:
    """Generates the source of one segment of the tick, and the layout of its arguments."""

    def __init__(self, layout: Layout, systems: Sequence[System], first: bool) -> None:
        self.layout, self.systems, self.first = layout, systems, first
        self.compiled = compiled() and all(system.compiled for system in systems)
        self.modules = {system.label: module for module in layout.modules for system in module.systems()}
        self.names: dict[str, Any] = {"np": np}
        self.arguments = ArgumentLayout()
        self.tables: dict[type[Component], int] = {}  # first slots
        self.selections: dict[str, int] = {}  # first slots
        self.outside: list[str] = []  # lines ahead of the loop that is generated
        self.inside: list[str] = []  # lines at the start of its body

    def source(self) -> str:
        """The whole function."""
        loops = [self._clock_loop()] if self.first else []
        loops += [self._loop_of(system) for system in self.systems]
        lines = ["def tick(arguments, start, stop):", f"    for first in range(start, stop, {CHUNK}):"]
        lines += [f"        last = min(first + {CHUNK}, stop)"]
        lines += ["        " + line for loop in loops for line in loop]
        return "\n".join(lines) + "\n"

    def _clock_loop(self) -> list[str]:
        self.names["kernel_advance_clock"] = advance_clock
        slot = self.arguments.add_constant(self.layout.initial_image.view(np.uint64))
        image = self._array("image", slot, np.dtype("u8"))
        world = f"{self._view(np.dtype('u8'), 1, True)}(arguments, {BLOCK}, w)"
        events = f"{self._view(np.dtype('i4'), 1, True)}(arguments, {EVENTS}, w)"
        slot = self.arguments.add_constant(list_spans(self.layout.events, self.layout.event_type))
        spans = self._array("event_spans", slot, np.dtype("i4"), 2)
        return self._loop(When.ALWAYS, f"kernel_advance_clock({world}, {image}, {events}, {spans}, mode[w])")

    def _loop_of(self, system: System) -> list[str]:
        name = "kernel_" + system.label.replace(".", "_")  # the prefix keeps it apart from the names of numbers
        self.names[name] = system.kernel
        arguments = [self._argument(system, parameter) for parameter in system.parameters]
        return self._loop(system.phase.when, f"{name}({', '.join(arguments)})")

    def _loop(self, when: When, call: str) -> list[str]:
        """Lines that make `call` for each world that is not idle; empties the lists outside and inside."""
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
                if not module.damage_type:
                    raise DeclarationError(
                        f"{system.label} has the DamageType parameter '{parameter.name}', but {module.name} has no "
                        f'damage_type: set one in the class, as in damage_type = "{module.name}"'
                    )
                return self._number(self.layout.damage_types.index(module.damage_type), name)
            case "numbers":
                values = np.array(_value(module, system, parameter), np.float32)
                return self._array(name, self.arguments.add_constant(values), values.dtype)
        return self._number(_value(module, system, parameter), name)

    def _number(self, value: Any, name: str) -> str:
        kind = "float32" if isinstance(value, float) else "int64"
        self.names[kind] = number_view(kind, python=not self.compiled)
        slot = self.arguments.add_number(value if isinstance(value, float) else int(value))
        self.outside.append(f"{name} = {kind}(arguments, {slot})" + (" != 0" if isinstance(value, bool) else ""))
        return name

    def _view(self, dtype: np.dtype[Any], ndim: int, writable: bool) -> str:
        name = f"{dtype.str[1:]}_{ndim}_{'w' if writable else 'r'}"
        self.names[name] = array_view(dtype, ndim, writable, python=not self.compiled)
        return name

    def _array(self, name: str, slot: int, dtype: np.dtype[Any], ndim: int = 1, writable: bool = False) -> str:
        """An array that is the same for all worlds."""
        self.outside.append(f"{name} = {self._view(dtype, ndim, writable)}(arguments, {slot}, 0)")
        return name

    def _selection(self, kind: str, components: tuple[type[Component], ...]) -> str:
        name = "_".join([kind, *map(self._named, components)])
        if name not in self.selections:
            self.selections[name] = self.arguments.add_constant(getattr(self.layout, kind)(*components))
        return self._array(name, self.selections[name], np.dtype("i4"))

    def _scratch(self, module: Module, parameter: str, name: str) -> str:
        slot = self.arguments.add_scratch(module, parameter)
        if not self.compiled:
            return f"arguments.scratch[{slot}]"
        memory = module.scratch(parameter, self.layout.dims)  # made for its type only
        return self._array(name, slot, memory.dtype, memory.ndim, writable=True)

    def _named(self, component: type[Component]) -> str:
        """The class's name as in the source: with a number if another component has the same."""
        alike = [c for c in self.layout.components if c.__name__ == component.__name__]
        return component.__name__.lower() + (str(alike.index(component)) if len(alike) > 1 else "")

    def _table(self, component: type[Component], access: str) -> str:
        name = f"{self._named(component)}_{access}"
        if component not in self.tables:
            self.tables[component] = min([self.arguments.add_column(component, column) for column in component.columns])
        ndims = tuple(len(component.row_shape(column, self.layout.dims)) for column in component.columns)
        hashable: Any = component  # classes are, but mypy rejects type[Component]
        self.names[f"view_{name}"] = table_view(hashable, ndims, access == "w", python=not self.compiled)
        columns = zip(component.columns.items(), ndims, strict=True)
        types = ", ".join(f"{column} {kind.dtype.str[1:]}_{ndim}" for (column, kind), ndim in columns)
        self.inside.append(f"{name} = view_{name}(arguments, {self.tables[component]}, w)  # {types}")
        return name


def _value(module: Module, system: System, parameter: Parameter) -> Any:
    """The number of a parameter's name. DeclarationError if its type is not the annotated one."""
    value = module.value(parameter.name)
    if type(value) is not parameter.type:
        raise DeclarationError(
            f"{system.label}: parameter '{parameter.name}' is annotated {parameter.type.__name__}, but kernels get "
            f"this number as {type(value).__name__}; annotate it so"
        )
    return value


@dataclass(frozen=True)
class Segment:
    """A part of the tick between two systems that stay Python: a function and the layout of its arguments."""

    function: Any
    arguments: ArgumentLayout
    compiled: bool
    source: str


def segments(layout: Layout, systems: Sequence[System], split: bool = False) -> list[Segment]:
    """Generate the functions of a tick: one, or with systems that stay Python several; split: one for each system."""
    result = []
    parts = [[system] for system in systems] if split else [list(g) for _, g in groupby(systems, lambda s: s.compiled)]
    cache_key = CacheKey(systems) if compiled() else None
    for number, part in enumerate(parts or [[]]):  # without systems, a tick still advances the clock
        generator = Generator(layout, part, first=number == 0)
        source = generator.source()
        function = load(source, generator.names, systems, cache_key if generator.compiled else None)
        result.append(Segment(function, generator.arguments, generator.compiled, source))
    return result
