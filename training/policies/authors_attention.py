"""Attention as in the authors' code: keys are all rows, even hidden ones; queries are visible rows and a padding row.

Four things make it fast. Samples are sorted by their number of queries, so that samples with the same number are one
batched product without padding. Linear maps are applied where there are fewest rows: that of keys to the queries,
those of values and outputs after the sum over queries. All rows of a kind are embedded in one product. The gradient is
written out: a few large products, where autograd would create and keep dozens of tensors.
"""

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from .rows import PaddedRows


def attend(padded: PaddedRows, weight: Tensor, bias: Tensor, attention: nn.MultiheadAttention) -> Tensor:
    """Return the outputs of torch.nn.MultiheadAttention, averaged over all rows; hidden ones count as 0.

    Rows are embedded with tanh. The padding row, behind all others, is embedded as zeros and visible in every sample.
    Logits of hidden rows are raised by 1, as the authors add their mask to the logits.

    Returns (batch, width). Raises ValueError: a gradient by the observations is requested.

    weight, bias: Parameters of the layers of all kinds, stacked, (numbers of all kinds, width) and (kinds, width).
    attention: Used for its parameters and its number of heads.
    """
    if padded.packed.requires_grad:
        raise ValueError("preset 'original' has gradients by its parameters only, not by observations; detach these")
    width, heads = attention.embed_dim, attention.num_heads
    query, key, value = attention.in_proj_weight.view(3, heads, -1, width)
    query_bias, _, value_bias = attention.in_proj_bias.view(3, heads, -1)  # the key's bias does not change attention
    queries = torch.cat([query, query_bias[:, :, None]], 2) * query.shape[1] ** -0.5
    to_keys = torch.bmm(key.transpose(1, 2), queries).view(heads * width, width + 1)  # the last column is the bias
    out = attention.out_proj
    out_bias = functional.linear(value_bias.reshape(width), out.weight, out.bias)
    from_values = torch.bmm(out.weight.view(width, heads, -1).transpose(0, 1), value)  # (heads, width, width)

    visible, order = padded.seen.count_nonzero(1).sort()
    counts = visible + 1  # with the padding row
    mixed: Tensor = _Mix.apply(padded.select(order), counts, weight, bias, to_keys)  # type: ignore[no-untyped-call]
    total = mixed @ from_values.transpose(1, 2).reshape(heads * width, width) + counts[:, None] * out_bias
    return torch.empty_like(total).index_copy(0, order, total) / (padded.layout.rows + 1)


class _Mix(torch.autograd.Function):
    """The embedded rows of each sample, weighted by softmax and summed over its queries: (batch, heads * width).

    counts: (batch,), number of visible rows, including the padding row; samples are sorted by it. to_keys: the linear
    map from an embedded row to each head's factor for all rows, (heads * width, width + 1), the bias last.
    """

    @staticmethod
    def forward(ctx: Any, padded: PaddedRows, counts: Tensor, weight: Tensor, bias: Tensor, to_keys: Tensor) -> Tensor:
        layout, inputs, seen = padded.layout, _by_kind(padded), functional.pad(padded.seen, (0, 1), value=1.0)
        (batch, rows), width, heads = seen.shape, weight.shape[1], len(to_keys) // weight.shape[1]
        embedded = seen.new_zeros(batch, rows, width)
        # tanh(x) = 2 sigmoid(2x) - 1, which takes a quarter of the time
        matrices = torch.split(2 * weight, [kind.features for kind in layout.kinds])
        parts = torch.split(embedded[:, :-1], [kind.rows for kind in layout.kinds], 1)
        for numbers, matrix, doubled, part in zip(inputs, matrices, 2 * bias, parts, strict=True):
            torch.sigmoid(torch.addmm(doubled, numbers, matrix).view_as(part), out=part)
        embedded[:, :-1].mul_(2).sub_(1)

        where = seen.flatten().nonzero().flatten()
        sample = where.div(rows, rounding_mode="floor")
        queries = embedded.view(-1, width).index_select(0, where)
        wanted = torch.addmm(to_keys[:, -1], queries, to_keys[:, :-1].T)
        raised, groups = (1 - seen)[:, None], list(_groups(counts))
        weights = seen.new_empty(len(where), heads * rows)
        for samples, chosen, count in groups:
            these = wanted[chosen].view(-1, count * heads, width)
            logits = weights[chosen].view(-1, count * heads, rows)
            torch.baddbmm(raised[samples], these, embedded[samples].transpose(1, 2), out=logits)
        weights = weights.view(-1, rows).softmax(1).view_as(weights)
        sums = seen.new_zeros(batch, heads * rows).index_add_(0, sample, weights)
        ctx.save_for_backward(embedded, where, sample, queries, wanted, weights, sums, to_keys, *inputs)
        ctx.layout, ctx.groups = layout, groups
        return torch.bmm(sums.view(batch, heads, rows), embedded).view(batch, heads * width)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """Return gradients with respect to the arguments of forward."""
        embedded, where, sample, queries, wanted, weights, sums, to_keys, *inputs = ctx.saved_tensors
        (batch, rows, width), heads = embedded.shape, len(to_keys) // embedded.shape[2]
        gradient, sums = gradient.reshape(batch, heads, width), sums.view(batch, heads, rows)
        by_sums = torch.bmm(gradient, embedded.transpose(1, 2)).view(batch, heads * rows)
        by_weights = by_sums.index_select(0, sample).view(-1, rows)
        weights = weights.view(-1, rows)
        by_logits = torch.ops.aten._softmax_backward_data(by_weights, weights, 1, weights.dtype)

        by_logits, by_wanted = by_logits.view(-1, heads * rows), torch.empty_like(wanted)
        by_embedded = torch.bmm(sums.transpose(1, 2), gradient)
        for samples, chosen, count in ctx.groups:
            by_these = by_logits[chosen].view(-1, count * heads, rows)
            by_embedded[samples].baddbmm_(by_these.transpose(1, 2), wanted[chosen].view(-1, count * heads, width))
            torch.bmm(by_these, embedded[samples], out=by_wanted[chosen].view(-1, count * heads, width))
        by_embedded.view(-1, width).index_add_(0, where, by_wanted @ to_keys[:, :-1])

        by_weight, by_bias, start = [], [], 0
        for kind, numbers in zip(ctx.layout.kinds, inputs, strict=True):
            part = slice(start, start + kind.rows)
            by_values = torch.ops.aten.tanh_backward(by_embedded[:, part], embedded[:, part]).reshape(-1, width)
            by_weight.append(numbers.T @ by_values)
            by_bias.append(by_values.sum(0))
            start += kind.rows
        by_to_keys = torch.cat([by_wanted.T @ queries, by_wanted.sum(0)[:, None]], 1)
        return None, None, torch.cat(by_weight), torch.stack(by_bias), by_to_keys


def _by_kind(padded: PaddedRows) -> list[Tensor]:
    """Return the rows of each kind: (batch * rows, features)."""
    kinds, features = padded.layout.kinds, padded.layout.features
    parts = torch.split(padded.rows, [kind.rows for kind in kinds], 1)
    return [part.reshape(-1, features)[:, : kind.features] for part, kind in zip(parts, kinds, strict=True)]


def _groups(counts: Tensor) -> Iterator[tuple[slice, slice, int]]:
    """Yield, for each number of queries, its samples, their queries, and the number. `counts` is sorted."""
    sample = query = 0
    for count, samples in enumerate(torch.bincount(counts).tolist()):
        if samples:
            yield slice(sample, sample + samples), slice(query, query + samples * count), count
        sample, query = sample + samples, query + samples * count
