"""Kernel arguments, packed into one int64 array so that the compiled tick takes a single pointer.

An array takes ARRAY_SLOTS slots: its address, the stride from world to world in bytes, and its shape in one world. A
number takes one slot. `ArgumentLayout` assigns the slots while the source of a tick is generated; an `ArgumentBlock`
has the values for one batch of worlds and one thread.

In the tick, array_view, table_view and number_view turn slots into the arguments of kernels. A tick creates about a
hundred arrays per world, and slices of numpy arrays would change reference counts atomically for each; these views own
nothing, since the Worlds that own the memory outlive the call. Their LLVM code is built field by field: numba's
constructors would take seconds to compile for so many. The compiler removes the fields that a kernel does not use. Each
view is created only once in a process, since numba keeps every intrinsic for ever.
"""

import ctypes
import functools
import hashlib
import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, from_dtype, types
from numba.core import cgutils
from numba.extending import intrinsic

from ..declarations.access import Service
from ..declarations.module import Module
from ..kernels.array_types import CheckedColumn, ColumnType
from ..memory.column_places import ALIGN
from ..memory.tables import Tables, aligned

MAX_DIMENSIONS = 4  # maximum axes of a column in one world
ARRAY_SLOTS = 2 + MAX_DIMENSIONS
STRIDE, BLOCK = 0, 1  # bytes of a world's state; the states as uint64
MODE, EVENTS = BLOCK + ARRAY_SLOTS, BLOCK + 2 * ARRAY_SLOTS  # each world's mode; number of events of each kind
AHEAD, LINES, COUNT = range(EVENTS + ARRAY_SLOTS, EVENTS + ARRAY_SLOTS + 3)  # lines to prefetch, see compiled_step
SLOT = ir.IntType(64)
Array = np.ndarray[Any, Any]


@dataclass
class ArgumentLayout:
    """Slots of arguments: each method assigns the next free slots to an argument and returns the first."""

    size: int = COUNT + 1
    arrays: dict[int, tuple[Callable[[Any], Array], int]] = field(default_factory=dict)
    scratch: dict[int, tuple[Module, str]] = field(default_factory=dict)
    numbers: dict[int, tuple[str, int | float]] = field(default_factory=dict)
    services: dict[int, Service] = field(default_factory=dict)

    def add_array(self, find: Callable[[Any], Array], by_world: bool = True) -> int:
        """Return the array that `find` returns for the Worlds.

        by_world: whether kernels get only the part of one world.
        """
        return self._add(self.arrays, (find, int(by_world)), ARRAY_SLOTS)

    def add_scratch(self, module: Module, name: str) -> int:
        """Return a Scratch parameter: memory of the thread."""
        return self._add(self.scratch, (module, name), ARRAY_SLOTS)

    def add_number(self, value: int | float, name: str = "") -> int:
        """Return an int, or a float that is read as float32.

        name: full name of a mechanic's number, "module_number"; otherwise "".
        """
        return self._add(self.numbers, (name, value), 1)

    def add_service(self, service: Service, arrays: int) -> int:
        """Return the memory of a service, a number of arrays: memory of the thread."""
        return self._add(self.services, service, arrays * ARRAY_SLOTS)

    def _add(self, kind: dict[int, Any], content: Any, slots: int) -> int:
        slot = self.size
        kind[slot] = content
        self.size += slots
        return slot


class ServiceMemory:
    """The memory of services, which the units of a thread share; created at the first request."""

    def __init__(self, dims: Mapping[str, int]) -> None:
        self._dims = dims
        self._made = dict[Service, list[Array]]()

    def arrays(self, service: Service) -> list[Array]:
        """Return a service's arrays, each at the start of a cache line and followed by another, for kernels.simd."""
        if service not in self._made:
            self._made[service] = [
                aligned(each.nbytes).view(each.dtype).reshape(each.shape) for each in self._first(service)
            ]
            self._fill(service)
        return self._made[service]

    def restore(self) -> None:
        """Reset all arrays to their first content, since a failed system may have left any state."""
        for service in self._made:
            self._fill(service)

    def _first(self, service: Service) -> Iterable[Array]:
        return service.arrays(service.memory(self._dims)).values() if service.memory else ()

    def _fill(self, service: Service) -> None:
        for array, first in zip(self._made[service], self._first(service), strict=True):
            array[...] = first


class ArgumentBlock:
    """The arguments of one batch of worlds and one thread: int64 slots, and scratch memory by its first slot."""

    def __init__(self, layout: ArgumentLayout, worlds: Tables, memory: ServiceMemory, compiled: bool) -> None:
        self.slots = np.zeros(layout.size, np.int64)
        self.address = int(self.slots.ctypes.data)
        self.slots[STRIDE] = worlds.layout.world_bytes
        self._kept = list[Array]()  # kept alive, since the slots have only their addresses
        self._describe(BLOCK, worlds.block.view(np.uint64), 1)
        self._describe(MODE, worlds.mode, 0)
        self._describe(EVENTS, worlds.event_memory.counts, 1)
        for slot, (find, axes) in layout.arrays.items():
            self._describe(slot, find(worlds), axes)
        for slot, service in layout.services.items():
            for k, array in enumerate(memory.arrays(service)):
                self._describe(slot + k * ARRAY_SLOTS, array, 0)
        self.scratch = {slot: module.scratch(name, worlds.dims) for slot, (module, name) in layout.scratch.items()}
        for slot, array in self.scratch.items() if compiled else ():
            self._describe(slot, array, 0)
        self._numbers = layout.numbers
        self.set_numbers(worlds.changed)

    def set_numbers(self, changed: Mapping[str, int | float]) -> None:
        """Write all numbers into their slots. changed: present values of changed numbers, by full name."""
        for slot, (name, value) in self._numbers.items():
            value = changed.get(name, value)
            self.slots[slot] = np.float32(value).view(np.int32) if isinstance(value, float) else value

    def fetch(self, address: int, lines: Array) -> None:
        """Make the unit prefetch cache lines of later worlds: with world 0, at these offsets from an address."""
        self._kept.append(lines := np.ascontiguousarray(lines, np.int64))
        self.slots[[AHEAD, LINES, COUNT]] = address, lines.ctypes.data, len(lines)

    def _describe(self, slot: int, array: Array, axes: int) -> None:
        """Fill the slots of an array. axes: 1 if its first axis is the worlds, 0 if all worlds share it."""
        self._kept.append(array)
        shape = array.shape[axes:]
        stride = array.strides[0] if axes else 0
        self.slots[slot : slot + 2 + len(shape)] = [array.ctypes.data, stride, *shape]


@dataclass(frozen=True)
class View:
    """A kernel's view of an array. None: read from the slots, not part of the machine code."""

    dtype: np.dtype[Any]
    ndim: int  # in one world
    writable: bool = False
    checked: bool = False  # whether indices are checked, for kernels from outside of outlast (see kernels.array_types)
    shape: tuple[int, ...] | None = None  # in one world
    place: tuple[int, int] | None = None  # its offset in the state of a world, and the size of that state, in bytes
    values: bytes | None = None  # of all its elements

    @property
    def name(self) -> str:
        """Its name in the source of units, which describes it."""
        parts = [self.dtype.str[1:], str(self.ndim), "w" if self.writable else "r", *map(str, self.shape or ())]
        if self.values is not None:
            parts.append(hashlib.sha256(self.values).hexdigest()[:12])
        return "_".join(parts)

    @property
    def type(self) -> Any:
        """Its type in numba; with NUMBA_BOUNDSCHECK=1, the indices of all kernels are checked."""
        kind = CheckedColumn if self.checked or config.BOUNDSCHECK else ColumnType
        return kind(from_dtype(self.dtype), self.ndim, "C", readonly=not self.writable)


@functools.cache
def array_view(view: View, python: bool) -> Any:
    """Return a function (arguments, slot, w) -> array at `slot` for world w."""
    if python:
        return lambda arguments, slot, w: _python_array(arguments.slots, slot, w, view)
    return _from_slots(view.type, functools.partial(_array, view=view, packed=False))


@functools.cache
def table_view(kind: Any, views: tuple[View, ...], python: bool, packed: bool = False) -> Any:
    """Return a function (arguments, slot, w) -> the named tuple of that kind for world w; its arrays begin at `slot`.

    packed: whether the arrays lie in the state of the world.
    """
    if python:
        return lambda arguments, slot, w: kind(
            *(_python_array(arguments.slots, slot + c * ARRAY_SLOTS, w, view) for c, view in enumerate(views))
        )
    table = types.NamedTuple([view.type for view in views], kind)

    def generate(context: Any, builder: Any, slots: Any, start: Any, w: Any) -> Any:
        starts = [builder.add(start, ir.Constant(SLOT, c * ARRAY_SLOTS)) for c in range(len(views))]
        arrays = [_array(context, builder, slots, *each, packed) for each in zip(starts, itertools.repeat(w), views)]
        return context.make_tuple(builder, table, arrays)

    return _from_slots(table, generate)


@functools.cache
def number_view(kind: str, python: bool) -> Any:
    """Return a function (arguments, slot) -> the number at `slot`; kind: "int64" or "float32"."""
    if python:
        return lambda arguments, slot: arguments.slots[slot : slot + 1].view(kind)[0]
    value = getattr(types, kind)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, address: Any, slot: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            slots = builder.inttoptr(arguments[0], SLOT.as_pointer())
            pointer = builder.gep(slots, [arguments[1]])
            return builder.load(builder.bitcast(pointer, context.get_data_type(value).as_pointer()))

        return value(types.intp, types.intp), generate

    return view


def _from_slots(kind: Any, generate: Callable[..., Any]) -> Any:
    """Return a function (arguments, slot, w) for machine code, whose result `generate` makes from slots."""

    @intrinsic  # type: ignore[untyped-decorator]
    def function(typing: Any, address: Any, slot: Any, w: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            slots = builder.inttoptr(arguments[0], SLOT.as_pointer())
            return generate(context, builder, slots, arguments[1], arguments[2])

        return kind(types.intp, types.intp, types.intp), code

    return function


def _load_slot(builder: Any, slots: Any, slot: Any) -> Any:
    """Load a slot. Slots do not change during a tick, so the compiler may load them at any time."""
    word = builder.load(builder.gep(slots, [slot]))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def _array(context: Any, builder: Any, slots: Any, start: Any, w: Any, view: View, packed: bool) -> Any:
    """Return numba's array structure for world w, from the slots at `start` and from `view`.

    Packed columns share one stride, which is loaded and multiplied once for all of them.
    """
    kind = view.type
    model = context.data_model_manager[kind]
    element = context.get_data_type(kind.dtype)
    itemsize = ir.Constant(SLOT, view.dtype.itemsize)
    if view.shape is None:
        shape = [_load_slot(builder, slots, builder.add(start, ir.Constant(SLOT, 2 + k))) for k in range(view.ndim)]
    else:
        shape = [ir.Constant(SLOT, size) for size in view.shape]
    strides, count = [itemsize], shape[0]
    for size in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], size))
        count = builder.mul(count, size)
    if view.values is not None:
        address = _constant(builder, view.values)
    elif view.place is not None:
        offset, stride = (ir.Constant(SLOT, number) for number in view.place)
        address = builder.add(_load_slot(builder, slots, ir.Constant(SLOT, BLOCK)), builder.mul(w, stride))
        address = builder.add(address, offset)
    else:
        stride = ir.Constant(SLOT, STRIDE) if packed else builder.add(start, ir.Constant(SLOT, 1))
        address = builder.add(_load_slot(builder, slots, start), builder.mul(w, _load_slot(builder, slots, stride)))
    pointer = builder.inttoptr(address, element.as_pointer())
    fields = {"nitems": count, "itemsize": itemsize, "data": pointer, "shape": shape, "strides": strides}
    result = ir.Constant(model.get_value_type(), None)  # no owner, so no reference count
    for name, value in fields.items():
        position = model.get_field_position(name)
        parts = enumerate(value) if isinstance(value, list) else [(None, value)]
        for axis, part in parts:
            result = builder.insert_value(result, part, [position] if axis is None else [position, axis])
    return result


def _constant(builder: Any, values: bytes) -> Any:
    """Return the address of bytes in the machine code, followed by a cache line, for kernels.simd."""
    padded = bytearray(values) + bytes(ALIGN)
    variable = cgutils.global_constant(builder, "constant", cgutils.make_bytearray(padded))
    variable.align = ALIGN
    return builder.ptrtoint(variable, SLOT)


def _python_array(slots: Array, slot: int, w: int, view: View) -> Array:
    """Return the array at `slot` for world w, in plain Python: for uncompiled runs and for systems that stay Python."""
    address, stride, *shape = map(int, slots[slot : slot + 2 + view.ndim])
    memory: Any = (ctypes.c_char * (int(np.prod(shape)) * view.dtype.itemsize)).from_address(address + w * stride)
    array: Array = np.ndarray(tuple(shape), view.dtype, memory)
    array.flags.writeable = view.writable
    return array
