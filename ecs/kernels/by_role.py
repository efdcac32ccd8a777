"""Numbers that may differ by role, in kernels: one value, or an array with an element for every row.

The systems of a mechanic get that array instead of the number if a role changes it. `of` reads either, so a kernel is
written once, and compiles to the same code as without roles if none changes the number.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from .jit import intrinsic

FLAG = ir.IntType(1)
OUTSIDE = "the row is out of bounds"


def _is_array(number: Any) -> bool:
    return isinstance(number, np.ndarray)


def _element(number: Any, e: int) -> Any:
    if not _is_array(number):
        return number
    if not 0 <= e < len(number):
        raise IndexError(f"of(number, {e}): {OUTSIDE}")
    return number[e] if number.dtype.kind == "f" else np.int64(number[e])


@intrinsic(_element)
def of(typing: Any, number: Any, e: Any) -> Any:
    """Return the number for the entity in row `e`: that of its role if roles differ in it, otherwise the game's."""
    if not hasattr(number, "ndim"):  # not an array
        return number(number, types.intp), lambda context, builder, kinds, arguments: arguments[0]

    def element(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        array = cgutils.create_struct_proxy(kinds.args[0])(context, builder, arguments[0])
        if not hasattr(number, "unchecked"):  # in a system from outside of outlast
            (size,) = cgutils.unpack_tuple(builder, array.shape)
            with builder.if_then(builder.icmp_unsigned(">=", arguments[1], size), likely=False):
                context.call_conv.return_user_exc(builder, IndexError, (f"of(number, row): {OUTSIDE}",))
        value = builder.load(builder.gep(array.data, [arguments[1]]))
        return value if kinds.return_type == types.float32 else builder.sext(value, ir.IntType(64))

    value = types.float32 if number.dtype == types.float32 else types.int64
    return value(number, types.intp), element


@intrinsic(_is_array)
def differs(typing: Any, number: Any) -> Any:
    """Return whether roles differ in a number. Known at compile time, so the other branch costs nothing."""
    value = hasattr(number, "ndim")
    return types.boolean(number), lambda context, builder, kinds, arguments: ir.Constant(FLAG, value)
