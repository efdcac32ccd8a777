"""One world's share of a column, made from an address without taking a reference.

The tick builds about a hundred such arrays a world. Slicing numpy arrays would count references up and down for each,
atomically; these borrow: the Worlds object that owns the memory outlives the call.
"""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numba import from_dtype, types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

from .jit import compiled


def view_name(dtype: np.dtype[Any], ndim: int, writable: bool) -> str:
    """Name of the view function in generated code, e.g. "f4_2_r"."""
    return f"{dtype.str[1:]}_{ndim}_{'w' if writable else 'r'}"


@cache
def view_function(dtype: np.dtype[Any], ndim: int, writable: bool) -> Any:
    """A function (address, shape) -> C-contiguous array of `dtype`, `ndim` dimensions, for generated code."""
    return _compiled_view(dtype, ndim, writable) if compiled() else python_view(dtype, writable)


def python_view(dtype: np.dtype[Any], writable: bool) -> Any:
    """The same in plain Python, for uncompiled runs and for systems that stay Python."""

    def view(address: int, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
        size = int(np.prod(shape)) * dtype.itemsize
        memory: Any = (ctypes.c_char * size).from_address(int(address))
        array: np.ndarray[Any, Any] = np.ndarray(shape, dtype, memory)
        array.flags.writeable = writable
        return array

    return view


def _compiled_view(dtype: np.dtype[Any], ndim: int, writable: bool) -> Any:
    array = types.Array(from_dtype(dtype), ndim, "C", readonly=not writable)

    @intrinsic  # type: ignore[untyped-decorator]
    def view(typing: Any, address: Any, shape: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            result = make_array(array)(context, builder)
            sizes = cgutils.unpack_tuple(builder, arguments[1])
            itemsize = context.get_constant(types.intp, dtype.itemsize)
            strides = [itemsize]
            for size in sizes[:0:-1]:
                strides.insert(0, builder.mul(strides[0], size))
            data = builder.inttoptr(arguments[0], result.data.type)
            populate_array(result, data=data, shape=sizes, strides=strides, itemsize=itemsize, meminfo=None)
            return result._getvalue()

        return array(types.intp, types.UniTuple(types.intp, ndim)), generate

    return view
