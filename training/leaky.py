"""The leaky form of attention, as in the authors' code: all rows are keys and values, visible ones are queries.

The numbers are those of the entity part of networks.Extractor. Three things make it fast. Samples are sorted by how many
queries they have, so that those with equally many are one batched product, and none is padded. Linear maps move to where
there are fewest rows: those of keys into the queries, those of values and outputs behind the sum over queries. And the
gradient is written out, which keeps a few large tensors in place of dozens.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from .observation_layout import ObservationLayout


def attend(
    packed: Tensor, layout: ObservationLayout, weight: Tensor, bias: Tensor, attention: nn.MultiheadAttention
) -> Tensor:
    """The mean output of attention over all rows and a padding row, where hidden queries count as zeros.

    A row of zeros stands for the padding entity; it is visible in every sample. Logits of hidden rows are raised by 1.

    Args:
        packed: Observations, float32 (batch, layout.size).
        layout: Where masks and rows are in them.
        weight: Of the embeddings of all kinds, one below the other, float32 (numbers of all kinds, width).
        bias: Of the same, float32 (kinds, width).
        attention: Its parameters are used.

    Returns:
        float32 (batch, width).
    """
    width, heads = attention.embed_dim, attention.num_heads
    query, key, value = attention.in_proj_weight.view(3, heads, -1, width)
    query_bias, _, value_bias = attention.in_proj_bias.view(3, heads, -1)  # the key's moves no weight
    folded = torch.bmm(key.transpose(1, 2), query).view(heads * width, width) * attention.head_dim**-0.5
    folded_bias = torch.bmm(query_bias[:, None], key).view(heads * width) * attention.head_dim**-0.5
    out = attention.out_proj.weight.view(width, heads, -1).transpose(0, 1)
    outwards = torch.bmm(out, value).transpose(0, 1).reshape(width, heads * width)
    outwards_bias = attention.out_proj.bias + attention.out_proj.weight @ value_bias.reshape(width)

    order = packed[:, layout.own : layout.own + layout.rows].sum(1).argsort()
    packed = packed.index_select(0, order)
    seen = functional.pad(packed[:, layout.own : layout.own + layout.rows], (0, 1), value=1.0)
    mixed = _Attention.apply(packed, seen, layout, weight, bias, folded, folded_bias)
    total = functional.linear(mixed, outwards) + seen.sum(1, keepdim=True) * outwards_bias
    return torch.empty_like(total).index_copy(0, order, total) / seen.shape[1]


class _Attention(torch.autograd.Function):
    """The rows of each sample, embedded and mixed by the weights of its queries: (batch, heads * width)."""

    @staticmethod
    def forward(
        ctx: Any, packed: Tensor, seen: Tensor, layout: ObservationLayout, weight: Tensor, bias: Tensor, folded: Tensor,
        folded_bias: Tensor,
    ) -> Tensor:
        batch, rows, width = *seen.shape, weight.shape[1]
        heads = len(folded) // width
        inputs = list(_inputs(packed, layout))
        embedded = packed.new_empty(batch, rows, width)
        embedded[:, -1] = 0
        start = first = 0
        for k, (kind, numbers) in enumerate(zip(layout.kinds, inputs, strict=True)):
            # tanh(x) = 2 sigmoid(2x) - 1, which takes a quarter of the time; the 2 is in the product already
            values = torch.addmm(bias[k], numbers, weight[first : first + kind.features], beta=2, alpha=2)
            torch.sigmoid(values.view(batch, -1, width), out=embedded[:, start : start + kind.rows])
            start, first = start + kind.rows, first + kind.features
        embedded[:, :-1].mul_(2).sub_(1)
        where = seen.flatten().nonzero().flatten()  # the queries
        queries = embedded.view(-1, width).index_select(0, where)
        wanted = torch.addmm(folded_bias, queries, folded.T)
        counts = seen.count_nonzero(1)
        groups = list(_groups(counts))
        hidden = (1 - seen)[:, None]
        weights = packed.new_empty(len(where), heads * rows)
        for samples, chosen, count in groups:
            into = weights[chosen].view(-1, count * heads, rows)
            keys = embedded[samples].transpose(1, 2)
            torch.baddbmm(hidden[samples], wanted[chosen].view(-1, count * heads, width), keys, out=into)
        weights = weights.view(-1, rows).softmax(1).view(-1, heads * rows)
        sums = packed.new_zeros(batch, heads * rows)
        for samples, chosen, count in groups:
            torch.sum(weights[chosen].view(-1, count, heads * rows), 1, out=sums[samples])
        ctx.save_for_backward(embedded, where, queries, wanted, weights, sums, counts, folded, *inputs)
        ctx.layout, ctx.groups = layout, groups
        return torch.bmm(sums.view(batch, heads, rows), embedded).view(batch, -1)

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
        embedded, where, queries, wanted, weights, sums, counts, folded, *inputs = ctx.saved_tensors
        batch, rows, width = embedded.shape
        heads = len(folded) // width
        gradient = gradient.view(batch, heads, width)
        by_weights = torch.bmm(gradient, embedded.transpose(1, 2)).view(batch, heads * rows)
        by_weights = by_weights.repeat_interleave(counts, 0, output_size=len(where))
        by_logits = torch.ops.aten._softmax_backward_data(by_weights.view(-1, rows), weights.view(-1, rows), 1, torch.float32).view_as(weights)
        by_embedded = torch.bmm(sums.view(batch, heads, rows).transpose(1, 2), gradient)
        by_wanted = torch.empty_like(wanted)
        for samples, chosen, count in ctx.groups:
            by_these = by_logits[chosen].view(-1, count * heads, rows)
            torch.bmm(by_these, embedded[samples], out=by_wanted[chosen].view(-1, count * heads, width))
            by_embedded[samples].baddbmm_(by_these.transpose(1, 2), wanted[chosen].view(-1, count * heads, width))
        by_embedded.view(-1, width).index_add_(0, where, by_wanted @ folded)
        start, by_weight, by_bias = 0, [], []
        for kind, numbers in zip(ctx.layout.kinds, inputs, strict=True):
            there = slice(start, start + kind.rows)
            by_values = torch.ops.aten.tanh_backward(by_embedded[:, there], embedded[:, there]).view(-1, width)
            by_weight.append(numbers.T @ by_values)
            by_bias.append(by_values.sum(0))
            start += kind.rows
        return None, None, None, torch.cat(by_weight), torch.stack(by_bias), by_wanted.T @ queries, by_wanted.sum(0)


def _inputs(packed: Tensor, layout: ObservationLayout) -> Iterator[Tensor]:
    """The rows of each kind: (batch * rows, features)."""
    rows = packed[:, layout.own + layout.rows :].view(len(packed), layout.rows, layout.features)
    for kind, some in zip(layout.kinds, rows.split([kind.rows for kind in layout.kinds], 1), strict=True):
        yield some[:, :, : kind.features].reshape(-1, kind.features)


def _groups(counts: Tensor) -> Iterator[tuple[slice, slice, int]]:
    """Samples with equally many queries, the queries that are theirs, and how many each has; counts are sorted."""
    sample = query = 0
    for count, samples in enumerate(torch.bincount(counts).tolist()):
        if samples and count:
            yield slice(sample, sample + samples), slice(query, query + samples * count), count
        sample, query = sample + samples, query + samples * count
