"""Attention among the rows of each agent in compiled code for the CPU; networks.Extractor has it in PyTorch.

An agent sees one or two rows. PyTorch needs lists of all pairs of rows and about twenty operations on them, and spends
most of its time on lists and calls.
"""

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from outlast.ecs.kernels.jit import compiled, kernel, loader
from outlast.ecs.kernels.vectors import BYTES, HEAD, exponential, head_sums, larger, load, quotient, repeated, store
from outlast.envs.core.visible_rows import called

Array = np.ndarray[Any, Any]
read_count = loader("int64")


@kernel
def attend(
    rows: int, stride: int, count: int, agents: int, width: int, likely: int, shares: int, share_stride: int,
    means: int, mean_stride: int,
) -> int:  # fmt: skip
    """Average the outputs of attention over the rows of each agent. Arguments are addresses, or bytes between rows.

    A head has HEAD numbers. A value of a head is written HEAD times, so that vectors need not be rearranged.

    rows: float32, query, key and value of each row, `width` numbers each (a multiple of 16), agent after agent. count:
    int64 (agents,), rows of each agent. Written are likely: float32 (pairs, width), the attention of each row to each
    row of its agent; shares: float32 (rows, width), the means of these over the rows that attend; and means: float32
    (agents, width), the sums of the values by these shares, 0 for an agent without rows.
    """
    width, scale = 4 * width, np.float32(1 / math.sqrt(HEAD))
    zero, one = repeated(np.float32(0)), repeated(np.float32(1))
    for i in range(agents):
        seen = read_count(count + 8 * i)
        each = repeated(np.float32(1) / np.float32(seen))
        for h in range(0, width, BYTES):
            mean = zero
            if seen == 1:
                store(likely + h, one)
                store(shares + h, one)
                mean = load(rows + 2 * width + h)
            elif seen > 1:
                for k in range(seen):
                    store(shares + k * share_stride + h, zero)
                for q in range(seen):
                    pairs, highest, total = likely + q * seen * width + h, repeated(np.float32(-math.inf)), zero
                    query = load(rows + q * stride + h) * scale
                    for k in range(seen):
                        logit = head_sums(query * load(rows + k * stride + width + h))
                        store(pairs + k * width, logit)
                        highest = larger(highest, logit)
                    for k in range(seen):
                        weight = exponential(load(pairs + k * width) - highest)
                        store(pairs + k * width, weight)
                        total = total + weight
                    factor = quotient(one, total)
                    for k in range(seen):
                        weight, share = load(pairs + k * width) * factor, shares + k * share_stride + h
                        store(pairs + k * width, weight)
                        store(share, load(share) + weight)
                for k in range(seen):
                    share = load(shares + k * share_stride + h) * each
                    store(shares + k * share_stride + h, share)
                    mean = mean + share * load(rows + k * stride + 2 * width + h)
            store(means + h, mean)
        rows, shares, likely = rows + seen * stride, shares + seen * share_stride, likely + seen * seen * width
        means += mean_stride
    return 0


@kernel
def differentiate(
    rows: int, stride: int, count: int, agents: int, width: int, likely: int, shares: int, share_stride: int,
    slopes: int, slope_stride: int, found: int,
) -> int:  # fmt: skip
    """Compute the gradients of `attend`, whose arguments and results come first; `shares` is overwritten.

    shares: Becomes the gradients of these shares. slopes: float32 (agents, width), gradients of the means.
    slope_stride: Bytes from one row of `slopes` to the next. found: float32, written: gradients of rows, at `stride`.
    """
    width, scale, zero = 4 * width, np.float32(1 / math.sqrt(HEAD)), repeated(np.float32(0))
    for i in range(agents):
        seen = read_count(count + 8 * i)
        each = np.float32(1) / np.float32(seen)
        for h in range(0, width, BYTES):
            slope = load(slopes + h)
            for k in range(seen):
                share, row, to = shares + k * share_stride + h, rows + k * stride + h, found + k * stride + h
                store(to, zero)
                store(to + width, zero)
                store(to + 2 * width, load(share) * slope)
                store(share, head_sums(load(row + 2 * width) * slope) * each)
            for q in range(seen if seen > 1 else 0):  # for one row, the share is 1 for any query
                pairs, mean, query, moved = likely + q * seen * width + h, zero, load(rows + q * stride + h), zero
                for k in range(seen):
                    mean = mean + load(pairs + k * width) * load(shares + k * share_stride + h)
                for k in range(seen):
                    change = load(pairs + k * width) * (load(shares + k * share_stride + h) - mean) * scale
                    key, to = rows + k * stride + width + h, found + k * stride + width + h
                    moved = moved + change * load(key)
                    store(to, load(to) + change * query)
                store(found + q * stride + h, load(found + q * stride + h) + moved)
        rows, found, slopes = rows + seen * stride, found + seen * stride, slopes + slope_stride
        shares, likely = shares + seen * share_stride, likely + seen * seen * width
    return 0


def possible(rows: Tensor, heads: int) -> bool:
    """Return whether the kernels can process these rows; otherwise PyTorch's operations do."""
    fits = rows.shape[1] == 3 * HEAD * heads and heads % (BYTES // 4 // HEAD) == 0
    return fits and rows.device.type == "cpu" and rows.dtype == torch.float32 and compiled()


class Means(torch.autograd.Function):
    """Arguments as in `attend`: of rows (rows, 3 * width) and known int64 (agents,), the means (agents, width)."""

    @staticmethod
    def forward(context: Any, rows: Tensor, known: Array) -> Tensor:
        """Compute the means."""
        width, rows, known = rows.shape[1] // 3, rows.contiguous(), np.ascontiguousarray(known)
        likely, shares = (rows.new_empty(count, width) for count in (int(known @ known), len(rows)))
        means = rows.new_empty(len(known), width)
        given = rows.data_ptr(), 12 * width, known.ctypes.data, len(known), width
        context.given = rows, known, likely, shares, given
        called(attend)[0](*given, likely.data_ptr(), shares.data_ptr(), 4 * width, means.data_ptr(), 4 * width)
        return means

    @staticmethod
    def backward(context: Any, slopes: Tensor) -> tuple[Tensor, None]:
        """Compute the gradients of the rows."""
        rows, _, likely, shares, given = context.given
        found, slopes, shares, stride = torch.empty_like(rows), slopes.contiguous(), shares.clone(), 4 * slopes.shape[1]
        more = shares.data_ptr(), stride, slopes.data_ptr(), stride, found.data_ptr()
        called(differentiate)[0](*given, likely.data_ptr(), *more)
        return found, None
