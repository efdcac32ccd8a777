"""Vectors of 16 float32 at addresses, for the kernels of networks, and products of matrices made of them.

PyTorch computes products of matrices this small at half the speed or less, and needs some microseconds for each call.
"""

import ctypes
import inspect
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from .jit import intrinsic, noinline_kernel
from .simd import FLOATS, SIMD_WIDTH, VECTOR

HEAD = 8  # numbers of a head of attention: half a vector
FLOAT, BYTES = 4, 4 * SIMD_WIDTH  # bytes of a number, and of a vector
SCALAR, WORD, WORDS = ir.FloatType(), ir.IntType(32), ir.VectorType(ir.IntType(32), SIMD_WIDTH)
SERIES = (1 / 720, 1 / 120, 1 / 24, 1 / 6, 0.5, 1.0, 1.0)  # of the exponential, for numbers of up to log(2) / 2
LEAST = -87.0  # smaller numbers have the exponential of this one, 2e-38


def _vector(address: int) -> Any:
    """Return the vector at an address, as an array."""
    memory: Any = (ctypes.c_float * SIMD_WIDTH).from_address(address)
    return np.frombuffer(memory, np.float32)


def _function(builder: Any, name: str, count: int) -> Callable[..., Any]:
    """Return a function of LLVM with `count` vectors as arguments."""
    kind = ir.FunctionType(FLOATS, [FLOATS] * count)
    found = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{SIMD_WIDTH}f32")
    return lambda *values: builder.call(found, values)


def _repeated(builder: Any, value: Any) -> Any:
    """Return a vector of a number."""
    one = builder.insert_element(FLOATS(ir.Undefined), value, WORD(0))
    return builder.shuffle_vector(one, FLOATS(ir.Undefined), WORDS(None))


def _pointer(builder: Any, address: Any, offset: int = 0, kind: Any = FLOATS) -> Any:
    return builder.inttoptr(builder.add(address, address.type(offset)), kind.as_pointer())


def _operation(python: Any, result: types.Type, *kinds: types.Type) -> Any:
    """Decorate emit(builder, *values), which generates an operation. python: Its plain form."""

    def define(emit: Callable[..., Any]) -> Any:
        def typing(context: Any, *given: Any) -> Any:
            return result(*kinds), lambda context, builder, signature, values: emit(builder, *values)

        names = "context", *(f"value{k}" for k in range(len(kinds)))
        ordered = [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
        typing.__name__, typing.__signature__ = emit.__name__, inspect.Signature(ordered)  # type: ignore[attr-defined]
        return intrinsic(python)(typing)

    return define


@_operation(lambda address: _vector(address).copy(), VECTOR, types.intp)  # type: ignore[untyped-decorator]
def load(builder: Any, address: Any) -> Any:
    """(address) -> vector."""
    return builder.load(_pointer(builder, address), align=FLOAT)


@_operation(lambda address, value: np.copyto(_vector(address), value), types.void, types.intp, VECTOR)  # type: ignore[untyped-decorator]
def store(builder: Any, address: Any, value: Any) -> Any:
    """(address, vector): write it."""
    builder.store(value, _pointer(builder, address), align=FLOAT)
    return ir.Constant(ir.IntType(8).as_pointer(), None)


@_operation(lambda value: np.full(SIMD_WIDTH, value, np.float32), VECTOR, types.float32)  # type: ignore[untyped-decorator]
def repeated(builder: Any, value: Any) -> Any:
    """Fill a vector with a number."""
    return _repeated(builder, value)


@_operation(np.maximum, VECTOR, VECTOR, VECTOR)  # type: ignore[untyped-decorator]
def larger(builder: Any, one: Any, other: Any) -> Any:
    """(vector, vector) -> the larger numbers of both."""
    return builder.select(builder.fcmp_ordered("<", one, other), other, one)


@_operation(np.divide, VECTOR, VECTOR, VECTOR)  # type: ignore[untyped-decorator]
def quotient(builder: Any, one: Any, other: Any) -> Any:
    """(vector, vector) -> quotients."""
    return builder.fdiv(one, other)


@_operation(lambda value, gate: np.where(gate > 0, value, np.float32(0)), VECTOR, VECTOR, VECTOR)  # type: ignore[untyped-decorator]
def gated(builder: Any, value: Any, gate: Any) -> Any:
    """(vector, vector) -> the first, with 0 where the second is not positive."""
    zero = FLOATS([0.0] * SIMD_WIDTH)
    return builder.select(builder.fcmp_ordered(">", gate, zero), value, zero)


@_operation(lambda value: value.reshape(-1, HEAD).sum(1).repeat(HEAD), VECTOR, VECTOR)  # type: ignore[untyped-decorator]
def head_sums(builder: Any, value: Any) -> Any:
    """(vector) -> the sum of each half of it, in all places of that half."""
    for distance in (4, 2, 1):
        places = WORDS([k ^ distance for k in range(SIMD_WIDTH)])
        value = builder.fadd(value, builder.shuffle_vector(value, value, places))
    return value


@_operation(lambda value: np.exp(np.maximum(value, np.float32(LEAST))), VECTOR, VECTOR)  # type: ignore[untyped-decorator]
def exponential(builder: Any, value: Any) -> Any:
    """(vector) -> the exponential of numbers of at most 0, with an error of about 1e-7 of it."""

    def all_of(number: float) -> Any:
        return FLOATS([float(np.float32(number))] * SIMD_WIDTH)

    multiply = _function(builder, "fmuladd", 3)
    value = builder.select(builder.fcmp_ordered("<", value, all_of(LEAST)), all_of(LEAST), value)
    whole = _function(builder, "floor", 1)(multiply(value, all_of(1 / np.log(2)), all_of(0.5)))
    rest = multiply(whole, all_of(-0.693359375), value)  # log(2) in two parts, since it is not a float32
    rest = multiply(whole, all_of(2.12194440e-4), rest)
    found = all_of(SERIES[0])
    for factor in SERIES[1:]:
        found = multiply(found, rest, all_of(factor))
    power = builder.shl(builder.add(builder.fptosi(whole, WORDS), WORDS([127] * SIMD_WIDTH)), WORDS([23] * SIMD_WIDTH))
    return builder.fmul(found, builder.bitcast(power, FLOATS))


def _matrix(address: int, row: int, step: int, shape: tuple[int, int]) -> Any:
    """Return a matrix at an address, float32, with bytes between its rows and between its columns."""
    size = FLOAT + row * (shape[0] - 1) + step * (shape[1] - 1)
    memory: Any = (ctypes.c_char * size).from_address(address)
    return np.ndarray(shape, np.float32, memory, strides=(row, step))


def _block(rows: int, vectors: int) -> Any:
    """Return the intrinsic for one block of `rows` rows of `vectors` vectors. For arguments, see `product`."""

    def plain(
        a: int,
        a_row: int,
        a_step: int,
        b: int,
        b_step: int,
        start: int,
        start_row: int,
        c: int,
        c_row: int,
        depth: int,
        low: float,
    ) -> None:
        width = vectors * SIMD_WIDTH
        first = _matrix(start, start_row, FLOAT, (rows, width)) + np.float32(0)
        for t in range(depth):
            first += _matrix(a + t * a_step, a_row, FLOAT, (rows, 1)) * _matrix(b + t * b_step, 0, FLOAT, (1, width))
        _matrix(c, c_row, FLOAT, (rows, width))[:] = np.where(first < low, low, first)

    @intrinsic(plain)
    def block(
        typing: Any, a: Any, a_row: Any, a_step: Any, b: Any, b_step: Any, start: Any, start_row: Any,
        c: Any, c_row: Any, depth: Any, low: Any,
    ) -> Any:  # fmt: skip
        def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            a, a_row, a_step, b, b_step, start, start_row, c, c_row, depth, low = given

            def row(address: Any, stride: Any, r: int) -> Any:
                return builder.add(address, builder.mul(stride, address.type(r)))

            multiply = _function(builder, "fmuladd", 3)
            sums = [[cgutils.alloca_once(builder, FLOATS) for _ in range(vectors)] for _ in range(rows)]
            for r in range(rows):
                for v in range(vectors):
                    first = _pointer(builder, row(start, start_row, r), v * BYTES)
                    builder.store(builder.load(first, align=FLOAT), sums[r][v])
            lines = [row(a, a_row, r) for r in range(rows)]
            with cgutils.for_range(builder, depth) as loop:
                t = loop.index
                here = builder.add(b, builder.mul(t, b_step))
                values = [builder.load(_pointer(builder, here, v * BYTES), align=FLOAT) for v in range(vectors)]
                moved = builder.mul(t, a_step)
                for r in range(rows):
                    factor = _repeated(
                        builder, builder.load(_pointer(builder, builder.add(lines[r], moved), 0, SCALAR))
                    )
                    for v in range(vectors):
                        total = multiply(factor, values[v], builder.load(sums[r][v]))
                        builder.store(total, sums[r][v])
            lowest = _repeated(builder, low)
            for r in range(rows):
                for v in range(vectors):
                    total = builder.load(sums[r][v])
                    total = builder.select(builder.fcmp_ordered("<", total, lowest), lowest, total)
                    builder.store(total, _pointer(builder, row(c, c_row, r), v * BYTES), align=FLOAT)
            return context.get_dummy_value()

        return types.void(*[types.intp] * 10, types.float32), generate

    return block


_large, _narrow, _row, _single = (_block(*shape) for shape in ((8, 2), (8, 1), (1, 2), (1, 1)))


@noinline_kernel
def product(
    a: int, a_row: int, a_step: int, b: int, b_step: int, start: int, start_row: int, c: int, c_row: int, rows: int,
    columns: int, depth: int, low: float,
) -> None:  # fmt: skip
    """Compute c = max(start + a @ b, low), float32, at addresses.

    Args:
        a: The first factor (rows, depth).
        a_row: Bytes from one of its rows to the next.
        a_step: Bytes from one of its columns to the next.
        b: The second factor (depth, columns).
        b_step: Bytes from one of its rows to the next; its columns are side by side.
        start: The summand, (rows, columns); may be `c` itself.
        start_row: Bytes from one of its rows to the next; 0: the same for all.
        c: The result (rows, columns).
        c_row: Bytes from one of its rows to the next.
        rows: Rows of a and c.
        columns: Columns of b and c, a multiple of 16.
        depth: Columns of a.
        low: Lower limit of the results; minus infinity for none.
    """
    wide, whole = columns - columns % 32, rows - rows % 8
    for i in range(0, whole, 8):
        x, s, y = a + i * a_row, start + i * start_row, c + i * c_row
        for j in range(0, 4 * wide, 128):
            _large(x, a_row, a_step, b + j, b_step, s + j, start_row, y + j, c_row, depth, low)
        if wide < columns:
            j = 4 * wide
            _narrow(x, a_row, a_step, b + j, b_step, s + j, start_row, y + j, c_row, depth, low)
    for i in range(whole, rows):
        x, s, y = a + i * a_row, start + i * start_row, c + i * c_row
        for j in range(0, 4 * wide, 128):
            _row(x, a_row, a_step, b + j, b_step, s + j, start_row, y + j, c_row, depth, low)
        if wide < columns:
            j = 4 * wide
            _single(x, a_row, a_step, b + j, b_step, s + j, start_row, y + j, c_row, depth, low)
