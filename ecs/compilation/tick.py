"""The code generator: each system of a schedule becomes a function that runs it on a range of worlds.

    unit(arguments, first, last)

loops over these worlds, creates the tables of each from the argument block (see arguments), and calls the system's
kernel. The block holds data only: the mode of each world (SKIP, STEP or RESET), the addresses of columns, of lists of
rows and of scratch memory, and the mechanics' numbers. The source of a unit has its own argument layout and depends on
its own system only, so the compile cache keeps machine code for a system, not for a scenario.

Each iteration also prefetches memory of a later world. run_units is the tick: it runs a few worlds at a time through
all units. A system that runs as Python splits the tick into several such calls (`segments`).
"""

import functools
import itertools
import linecache
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from ..declarations.access import Parameter
from ..declarations.component import Action, Clock, Component, Entity, Observation, Signal, Singleton
from ..declarations.fields import offset
from ..declarations.module import Module
from ..declarations.numbers import kernel_value
from ..declarations.phase import When
from ..declarations.system import System
from ..kernels.errors import DeclarationError, RangeError
from ..kernels.jit import compiled, kernel
from ..kernels.random import stream_number
from ..memory.episode import (
    CLOCK_SIZE,
    absences,
    advance_clock,
    check_absent,
    clear_rows,
    draw_of_agents,
    draw_of_world,
    plan,
    published_rows,
    role_plan,
    show,
    shown,
    zero,
)
from ..memory.layout import MemoryLayout
from ..memory.numbers import GIVEN_WORDS, AgentNumbers, AgentRoles, Given, Number, NumbersView, Varied
from ..memory.tables import Tables
from .arguments import (
    ARRAY_SLOTS,
    BLOCK,
    COUNT,
    EVENTS,
    LINES,
    MAX_DIMENSIONS,
    MODE,
    STRIDE,
    ArgumentBlock,
    ArgumentLayout,
    ServiceMemory,
    View,
    array_view,
    number_view,
    table_view,
)
from .compiled_step import begin_fetch, fetch

IDLE = {When.RESET: "mode[w] != 2", When.STEP: "mode[w] != 1", When.ALWAYS: "mode[w] == 0"}
MOST_VALUES = 64  # maximum size of a constant array whose values become part of machine code
CLOCK, DRAW, ROLES = "clock", "numbers", "roles"  # labels of the units that come first


@dataclass(frozen=True, eq=False)
class Unit:
    """A system as a function of a range of worlds, or a function of the engine, such as the clock."""

    label: str
    system: System | None  # None for the engine's own
    source: str
    names: dict[str, Any]  # the objects that its source refers to
    arguments: ArgumentLayout
    compiled: bool  # or it runs as Python
    only_at_reset: bool  # it does nothing in ticks without resets
    needed: str  # text added to its exceptions; not part of the machine code
    kernels: tuple[Any, ...]  # the kernel that it calls, and those of its services

    def function(self) -> Any:
        """Return the Python function; debuggers and tracebacks find its source."""
        file = f"<outlast unit {self.label}>"
        linecache.cache[file] = len(self.source), None, self.source.splitlines(keepends=True), file
        exec(compile(self.source, file, "exec"), self.names)
        return self.names["unit"]


class Generator:
    """A generator of units, by its methods.

    python: whether it runs as Python. outside: whether its system is from outside of outlast. specialize: whether
    shapes, places and lists of rows become part of its machine code. tables: the views of tables of this layout, which
    generators share.
    """

    def __init__(
        self,
        layout: MemoryLayout,
        *,
        python: bool = False,
        outside: bool = False,
        specialize: bool = False,
        tables: dict[Any, tuple[Any, str]] | None = None,
    ) -> None:
        self.layout, self.compiled, self.checked = layout, compiled() and not python, outside
        self.specialize = specialize and self.compiled
        self._tables = {} if tables is None else tables
        self.names: dict[str, Any] = {"np": np}
        self.arguments = ArgumentLayout()
        self.slots: dict[str, int] = {}
        self._owners: dict[str, Any] = {}  # the object of each name in the source
        self.outside: dict[str, None] = {}  # lines ahead of the loop over worlds
        self.inside: dict[str, None] = {}  # lines at the start of its body
        self.behind: list[str] = []  # lines at its end
        self._kernels: list[Any] = []  # those of services

    def clock(self) -> Unit:
        """Return the unit that begins the tick or the episode of every world."""
        image = self._constant("image", self.layout.initial_image.view(np.uint64))
        state, counts = self._words("state", BLOCK, "u8"), self._words("event_counts", EVENTS, "i4")
        kept = self._number(CLOCK_SIZE + self.layout.dims.get(GIVEN_WORDS, 0), "kept")
        return self._unit(CLOCK, advance_clock, When.ALWAYS, [state, image, counts, "mode[w]", kept])

    def draw(self) -> Unit:
        """Return the unit that draws the varied numbers of every world whose episode begins."""
        arguments = [self._table(Clock, "w"), self._table(Entity, "w"), f"{self._table(Given, 'w')}.words"]
        arguments += [*self._numbers(Varied), self._constants("plan", plan(self.layout, by_role=False))]
        arguments += [self._constant("absent", absences(self.layout))]
        return self._unit(DRAW, draw_of_world, When.RESET, arguments)

    def assign(self) -> Unit:
        """Return the unit that sets the roles and numbers of the agents of every world whose episode begins."""
        arguments = [self._table(Clock, "r"), self._table(Entity, "r"), f"{self._table(AgentRoles, 'w')}.role"]
        # without numbers, none is written
        arguments += self._numbers(AgentNumbers if self.layout.per_agent else AgentRoles)
        arguments += [self._constants("plan", plan(self.layout, by_role=True))]
        arguments += [self._constants("role_plan", role_plan(self.layout))]
        return self._unit(ROLES, draw_of_agents, When.RESET, arguments)

    def _numbers(self, owner: type[Component]) -> list[str]:
        """Return the words of numbers as int32 and as float32, and the state as int32 and as uint8."""
        return [
            self._view_of("values", lambda worlds: worlds[owner][0], "i4", writable=True),
            self._view_of("reals", lambda worlds: worlds[owner][0].view(np.float32), "f4", writable=True),
            self._view_of("state", lambda worlds: worlds.block.view(np.int32), "i4", writable=True),
            self._view_of("state_bytes", lambda worlds: worlds.block, "u1", writable=True),
        ]

    def show(self) -> Unit:
        """Return the unit that shows varied numbers to agents."""
        arguments = [
            self._view_of("rows", lambda worlds: worlds[NumbersView].numbers, "f4", writable=True, ndim=2),
            f"{self._table(Varied, 'r')}.words",
            self._view_of("reals", lambda worlds: worlds[Varied].words.view(np.float32), "f4"),
            self._constant("shown", shown(self.layout)),
        ]
        return self._unit("show numbers", show, When.ALWAYS, arguments)

    def clear(self, number: Number, component: type[Component], column: str) -> Unit:
        """Return the unit that sets the rows of absent entities to 0 in a column for learners."""
        arguments = [self._column_as("rows", component, column, axes=2), self._view_of("count", *_words_of(number))]
        return self._unit(f"clear {_full_name(component, column)}", clear_rows, When.ALWAYS, arguments)

    def zero(self, components: Iterable[type[Component]], when: When) -> Unit:
        """Return the unit that sets all columns of some components, which are not packed, to 0, byte by byte."""
        columns = [(component, name) for component in components for name in component.columns]
        rows = [self._column_as(f"row_{k}", *each, axes=1, dtype="u1") for k, each in enumerate(columns)]
        label = f"zero {', '.join(itertools.starmap(_full_name, columns))} ({when.value})"
        return self._unit(label, zero, when, [f"({', '.join(rows)},)"])

    def check_absent(self, system: System) -> Unit:
        """Return the unit that follows a system that can make entities alive, and refuses absent ones."""
        entities = self._table(Entity, "r")
        return self._unit(f"absent rows after {system.label}", check_absent, system.phase.when, [entities])

    def check_range(self, system: System, component: type[Component], column: str, low: int, high: int) -> Unit:
        """Return the unit that follows a system that can write integers out of a column's range, and refuses these."""
        label = f"{_full_name(component, column)} after {system.label}"
        values = self._column_as("values", component, column, axes=2, writable=False)
        if issubclass(component, Singleton):
            checked = np.arange(component.row_shape(column, self.layout.dims)[0], dtype=np.int32)
        else:
            checked = self.layout.rows(component)
        rows = self._constant("rows", checked)
        ends = (self._number(end, name) for name, end in (("low", low), ("high", min(high, 2**63 - 1))))
        needed = f": {low} to {high} is needed"
        return self._unit(label, check_range, system.phase.when, [values, rows, *ends], needed=needed)

    def system(self, module: Module, system: System) -> Unit:
        """Return the unit of a system."""
        arguments = [self._argument(module, system, parameter) for parameter in system.parameters]
        return self._unit(system.label, system.kernel, system.phase.when, arguments, system)

    def _unit(
        self,
        label: str,
        kernel: Any,
        when: When,
        arguments: Sequence[str],
        system: System | None = None,
        needed: str = "",
    ) -> Unit:
        self._array("mode", MODE, View(np.dtype("i1"), 1))
        self.names["kernel"] = kernel = kernel if self.compiled else getattr(kernel, "py_func", kernel)
        lines = [f"def unit(arguments, first, last):  # {label}"]
        lines += [f"    {name} = {slot}" for name, slot in self.slots.items()]
        lines += ["    " + line for line in self.outside]
        if self.compiled:
            self.names |= {"begin_fetch": begin_fetch, "fetch": fetch, "int64": number_view("int64", python=False)}
            lines += [f"    ahead, stride = begin_fetch(arguments, first), int64(arguments, {STRIDE})"]
            lines += [f"    offsets, count = int64(arguments, {LINES}), int64(arguments, {COUNT})"]
        lines += ["    for w in range(first, last):"]
        if self.compiled:
            lines += ["        fetch(ahead, offsets, count)", "        ahead += stride"]
        lines += [f"        if {IDLE[when]}:", "            continue"]
        lines += ["        " + line for line in (*self.inside, f"kernel({', '.join(arguments)})", *self.behind)]
        source, kernels = "\n".join(lines) + "\n", (kernel, *self._kernels)
        at_reset = when is When.RESET
        return Unit(label, system, source, self.names, self.arguments, self.compiled, at_reset, needed, kernels)

    def _argument(self, module: Module, system: System, parameter: Parameter) -> str:
        match parameter.kind:
            case "none":
                return "None"
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
                return self._scratch(module, parameter.name)
            case "label":
                if not (own := getattr(module, parameter.label, "")):
                    raise DeclarationError(
                        f"{system.label} takes the {parameter.label} of {module.name}, which has "
                        f'none: set one in the class, as in {parameter.label} = "{module.name}"'
                    )
                return self._number(self.layout.labels[parameter.label].index(own), parameter.name)
            case "service":
                return self._service(module, system, parameter)
            case "offset":
                return self._number(offset(self.layout.fields, parameter.name, system.label), parameter.name)
        full, value = kernel_value(self.layout.modules, module, system, parameter)
        name = f"number_{parameter.name}"
        if (number := self.layout.per_agent.get(full)) is not None:  # an array by row
            part, dtype = slice(number.start, number.start + self.layout.dims["rows"]), number.dtype
            words = self._view_of(name, lambda worlds: worlds[AgentNumbers].words[:, part].view(dtype), dtype)
            self.inside[f"{name} = {words}"] = None
            return name
        if (number := self.layout.varied.get(full)) is not None:  # in the state of each world
            words = self._view_of(name, *_words_of(number))
            form = {tuple: "{}", float: "{}[0]", bool: "{}[0] != 0"}.get(number.kind, "np.int64({}[0])")
            self.inside[f"{name} = {form.format(words)}"] = None
            return name
        if parameter.kind == "numbers":
            return self._constant(name, np.array(value, np.float32))
        return self._number(value, parameter.name, full)

    def _service(self, module: Module, system: System, parameter: Parameter) -> str:
        """Return the result of a service: a value, or memory of the thread that it fills or clears."""
        service: Any = parameter.service
        parts = [self._argument(module, system, part) for part in parameter.parts]
        name = f"service_{parameter.name}"
        if service.function is not None:
            make = self._unique(f"make_{service.function.__name__}", service)
            self.names[make] = service.kernel if self.compiled else service.function
            self._kernels.append(service.kernel)
        if service.memory is None:
            self.inside[f"{name} = {make}({', '.join(parts)})"] = None
            return name
        memory = service.memory(self.layout.dims)
        kind, fields = f"memory_{parameter.name}", dict(zip((p.name for p in parameter.parts), parts, strict=True))
        arrays = service.arrays(memory)
        slot = self._slot(kind, self.arguments.add_service(service, len(arrays)))
        for k, (field, array) in enumerate(arrays.items()):
            view = self._view(View(array.dtype, array.ndim, True, shape=array.shape if self.specialize else None))
            fields[field] = f"{view}(arguments, {slot} + {k * ARRAY_SLOTS}, 0)"
        self.names[kind] = type(memory)
        self.inside[f"{name} = {kind}({', '.join(fields[field] for field in memory._fields)})"] = None
        if service.function is not None:
            call = f"{make}({', '.join([name, *parts])})"
            self.behind += [call] if service.behind else []
            self.inside |= {} if service.behind else {call: None}
        return name

    def _number(self, value: int | float, parameter: str, full: str = "") -> str:
        name, kind = f"number_{parameter}", "float32" if isinstance(value, float) else "int64"
        self.names[kind] = number_view(kind, python=not self.compiled)
        given = value if isinstance(value, float) else int(value)
        slot = self._slot(name, self.arguments.add_number(given, full))
        self.outside[f"{name} = {kind}(arguments, {slot})" + (" != 0" if isinstance(value, bool) else "")] = None
        return name

    def _constant(self, name: str, array: np.ndarray[Any, Any]) -> str:
        known: dict[str, Any] = {"shape": array.shape} if self.specialize else {}
        if self.specialize and array.dtype.kind in "iu" and array.size <= MOST_VALUES:
            known["values"] = array.tobytes()
        array = np.ascontiguousarray(array)
        slot = self.arguments.add_array(lambda _: array, by_world=False)
        return self._array(name, slot, View(array.dtype, array.ndim, **known))

    def _constants(self, name: str, arrays: Any) -> str:
        """Return a NamedTuple of arrays that are the same for all worlds."""
        kind = type(arrays)
        self.names[kind.__name__] = kind
        members = (self._constant(f"{name}_{field}", getattr(arrays, field)) for field in kind._fields)
        self.outside[f"{name} = {kind.__name__}({', '.join(members)})"] = None
        return name

    def _array(self, name: str, slot: int, view: View) -> str:
        """Return an array that is the same for all worlds."""
        self.outside[f"{name} = {self._view(view)}(arguments, {self._slot(name, slot)}, 0)"] = None
        return name

    def _view(self, view: View) -> str:
        if self.checked:
            view = replace(view, checked=True)
        self.names[view.name] = array_view(view, not self.compiled)
        return view.name

    def _words(self, name: str, slot: int, dtype: Any, writable: bool = True, ndim: int = 1) -> str:
        """Return memory of a world as an array."""
        return f"{self._view(View(np.dtype(dtype), ndim, writable))}(arguments, {self._slot(name, slot)}, w)"

    def _view_of(self, name: str, view: Any, dtype: Any, writable: bool = False, ndim: int = 1) -> str:
        """Return memory of a world as an array, which the function `view` finds in the Worlds."""
        return self._words(name, self.arguments.add_array(view), dtype, writable, ndim)

    def _column_as(
        self, name: str, component: type[Component], column: str, axes: int, writable: bool = True, dtype: Any = None
    ) -> str:
        """Return a column of a world as an array of one axis, or of two: rows, and all numbers of a row."""
        kind = np.dtype(dtype or component.columns[column].dtype)

        def view(worlds: Tables) -> Any:
            values = getattr(worlds[component], column)
            shape = *values.shape[:axes], math.prod(values.shape[axes:])  # -1 would fail for 0 numbers
            return values.reshape(shape).view(kind)

        return self._view_of(name, view, kind, writable, axes)

    def _slot(self, name: str, slot: int) -> str:
        constant = self._unique(name.upper(), ("slot of", name))
        self.slots[constant] = slot
        return constant

    def _unique(self, wanted: str, owner: Any) -> str:
        """Return a name for `owner`: the wanted one, with underscores appended if it belongs to another owner."""
        while self._owners.setdefault(wanted, owner) != owner:
            wanted += "_"
        return wanted

    def _selection(self, kind: str, components: tuple[type[Component], ...]) -> str:
        name = self._unique("_".join([kind, *map(self._named, components)]), (kind, components))
        if ("slot of", name) in self._owners.values():
            return name
        return self._constant(name, getattr(self.layout, kind)(*components))

    def _scratch(self, module: Module, parameter: str) -> str:
        slot = self.arguments.add_scratch(module, parameter)
        if not self.compiled:
            return f"arguments.scratch[{slot}]"
        memory = module.scratch(parameter, self.layout.dims)  # created only for its type
        if not (isinstance(memory, np.ndarray) and memory.flags.c_contiguous and memory.ndim <= MAX_DIMENSIONS):
            raise DeclarationError(
                f"{module.name}.scratch({parameter!r}) returned {type(memory).__name__}: an array in order of rows (C) "
                f"is needed, of at most {MAX_DIMENSIONS} axes"
            )
        shape = memory.shape if self.specialize else None
        return self._array(f"scratch_{parameter}", slot, View(memory.dtype, memory.ndim, writable=True, shape=shape))

    def _named(self, component: type[Component]) -> str:
        """Return the class's name in the source, with a number if another component has the same name."""
        alike = [c for c in self.layout.components if c.__name__ == component.__name__]
        return component.__name__.lower() + (str(alike.index(component)) if len(alike) > 1 else "")

    def _table(self, component: type[Component], access: str) -> str:
        name = self._unique(f"{self._named(component)}_{access}", (component, access))
        slot = self._unique(f"TABLE_{self._named(component).upper()}", ("table of", component))
        if slot not in self.slots:
            finders = [functools.partial(_column_of, component, column) for column in component.columns]
            self.slots[slot] = min(map(self.arguments.add_array, finders))
        form = component, access, self.compiled, self.checked, self.specialize
        if form not in self._tables:
            self._tables[form] = self._table_view(component, access == "w")
        self.names[f"view_{name}"], types = self._tables[form]
        self.inside[f"{name} = view_{name}(arguments, {slot}, w)  # {types}"] = None
        return name

    def _table_view(self, component: type[Component], writable: bool) -> tuple[Any, str]:
        """Return a table's view, and a text of everything that determines its machine code, for the cache's key."""
        views = tuple(self._column(component, column, writable) for column in component.columns)
        kinds = zip(component.columns, views, strict=True)
        types = ", ".join(" ".join([column, view.name, *map(str, view.place or ())]) for column, view in kinds)
        view = table_view(component.Table, views, not self.compiled, component.packed)
        return view, types + ("" if component.packed else ", not packed")

    def _column(self, component: type[Component], name: str, writable: bool) -> View:
        dtype, shape = component.columns[name].dtype, component.row_shape(name, self.layout.dims)
        if len(shape) > MAX_DIMENSIONS:
            raise DeclarationError(
                f"{component.__name__}.{name} has {len(shape)} axes in a world: at most {MAX_DIMENSIONS} are possible"
            )
        known: dict[str, Any] = {"shape": shape} if self.specialize else {}
        if self.specialize and component.packed:
            (place,) = (each for each in self.layout.places if (each.component, each.name) == (component, name))
            known["place"] = (place.offset, self.layout.world_bytes)
        return View(dtype, len(shape), writable, self.checked, **known)


def _column_of(component: type[Component], column: str, worlds: Tables) -> Any:
    return getattr(worlds[component], column)


@kernel
def check_range(values: Any, rows: Any, low: int, high: int) -> None:
    """Raise RangeError unless all integers of these rows, (rows, numbers of a row), are in the range.

    Other systems use them as indices or bits without a check, so an impossible one would make them access the wrong
    memory.
    """
    for k in range(rows.size):
        for c in range(values.shape[1]):
            if values[rows[k], c] < low or values[rows[k], c] > high:
                raise RangeError("an integer is out of the range that its column declares")


def _full_name(component: type[Component], column: str) -> str:
    """Return the name of a column; the key, if published, distinguishes classes from one function."""
    key = component.columns[column].key
    return f"{component.__module__}.{component.__qualname__}.{column}" + (f" ({key})" if key else "")


def _words_of(number: Number) -> tuple[Any, Any]:
    """Return a function that finds a varied number in the Worlds, and the number's type."""
    return lambda worlds: worlds[Varied].words[:, number.words].view(number.dtype), number.dtype


# ---- the units of a tick


@dataclass(frozen=True)
class Segment:
    """Successive units that a thread runs by one call: all are machine code, or all run as Python."""

    units: Sequence[Unit]
    compiled: bool


def segments(
    layout: MemoryLayout,
    systems: Sequence[System],
    interpret: Collection[str] = (),
    specialize: bool = False,
    python: bool = False,
) -> list[Segment]:
    """Generate the units of a tick of these systems, in order.

    interpret: labels of systems to run as Python; python: all of them. specialize: whether the machine code is for this
    layout only.
    """
    modules, tables = {module.name: module for module in layout.modules}, dict[Any, tuple[Any, str]]()

    def new(as_python: bool = python, outside: bool = False) -> Generator:
        return Generator(layout, python=as_python, outside=outside, specialize=specialize, tables=tables)

    some_absent = any(number.kinds for number in layout.varied.values())
    signals = [*_written_outside(layout, systems, Signal)]
    units = [new().clock(), *([new().draw()] if layout.keyed else []), *([new().assign()] if layout.roles else [])]
    stale = [*_read_in_resets(layout, systems), *(each for each, _ in _written_outside(layout, systems, Observation))]
    units += [new().zero(stale, When.RESET)] if stale else []
    for system in systems:
        first = [signal for signal, writer in signals if writer is system]
        units += [new().zero(first, When.ALWAYS)] if first else []
        making = new(python or not system.compiled or system.label in interpret, system.outside)
        units.append(making.system(modules[system.module], system))
        if system.outside:
            units += [new().check_range(system, *found) for found in _ranges(layout, system)]
        if some_absent and system.outside and system.touches(Entity, "write", "add"):
            units.append(new().check_absent(system))
    if paid := [component for component in layout.components if issubclass(component, Signal)]:
        units.append(new().zero(paid, When.RESET))  # the tick that starts an episode has no actions
    if NumbersView in layout.components:
        units.append(new().show())
    units += [new().clear(*each) for each in published_rows(layout)]
    return [Segment(tuple(part), compiled) for compiled, part in groupby(units, lambda unit: unit.compiled)]


def _read_in_resets(layout: MemoryLayout, systems: Sequence[System]) -> Iterator[type[Component]]:
    """Return the actions that the tick of a reset reads; the table still holds those of the last episode."""
    for component in layout.components:
        if issubclass(component, Action):
            reading = [system for system in systems if system.touches(component, "read", "write", "add")]
            if any(system.phase.when is not When.STEP for system in reading):
                yield component


def _written_outside(
    layout: MemoryLayout, systems: Sequence[System], kind: type[Component]
) -> Iterator[tuple[type[Component], System]]:
    """Yield components of a kind that only systems from outside of outlast write, each with the first of these.

    They may leave old observations in place, and may only add to signals.
    """
    for component in layout.components:
        if issubclass(component, kind):
            writing = [system for system in systems if system.touches(component, "write", "add")]
            if writing and all(system.outside for system in writing):
                yield component, writing[0]


def _ranges(layout: MemoryLayout, system: System) -> Iterator[tuple[type[Component], str, int, int]]:
    """Yield the columns to check after a system: component, name, and the lowest and the highest integer of each."""
    for component in layout.components:
        if system.touches(component, "write", "add"):
            for name, column in component.columns.items():
                if column.dtype != bool and (ends := column.range(layout.dims)):
                    yield component, name, *ends


def in_python(
    units: Sequence[Unit], worlds: Tables, memory: ServiceMemory | None = None
) -> Iterator[tuple[Unit, ArgumentBlock, Callable[[], None]]]:
    """Yield units with their arguments, and a function that runs each on all worlds as Python.

    memory: Memory of services; None: a new one.
    """
    memory = memory or ServiceMemory(worlds.dims)
    for unit in units:
        block = ArgumentBlock(unit.arguments, worlds, memory, compiled=False)
        yield unit, block, functools.partial(unit.function(), block, 0, worlds.count)
