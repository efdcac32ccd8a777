"""Attention among the rows of each agent in compiled code, for the CPU; networks.Extractor has it in PyTorch's.

An agent sees a row or two. PyTorch needs lists of all pairs of rows and some twenty operations on them, and spends most
of its time on lists and calls.
"""

import functools
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from outlast.ecs import CompiledUnits
from outlast.ecs.kernels.jit import compiled, kernel, loader, storer

Array = np.ndarray[Any, Any]
read_count, read, write = loader("int64"), loader("float32"), storer("float32")


@kernel
def attend(rows: int, count: int, agents: int, width: int, heads: int, likely: int, shares: int, means: int) -> int:
    """Average the outputs of attention over the rows of each agent. All but agents, width and heads are addresses.

    Args:
        rows: float32 (rows, 3 * width), query, key and value of each row, agent after agent.
        count: int64 (agents,), rows of each agent.
        agents: How many there are.
        width: Numbers of a query.
        heads: Heads, which share these.
        likely: float32 (pairs, heads), written: how much each row attends to each row of its agent.
        shares: float32 (rows, heads), written: the means of these over the rows that attend.
        means: float32 (agents, width), written: sums of the values by these shares; 0 for an agent without rows.
    """
    size, each, pair = 4 * (width // heads), 12 * width, likely
    scale = np.float32(1 / math.sqrt(width // heads))
    for i in range(agents):
        seen = read_count(count + 8 * i)
        end = rows + each * seen
        for k in range(width):
            write(means + 4 * k, np.float32(0))
        for share in range(shares, shares + 4 * heads * seen, 4):
            write(share, np.float32(0))
        for query in range(rows, end, each):
            for h in range(heads):
                highest, total = np.float32(-math.inf), np.float32(0)
                for k in range(seen):
                    logit, one, other = np.float32(0), query + h * size, rows + each * k + h * size + 4 * width
                    for d in range(0, size, 4):
                        logit += read(one + d) * read(other + d)
                    write(pair + 4 * (heads * k + h), logit * scale)
                    highest = max(highest, logit * scale)
                for k in range(seen):
                    at = pair + 4 * (heads * k + h)
                    weight = np.float32(math.exp(read(at) - highest))
                    write(at, weight)
                    total += weight
                for k in range(seen):
                    at, share = pair + 4 * (heads * k + h), shares + 4 * (heads * k + h)
                    weight = read(at) / total
                    write(at, weight)
                    write(share, read(share) + weight)
            pair += 4 * heads * seen
        for value in range(rows + 8 * width, end + 8 * width, each):
            for h in range(heads):
                share = read(shares + 4 * h) / np.float32(seen)
                write(shares + 4 * h, share)
                for d in range(h * size, (h + 1) * size, 4):
                    write(means + d, read(means + d) + share * read(value + d))
            shares += 4 * heads
        rows, means = end, means + 4 * width
    return 0


@kernel
def differentiate(
    rows: int, count: int, agents: int, width: int, heads: int, likely: int, shares: int, slopes: int, found: int
) -> int:
    """Compute the gradients of `attend`, whose arguments and results come first; `shares` is overwritten.

    shares: Becomes the gradients of these shares. slopes: float32 (agents, width), gradients of the means.
    found: float32 (rows, 3 * width), gradients of the rows; 0 at first.
    """
    size, each, pair = 4 * (width // heads), 12 * width, likely
    scale = np.float32(1 / math.sqrt(width // heads))
    for i in range(agents):
        seen = read_count(count + 8 * i)
        for k in range(seen):
            for h in range(heads):
                at, value = shares + 4 * (heads * k + h), each * k + 8 * width
                share, slope = read(at), np.float32(0)
                for d in range(h * size, (h + 1) * size, 4):
                    write(found + value + d, share * read(slopes + d))
                    slope += read(rows + value + d) * read(slopes + d)
                write(at, slope / np.float32(seen))
        for q in range(seen):
            for h in range(heads):
                mean = np.float32(0)
                for k in range(seen):
                    mean += read(pair + 4 * (heads * k + h)) * read(shares + 4 * (heads * k + h))
                for k in range(seen):
                    at = 4 * (heads * k + h)
                    slope = read(pair + at) * (read(shares + at) - mean) * scale
                    query, key = each * q + h * size, each * k + h * size + 4 * width
                    for d in range(0, size, 4):
                        write(found + query + d, read(found + query + d) + slope * read(rows + key + d))
                        write(found + key + d, read(found + key + d) + slope * read(rows + query + d))
            pair += 4 * heads * seen
        rows, found = rows + each * seen, found + each * seen
        slopes, shares = slopes + 4 * width, shares + 4 * heads * seen
    return 0


@functools.cache
def functions() -> tuple[Any, Any]:
    """Both kernels, for Python to call with addresses; compiled once, and then loaded from the disk."""
    units = CompiledUnits([], {"attend": attend, "differentiate": differentiate}, {})
    units.load()
    return units.function("attend"), units.function("differentiate")


def possible(rows: Tensor) -> bool:
    """Return whether the kernels can take these rows; otherwise PyTorch's operations do."""
    return rows.device.type == "cpu" and rows.dtype == torch.float32 and compiled()


class Means(torch.autograd.Function):
    """See `attend`: of rows (rows, 3 * width), known int64 (agents,) and heads, the means (agents, width)."""

    @staticmethod
    def forward(context: Any, rows: Tensor, known: Array, heads: int) -> Tensor:
        """Compute the means."""
        width, rows, known = rows.shape[1] // 3, rows.contiguous(), np.ascontiguousarray(known)
        likely, shares = (rows.new_empty(count, heads) for count in (int(known @ known), len(rows)))
        means = rows.new_empty(len(known), width)
        context.given = rows, known, width, heads, likely, shares
        given = rows.data_ptr(), known.ctypes.data, len(known), width, heads
        functions()[0](*given, *map(Tensor.data_ptr, (likely, shares, means)))
        return means

    @staticmethod
    def backward(context: Any, slopes: Tensor) -> tuple[Tensor, None, None]:
        """Compute the gradients of the rows."""
        rows, known, width, heads, likely, shares = context.given
        found, slopes, shares = torch.zeros_like(rows), slopes.contiguous(), shares.clone()
        given = rows.data_ptr(), known.ctypes.data, len(known), width, heads
        functions()[1](*given, *map(Tensor.data_ptr, (likely, shares, slopes, found)))
        return found, None, None
