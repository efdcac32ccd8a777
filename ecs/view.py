"""What kernels are given, made from the words of a frame without taking references.

The tick makes some hundred arrays a world. Slicing numpy arrays would count references up and down for each,
atomically; these borrow: the Worlds object that owns the memory outlives the call. The code is built by hand, field by
field, as numba's own way of making arrays would take seconds to compile for so many. What a kernel does not use of an
array (its shape, most often) the compiler leaves out. Each is made once a process: numba keeps its intrinsics for ever.
"""

import ctypes
import functools
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.extending import intrinsic

from .component import Component
from .frame import STRIDE, WIDTH
from .jit import compiled

WORD = ir.IntType(64)


@functools.cache
def array_view(dtype: np.dtype[Any], ndim: int, writable: bool, python: bool) -> Any:
    """A function (frame, place, w) -> the array at word `place`, for world w."""
    if python or not compiled():
        return lambda frame, place, w: _python_array(frame.words, place, w, dtype, ndim, writable)
    kind = _array_type(dtype, ndim, writable)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, frame: Any, place: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            words = builder.inttoptr(arguments[0], WORD.as_pointer())
            return _array(context, builder, kind, words, arguments[1], arguments[2], packed=False)

        return kind(types.intp, types.intp, types.intp), generate

    return view


@functools.cache
def table_view(component: type[Component], ndims: tuple[int, ...], writable: bool, python: bool) -> Any:
    """A function (frame, first, w) -> table of `component` for world w; its columns are at word `first` and after."""
    columns = [(column.dtype, ndim) for column, ndim in zip(component.columns.values(), ndims, strict=True)]
    if python or not compiled():
        return lambda frame, first, w: component.Table(
            *(
                _python_array(frame.words, first + c * WIDTH, w, dtype, ndim, writable)
                for c, (dtype, ndim) in enumerate(columns)
            )
        )
    kinds = [_array_type(dtype, ndim, writable) for dtype, ndim in columns]
    table = types.NamedTuple(kinds, component.Table)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, frame: Any, first: Any, w: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            words = builder.inttoptr(arguments[0], WORD.as_pointer())
            starts = [builder.add(arguments[1], ir.Constant(WORD, c * WIDTH)) for c in range(len(kinds))]
            arrays = [
                _array(context, builder, k, words, start, arguments[2], component.packed)
                for k, start in zip(kinds, starts, strict=True)
            ]
            return context.make_tuple(builder, table, arrays)

        return table(types.intp, types.intp, types.intp), generate

    return view


@functools.cache
def number_view(kind: str, python: bool) -> Any:
    """A function (frame, place) -> the number at word `place`: kind "int64" or "float32"."""
    if python or not compiled():
        dtype = np.dtype(kind)
        return lambda frame, place: frame.words[place : place + 1].view(dtype)[0]
    value = getattr(types, kind)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, frame: Any, place: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            words = builder.inttoptr(arguments[0], WORD.as_pointer())
            pointer = builder.gep(words, [arguments[1]])
            return builder.load(builder.bitcast(pointer, context.get_data_type(value).as_pointer()))

        return value(types.intp, types.intp), generate

    return view


def _array_type(dtype: np.dtype[Any], ndim: int, writable: bool) -> Any:
    return types.Array(from_dtype(dtype), ndim, "C", readonly=not writable)


def _word(builder: Any, words: Any, place: Any) -> Any:
    return builder.load(builder.gep(words, [place]))


def _array(context: Any, builder: Any, kind: Any, words: Any, start: Any, w: Any, packed: bool) -> Any:
    """Numba's array structure for world w and the words from `start` on.

    Packed columns share one stride, so that it is loaded and multiplied once for all of them.
    """
    model = context.data_model_manager[kind]
    element = context.get_data_type(kind.dtype)
    itemsize = ir.Constant(WORD, context.get_abi_sizeof(element))
    shape = [_word(builder, words, builder.add(start, ir.Constant(WORD, 2 + axis))) for axis in range(kind.ndim)]
    strides, count = [itemsize], shape[0]
    for size in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], size))
        count = builder.mul(count, size)
    stride = ir.Constant(WORD, STRIDE) if packed else builder.add(start, ir.Constant(WORD, 1))
    address = builder.add(_word(builder, words, start), builder.mul(w, _word(builder, words, stride)))
    pointer = builder.inttoptr(address, element.as_pointer())
    fields = {"nitems": count, "itemsize": itemsize, "data": pointer, "shape": shape, "strides": strides}
    result = ir.Constant(model.get_value_type(), None)  # no owner: nothing is counted
    for name, value in fields.items():
        position = model.get_field_position(name)
        parts = enumerate(value) if isinstance(value, list) else [(None, value)]
        for axis, part in parts:
            result = builder.insert_value(result, part, [position] if axis is None else [position, axis])
    return result


def _python_array(
    words: np.ndarray[Any, Any], place: int, w: int, dtype: np.dtype[Any], ndim: int, writable: bool
) -> np.ndarray[Any, Any]:
    """The same in plain Python, for uncompiled runs and for systems that stay Python."""
    address, stride, *shape = (int(word) for word in words[place : place + 2 + ndim])
    memory: Any = (ctypes.c_char * (int(np.prod(shape)) * dtype.itemsize)).from_address(address + w * stride)
    array: np.ndarray[Any, Any] = np.ndarray(tuple(shape), dtype, memory)
    array.flags.writeable = writable
    return array
