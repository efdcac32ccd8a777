"""One world's share of the tables, made from addresses without taking references.

The tick makes some hundred such arrays a world. Slicing numpy arrays would count references up and down for each,
atomically; these borrow: the Worlds object that owns the memory outlives the call. The code is built by hand, field by
field, as numba's own way of making arrays would take seconds to compile for so many.

A row of numbers describes an array: int64 [address, stride from world to world in bytes, shape ...].
"""

import ctypes
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.extending import intrinsic

from .component import Component
from .jit import compiled

DIMENSIONS = 4  # at most, of a column in one world
WIDTH = 2 + DIMENSIONS  # of a row of numbers
WORD = ir.IntType(64)


def describe(array: np.ndarray[Any, Any], stride: int, shape: tuple[int, ...]) -> list[int]:
    """The row of numbers of an array whose part for world w has `shape` and starts w * stride bytes in."""
    return [array.ctypes.data, stride, *shape, *[0] * (DIMENSIONS - len(shape))]


def array_view(dtype: np.dtype[Any], ndim: int, writable: bool, python: bool) -> Any:
    """A function (rows, k, w) -> the array that row k of `rows`, int64 (n, WIDTH), describes, for world w."""
    if python or not compiled():
        return lambda rows, k, w: _python_array(rows[k], w, dtype, ndim, writable)
    kind = _array_type(dtype, ndim, writable)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, rows: Any, k: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            start = builder.mul(arguments[1], ir.Constant(WORD, WIDTH))
            return _array(context, builder, kind, _data(context, builder, rows, arguments[0]), start, arguments[2])

        return kind(rows, types.intp, types.intp), generate

    return view


def table_view(component: type[Component], ndims: list[int], writable: bool, python: bool) -> Any:
    """A function (rows, first, w) -> table of `component` for world w; its columns are the rows from `first` on."""
    dtypes = [column.dtype for column in component.columns.values()]
    columns = list(zip(dtypes, ndims, strict=True))
    if python or not compiled():
        return lambda rows, first, w: component.Table(
            *(_python_array(rows[first + c], w, dtype, ndim, writable) for c, (dtype, ndim) in enumerate(columns))
        )
    kinds = [_array_type(dtype, ndim, writable) for dtype, ndim in columns]
    table = types.NamedTuple(kinds, component.Table)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, rows: Any, first: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            data = _data(context, builder, rows, arguments[0])
            start = builder.mul(arguments[1], ir.Constant(WORD, WIDTH))
            starts = [builder.add(start, ir.Constant(WORD, c * WIDTH)) for c in range(len(kinds))]
            arrays = [_array(context, builder, k, data, s, arguments[2]) for k, s in zip(kinds, starts, strict=True)]
            return context.make_tuple(builder, table, arrays)

        return table(rows, types.intp, types.intp), generate

    return view


def _array_type(dtype: np.dtype[Any], ndim: int, writable: bool) -> Any:
    return types.Array(from_dtype(dtype), ndim, "C", readonly=not writable)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    """Pointer to the elements of an array that was passed in."""
    return builder.extract_value(value, context.data_model_manager[kind].get_field_position("data"))


def _array(context: Any, builder: Any, kind: Any, data: Any, start: Any, w: Any) -> Any:
    """Numba's array structure for the row of numbers that begins `start` words into `data`."""

    def number(k: int) -> Any:
        return builder.load(builder.gep(data, [builder.add(start, ir.Constant(WORD, k))]))

    model = context.data_model_manager[kind]
    itemsize = ir.Constant(WORD, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    shape = [number(2 + axis) for axis in range(kind.ndim)]
    strides = [itemsize]
    for size in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], size))
    count = builder.udiv(builder.mul(strides[0], shape[0]), itemsize)
    address = builder.add(number(0), builder.mul(w, number(1)))
    pointer = builder.inttoptr(
        address, model.get_member_fe_type("data") and context.get_data_type(kind.dtype).as_pointer()
    )
    fields = {"nitems": count, "itemsize": itemsize, "data": pointer, "shape": shape, "strides": strides}
    result = ir.Constant(model.get_value_type(), None)  # no owner: nothing is counted
    for name, value in fields.items():
        position = model.get_field_position(name)
        parts = enumerate(value) if isinstance(value, list) else [(None, value)]
        for axis, part in parts:
            result = builder.insert_value(result, part, [position] if axis is None else [position, axis])
    return result


def _python_array(row: Any, w: int, dtype: np.dtype[Any], ndim: int, writable: bool) -> np.ndarray[Any, Any]:
    """The same in plain Python, for uncompiled runs and for systems that stay Python."""
    shape = tuple(int(size) for size in row[2 : 2 + ndim])
    memory: Any = (ctypes.c_char * (int(np.prod(shape)) * dtype.itemsize)).from_address(int(row[0]) + w * int(row[1]))
    array: np.ndarray[Any, Any] = np.ndarray(shape, dtype, memory)
    array.flags.writeable = writable
    return array
