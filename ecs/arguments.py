"""Kernel arguments, packed into one int64 array so that the compiled tick takes a single pointer.

An array takes ARRAY_SLOTS slots: its address, the stride from world to world in bytes, and its shape in one world. A
number takes one slot. `ArgumentLayout` assigns the slots while the source of a tick is generated, once for a scenario's
structure; an `ArgumentBlock` has the values for one batch of worlds and one thread.

In the tick, array_view, table_view and number_view turn slots into what kernels take. A tick makes about a hundred
arrays a world, and slices of numpy arrays would change reference counts atomically for each; these views own nothing,
as the Worlds object that owns the memory outlives the call. Their LLVM code is built field by field, because numba's
own constructors of arrays would take seconds to compile for so many; the compiler removes the fields that a kernel does
not use. Each view is made once a process, as numba keeps every intrinsic for good.
"""

import ctypes
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.extending import intrinsic

from .component import Component
from .jit import compiled
from .module import Module

MAX_DIMENSIONS = 4  # of a column in one world
ARRAY_SLOTS = 2 + MAX_DIMENSIONS
STRIDE, BLOCK = 0, 1  # bytes of a world's state; the states as uint64
MODE, EVENTS = BLOCK + ARRAY_SLOTS, BLOCK + 2 * ARRAY_SLOTS  # each world's mode; how many events it has
SLOT = ir.IntType(64)


@dataclass
class ArgumentLayout:
    """Which slot has which argument: each method assigns its argument the next free slots and returns the first."""

    size: int = EVENTS + ARRAY_SLOTS
    columns: dict[int, tuple[type[Component], str]] = field(default_factory=dict)
    constants: dict[int, np.ndarray[Any, Any]] = field(default_factory=dict)
    scratch: dict[int, tuple[Module, str]] = field(default_factory=dict)
    numbers: dict[int, tuple[str, int | float]] = field(default_factory=dict)
    views: dict[int, Callable[[Any], np.ndarray[Any, Any]]] = field(default_factory=dict)

    def add_column(self, component: type[Component], name: str) -> int:
        """A column; kernels get the part of it that belongs to one world."""
        return self._add(self.columns, (component, name), ARRAY_SLOTS)

    def add_constant(self, array: np.ndarray[Any, Any]) -> int:
        """An array that is the same for all worlds."""
        return self._add(self.constants, np.ascontiguousarray(array), ARRAY_SLOTS)

    def add_scratch(self, module: Module, name: str) -> int:
        """A Scratch parameter: memory of the thread."""
        return self._add(self.scratch, (module, name), ARRAY_SLOTS)

    def add_number(self, value: int | float, name: str = "") -> int:
        """An int, or a float that is read as float32. name: of a mechanic's number, "module_number"."""
        return self._add(self.numbers, (name, value), 1)

    def add_view(self, view: Callable[[Any], np.ndarray[Any, Any]]) -> int:
        """A part of the worlds' state that is no column: what a function of the worlds returns, (worlds, ...)."""
        return self._add(self.views, view, ARRAY_SLOTS)

    def _add(self, kind: dict[int, Any], content: Any, slots: int) -> int:
        slot = self.size
        kind[slot] = content
        self.size += slots
        return slot


class ArgumentBlock:
    """The arguments of one batch of worlds and one thread.

    slots: int64, at `address`. scratch: the thread's memory by its first slot, for kernels that run as Python.
    """

    def __init__(self, layout: ArgumentLayout, worlds: Any, compiled: bool) -> None:
        self.slots = np.zeros(layout.size, np.int64)
        self.slots[STRIDE] = worlds.layout.world_bytes
        self._describe(BLOCK, worlds.block.view(np.uint64), 1)
        self._describe(MODE, worlds.mode, 0)
        self._describe(EVENTS, worlds.event_memory.counts, 1)
        for slot, (component, name) in layout.columns.items():
            self._describe(slot, getattr(worlds[component], name), 1)
        for slot, view in layout.views.items():
            self._describe(slot, view(worlds), 1)
        self.constants = layout.constants  # referred to by address only
        for slot, array in layout.constants.items():
            self._describe(slot, array, 0)
        self.scratch = {slot: module.scratch(name, worlds.dims) for slot, (module, name) in layout.scratch.items()}
        for slot, array in self.scratch.items() if compiled else ():
            self._describe(slot, array, 0)
        self._numbers = layout.numbers
        self.set_numbers(worlds.changed)
        self.address = int(self.slots.ctypes.data)

    def set_numbers(self, changed: Mapping[str, int | float]) -> None:
        """Write all numbers into their slots; those that were changed, by name, with their present values."""
        for slot, (name, value) in self._numbers.items():
            value = changed.get(name, value)
            self.slots[slot] = np.float32(value).view(np.int32) if isinstance(value, float) else value

    def _describe(self, slot: int, array: np.ndarray[Any, Any], axes: int) -> None:
        """axes: 1 if the first axis is the worlds, 0 if the array is the same for all."""
        shape = array.shape[axes:]
        stride = array.strides[0] if axes else 0
        self.slots[slot : slot + 2 + len(shape)] = [array.ctypes.data, stride, *shape]


@functools.cache
def array_view(dtype: np.dtype[Any], ndim: int, writable: bool, python: bool) -> Any:
    """A function (arguments, slot, w) -> the array at `slot`, for world w."""
    if python or not compiled():
        return lambda arguments, slot, w: _python_array(arguments.slots, slot, w, dtype, ndim, writable)
    kind = _array_type(dtype, ndim, writable)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, address: Any, slot: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            slots = builder.inttoptr(arguments[0], SLOT.as_pointer())
            return _array(context, builder, kind, slots, arguments[1], arguments[2], packed=False)

        return kind(types.intp, types.intp, types.intp), generate

    return view


@functools.cache
def table_view(component: type[Component], ndims: tuple[int, ...], writable: bool, python: bool) -> Any:
    """A function (arguments, slot, w) -> table of `component` for world w; its columns begin at `slot`."""
    columns = [(column.dtype, ndim) for column, ndim in zip(component.columns.values(), ndims, strict=True)]
    if python or not compiled():
        return lambda arguments, slot, w: component.Table(
            *(
                _python_array(arguments.slots, slot + c * ARRAY_SLOTS, w, dtype, ndim, writable)
                for c, (dtype, ndim) in enumerate(columns)
            )
        )
    kinds = [_array_type(dtype, ndim, writable) for dtype, ndim in columns]
    table = types.NamedTuple(kinds, component.Table)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, address: Any, slot: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            slots = builder.inttoptr(arguments[0], SLOT.as_pointer())
            starts = [builder.add(arguments[1], ir.Constant(SLOT, c * ARRAY_SLOTS)) for c in range(len(kinds))]
            arrays = [
                _array(context, builder, k, slots, start, arguments[2], component.packed)
                for k, start in zip(kinds, starts, strict=True)
            ]
            return context.make_tuple(builder, table, arrays)

        return table(types.intp, types.intp, types.intp), generate

    return view


@functools.cache
def number_view(kind: str, python: bool) -> Any:
    """A function (arguments, slot) -> the number at `slot`; kind: "int64" or "float32"."""
    if python or not compiled():
        dtype = np.dtype(kind)
        return lambda arguments, slot: arguments.slots[slot : slot + 1].view(dtype)[0]
    value = getattr(types, kind)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, address: Any, slot: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            slots = builder.inttoptr(arguments[0], SLOT.as_pointer())
            pointer = builder.gep(slots, [arguments[1]])
            return builder.load(builder.bitcast(pointer, context.get_data_type(value).as_pointer()))

        return value(types.intp, types.intp), generate

    return view


def _array_type(dtype: np.dtype[Any], ndim: int, writable: bool) -> Any:
    return types.Array(from_dtype(dtype), ndim, "C", readonly=not writable)


def _load_slot(builder: Any, slots: Any, slot: Any) -> Any:
    return builder.load(builder.gep(slots, [slot]))


def _array(context: Any, builder: Any, kind: Any, slots: Any, start: Any, w: Any, packed: bool) -> Any:
    """Numba's array structure for world w, from the slots that begin at `start`.

    Packed columns share one stride, so that it is loaded and multiplied once for all of them.
    """
    model = context.data_model_manager[kind]
    element = context.get_data_type(kind.dtype)
    itemsize = ir.Constant(SLOT, context.get_abi_sizeof(element))
    shape = [_load_slot(builder, slots, builder.add(start, ir.Constant(SLOT, 2 + axis))) for axis in range(kind.ndim)]
    strides, count = [itemsize], shape[0]
    for size in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], size))
        count = builder.mul(count, size)
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


def _python_array(
    slots: np.ndarray[Any, Any], slot: int, w: int, dtype: np.dtype[Any], ndim: int, writable: bool
) -> np.ndarray[Any, Any]:
    """The array at `slot` for world w, in plain Python: for uncompiled runs and for systems that stay Python."""
    address, stride, *shape = map(int, slots[slot : slot + 2 + ndim])
    memory: Any = (ctypes.c_char * (int(np.prod(shape)) * dtype.itemsize)).from_address(address + w * stride)
    array: np.ndarray[Any, Any] = np.ndarray(tuple(shape), dtype, memory)
    array.flags.writeable = writable
    return array
