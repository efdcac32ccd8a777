"""SIMD for kernels: vectors of 16 float32 from a block of rows, and masks of them as bitsets.

    x, y = load(body.x, 16 * b) - px, load(body.y, 16 * b) - py
    hits = to_bits(x * x + y * y <= square) & alive[b]
    while hits:
        e = 16 * b + trailing_zeros(hits)
        hits &= hits - 1

A kernel that tests all rows, of which few pass, finds these few with a few vector instructions. Vectors have sums,
differences, products and comparisons, each lane rounded like a scalar. In kernels, vectors and masks have their own
types; in plain Python, they are numpy arrays of 16. A bitset has 16 bits for each block: bit j of block b is row
16 b + j (Bitset in declarations.access).

A column may be read past its end. The values there are arbitrary, and no bitset includes these rows.
"""

import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaTypeError
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import models, register_model

from .jit import BOUNDS_CHECKS, intrinsic

SIMD_WIDTH, SIMD_SHIFT = 16, 4  # row e is bit e & SIMD_WIDTH - 1 of block e >> SIMD_SHIFT
FLOATS = ir.VectorType(ir.FloatType(), SIMD_WIDTH)
BOOLEANS = ir.VectorType(ir.IntType(1), SIMD_WIDTH)
INDEX, BYTE = ir.IntType(32), ir.IntType(8)
BYTES = 64  # bytes compared at a time
LARGEST, NO_BYTE = 254, 255  # the maximum that store_bytes writes; its value for lanes that are left out


class VectorType(types.Type):  # type: ignore[misc]
    """Numba's type of a vector of 16 float32."""


class MaskType(types.Type):  # type: ignore[misc]
    """Numba's type of a vector of 16 booleans."""


VECTOR, MASK = VectorType("Vector"), MaskType("Mask")


def _model(value: Any) -> type[Any]:
    class Model(models.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, manager: Any, kind: Any) -> None:
            super().__init__(manager, kind, value)

    return Model


register_model(VectorType)(_model(FLOATS))
register_model(MaskType)(_model(BOOLEANS))


def _define(function: Any, result: types.Type, cases: list[tuple[types.Type, ...]], emit: Callable[..., Any]) -> None:
    """Define an operator on these types for numba: emit(builder, *values) generates its instruction."""
    signatures = [signature(result, *case) for case in cases]
    infer_global(function)(type("Template", (ConcreteTemplate,), {"key": function, "cases": signatures}))

    def lower(context: Any, builder: Any, kinds: Any, values: Any) -> Any:
        return emit(builder, *values)

    for case in cases:
        lower_builtin(function, *case)(lower)


def _broadcast(builder: Any, value: Any) -> Any:
    """Return a vector with a scalar in every lane; a vector is returned as it is."""
    return value if value.type == FLOATS else _repeat(builder, value, SIMD_WIDTH)


def _repeat(builder: Any, value: Any, count: int) -> Any:
    """Return a vector with a scalar in each of `count` lanes."""
    nothing = ir.Constant(ir.VectorType(value.type, count), ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(INDEX, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(INDEX, count), [0] * count))


def _on_floats(name: str, *before: str) -> Callable[..., Any]:
    def emit(builder: Any, left: Any, right: Any) -> Any:
        return getattr(builder, name)(*before, _broadcast(builder, left), _broadcast(builder, right))

    return emit


_PAIRS = [(VECTOR, VECTOR), (VECTOR, types.float32), (types.float32, VECTOR)]
for _function, _name in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul")):
    _define(_function, VECTOR, _PAIRS, _on_floats(_name))
for _function, _sign in ((operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">=")):
    _define(_function, MASK, _PAIRS, _on_floats("fcmp_ordered", _sign))
_define(operator.and_, MASK, [(MASK, MASK)], lambda builder, *values: builder.and_(*values))
_define(operator.or_, MASK, [(MASK, MASK)], lambda builder, *values: builder.or_(*values))
_define(operator.invert, MASK, [(MASK,)], lambda builder, value: builder.not_(value))
_define(abs, VECTOR, [(VECTOR,)], lambda builder, value: builder.call(_absolute(builder), [value]))


def _absolute(builder: Any) -> Any:
    kind = ir.FunctionType(FLOATS, [FLOATS])
    return cgutils.get_or_insert_function(builder.module, kind, f"llvm.fabs.v{SIMD_WIDTH}f32")


def _check_column(column: Any, element: Any, written: bool = False) -> None:
    """Raise NumbaTypeError unless vectors of these elements can be read from a column, or written to it."""
    if getattr(column, "ndim", 0) != 1 or (column.dtype, column.layout) != (element, "C"):
        raise NumbaTypeError(f"a column of {element} with one axis is needed, not {column}")
    if written and not column.mutable:
        raise NumbaTypeError(f"Cannot modify readonly array of type: {column}")  # numba's own words for item assignment


def _pointer(context: Any, builder: Any, kind: Any, arguments: Any, vector: Any, whole: bool = False) -> Any:
    """Return the address of a vector in an array, given the index of its first element.

    In a user's system, raises IndexError if the first element (with `whole`, any element) is outside the array.
    """
    array, start = arguments[:2]
    data = builder.extract_value(array, context.data_model_manager[kind].get_field_position("data"))
    if BOUNDS_CHECKS and not hasattr(kind, "unchecked"):
        (size,) = cgutils.unpack_tuple(builder, cgutils.create_struct_proxy(kind)(context, builder, array).shape)
        end = builder.add(start, ir.Constant(start.type, vector.count if whole else 1))
        within = builder.and_(
            builder.icmp_signed(">=", start, ir.Constant(start.type, 0)), builder.icmp_signed("<=", end, size)
        )
        with builder.if_then(builder.not_(within), likely=False):
            context.call_conv.return_user_exc(builder, IndexError, ("a vector is out of bounds of its array",))
    return builder.bitcast(builder.gep(data, [start]), vector.as_pointer())


def _padded(column: Any, start: int) -> Any:
    piece = column[start : start + SIMD_WIDTH]
    return np.concatenate([piece, np.zeros(SIMD_WIDTH - len(piece), column.dtype)])


def _python_store(column: Any, start: int, value: Any) -> None:
    column[start : start + SIMD_WIDTH] = value


def _python_store_bytes(column: Any, start: int, value: Any, bits: int) -> None:
    whole = np.where(value > 0, np.minimum(value, LARGEST), 0).astype(np.uint8)
    column[start : start + SIMD_WIDTH] = np.where(bits >> np.arange(SIMD_WIDTH) & 1, whole, NO_BYTE)


def _python_overlap(low: Any, high: Any, start: int, first: int, last: int) -> Any:
    ranges = slice(start, start + BYTES)
    return np.packbits((low[ranges] <= last) & (high[ranges] >= first), bitorder="little").view(np.int64)[0]


def _python_load_flags(column: Any, start: int) -> Any:
    return _padded(column, start) != 0


def _python_trailing_zeros(word: int) -> int:
    return (int(word) & -int(word)).bit_length() - 1


def _python_to_bits(mask: Any) -> int:
    return int(np.packbits(mask, bitorder="little").view(np.uint16)[0])


@intrinsic(_padded)
def load(typing: Any, column: Any, start: Any) -> Any:
    """(float32 column, start) -> vector of the 16 elements from the index `start` on."""
    _check_column(column, types.float32)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        return builder.load(_pointer(context, builder, kinds.args[0], arguments, FLOATS), align=4)

    return VECTOR(column, types.intp), generate


@intrinsic(_python_store)
def store(typing: Any, column: Any, start: Any, value: Any) -> Any:
    """(float32 array, start, vector): write a vector from the index `start` on; all 16 must be in the array."""
    _check_column(column, types.float32, written=True)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, kinds.args[0], arguments, FLOATS, whole=True)
        builder.store(arguments[2], pointer, align=4)
        return context.get_dummy_value()

    return types.void(column, types.intp, value), generate


@intrinsic(_python_load_flags)
def load_flags(typing: Any, column: Any, start: Any) -> Any:
    """(uint8 column, start) -> mask of the elements from the index `start` on that are not 0."""
    _check_column(column, types.uint8)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        vector = ir.VectorType(BYTE, SIMD_WIDTH)
        values = builder.load(_pointer(context, builder, kinds.args[0], arguments, vector), align=1)
        return builder.icmp_unsigned("!=", values, ir.Constant(vector, [0] * SIMD_WIDTH))

    return MASK(column, types.intp), generate


@intrinsic(_python_to_bits)
def to_bits(typing: Any, mask: Any) -> Any:
    """(mask) -> int: bit j is lane j."""

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        return builder.zext(builder.bitcast(arguments[0], ir.IntType(SIMD_WIDTH)), ir.IntType(64))

    return types.int64(mask), generate


@intrinsic(_python_trailing_zeros)
def trailing_zeros(typing: Any, word: Any) -> Any:
    """(int > 0) -> index of its lowest 1."""
    return types.int64(types.int64), lambda context, builder, kinds, arguments: builder.cttz(
        arguments[0], ir.Constant(ir.IntType(1), 1)
    )


@intrinsic(_python_store_bytes)
def store_bytes(typing: Any, column: Any, start: Any, value: Any, bits: Any) -> Any:
    """(uint8 array, start, vector, bitset): write a vector, rounded down to integers from 0 to LARGEST.

    NaN becomes 0. Lanes that are not in the bitset become NO_BYTE.
    """
    _check_column(column, types.uint8, written=True)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        value, kind = arguments[2], ir.VectorType(BYTE, SIMD_WIDTH)
        for sign, limit in ((">", 0), ("<", LARGEST)):
            bound = ir.Constant(FLOATS, [limit] * SIMD_WIDTH)
            value = builder.select(builder.fcmp_ordered(sign, value, bound), value, bound)
        chosen = builder.bitcast(builder.trunc(arguments[3], ir.IntType(SIMD_WIDTH)), BOOLEANS)
        value = builder.select(chosen, builder.fptoui(value, kind), ir.Constant(kind, [NO_BYTE] * SIMD_WIDTH))
        builder.store(value, _pointer(context, builder, kinds.args[0], arguments, kind, whole=True), align=1)
        return context.get_dummy_value()

    return types.void(column, types.intp, VECTOR, types.int64), generate


@intrinsic(_python_overlap)
def overlap(typing: Any, low: Any, high: Any, start: Any, first: Any, last: Any) -> Any:
    """(uint8 columns low and high, start, first, last) -> int: which of 64 ranges overlap the one from first to last.

    Bit j is for the range from low[start + j] to high[start + j]. Ranges include their ends.
    """
    _check_column(low, types.uint8)
    _check_column(high, types.uint8)

    def generate(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
        vector = ir.VectorType(BYTE, BYTES)
        places = [_pointer(context, builder, kinds.args[k], (arguments[k], arguments[2]), vector) for k in range(2)]
        lows, highs = (builder.load(place, align=1) for place in places)
        begun = builder.icmp_unsigned("<=", lows, _repeat(builder, arguments[4], BYTES))
        unended = builder.icmp_unsigned(">=", highs, _repeat(builder, arguments[3], BYTES))
        return builder.bitcast(builder.and_(begun, unended), ir.IntType(BYTES))

    return types.int64(low, high, types.intp, types.uint8, types.uint8), generate
