"""The networks: entities are embedded, attend to each other and are averaged; dense towers follow.

Attention is computed as the average of its output is needed: linear maps of the rows are moved behind the average, and
only visible rows are queries. The numbers are those of torch.nn.MultiheadAttention followed by the average.
"""

import math
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from .observation_layout import ObservationLayout
from .presets import Preset

ACTIVATIONS = {"tanh": torch.tanh, "relu": torch.relu}
NEVER = -1e9  # a logit that softmax makes 0; infinity would make NaN where there is nothing else
GAIN = math.sqrt(2)  # of orthogonal initial weights, as in Stable-Baselines3


class Extractor(nn.Module):
    """Packed rows (batch, size) to features (batch, 2 * width): half of the agent's own numbers, half of entities."""

    kind: Tensor
    cells: Tensor
    own_scale: Tensor
    scale: Tensor

    def __init__(self, layout: ObservationLayout, preset: Preset, scales: tuple[Any, Any]) -> None:
        super().__init__()
        self.layout, self.preset, width = layout, preset, preset.width
        self.own = nn.Linear(layout.own, width)
        widths = [kind.features for kind in layout.kinds]
        self.weight = nn.Parameter(torch.empty(sum(widths), width))  # of all kinds, one below the other
        self.bias = nn.Parameter(torch.zeros(len(widths), width))
        self.attention = nn.MultiheadAttention(width, preset.heads, batch_first=True)  # its parameters only
        kinds = layout.kind_of_row() + [len(widths)] * preset.padded
        self._constant("kind", torch.tensor(kinds))
        self._constant("cells", torch.tensor(layout.cells()))
        self._constant("own_scale", torch.ones(layout.own))
        self._constant("scale", torch.ones(sum(widths), 1))
        self.set_scales(scales)
        self._initialise(widths)

    def set_scales(self, scales: tuple[Any, Any]) -> None:
        """What inputs are multiplied by if the preset scales them: see observation_layout.scales."""
        if self.preset.scaled:
            own, kinds = (torch.as_tensor(each, dtype=torch.float32) for each in scales)
            self.own_scale.copy_(own)
            self.scale.copy_(kinds[:, None])

    def forward(self, packed: Tensor) -> Tensor:
        """(batch, size) to (batch, 2 * width)."""
        own, seen, rows = self._split(packed)
        own = functional.linear(own, self.own.weight * self.own_scale, self.own.bias)
        return torch.cat([self._active(own), self._entities(seen, rows)], 1)

    def _split(self, packed: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Own numbers, masks (batch, rows), rows (batch, rows, features); with the padding entity if there is one."""
        own, count = self.layout.own, self.layout.rows
        seen = packed[:, own : own + count]
        rows = packed[:, own + count :].view(len(packed), count, self.layout.features)
        if self.preset.padded:
            seen, rows = functional.pad(seen, (0, 1), value=1.0), functional.pad(rows, (0, 0, 0, 1))
        return packed[:, :own], seen, rows

    def _entities(self, seen: Tensor, rows: Tensor) -> Tensor:
        """Masked self-attention, averaged: (batch, width)."""
        if not seen.shape[1]:  # a world of one agent and no items
            return seen.new_zeros(len(seen), self.preset.width)
        count = seen.sum(1, keepdim=True)
        valid, where = seen.topk(max(1, int(count.max())), 1)
        if self.preset.leaky:
            rows = self._embed_all(rows)
            return self._attend(_chosen(rows, where), valid, rows, 1 - seen) / seen.shape[1]
        queries = self._embed(_chosen(rows, where), self.kind[where])
        return self._attend(queries, valid, queries, (1 - valid) * NEVER) / count.clamp(min=1)

    def _embed_all(self, rows: Tensor) -> Tensor:
        """Every row (batch, rows, features) through the layer of its kind: a matrix for each row."""
        matrices = self._matrices().index_select(0, self.kind)
        biases = self._biases().index_select(0, self.kind)[:, None]
        return self._active(torch.baddbmm(biases, rows.transpose(0, 1), matrices)).transpose(0, 1)

    def _embed(self, rows: Tensor, kinds: Tensor) -> Tensor:
        """A few rows (batch, some, features) of these kinds (batch, some): one matrix for all kinds side by side."""
        chosen = functional.one_hot(kinds, len(self.bias) + 1).float()
        inputs = torch.cat([(chosen[..., None] * rows[:, :, None]).flatten(2), chosen], 2)
        weight = torch.cat([self._matrices().flatten(0, 1), self._biases()])
        return self._active(inputs @ weight)

    def _matrices(self) -> Tensor:
        """The weights of each kind, (kinds + 1, features, width); those of features that it has not are arbitrary."""
        return (self.weight * self.scale).index_select(0, self.cells).view(len(self.bias) + 1, -1, self.preset.width)

    def _biases(self) -> Tensor:
        """The biases of each kind, (kinds + 1, width); the last kind is the padding entity's, which has none."""
        return functional.pad(self.bias, (0, 0, 0, 1))

    def _attend(self, queries: Tensor, valid: Tensor, rows: Tensor, bias: Tensor) -> Tensor:
        """The sum of the outputs of attention over valid queries: (batch, width).

        queries (batch, count, width), valid (batch, count), rows (batch, rows, width), bias (batch, rows) on logits.
        """
        batch, width, heads = len(rows), rows.shape[2], self.preset.heads
        query, key, value = self.attention.in_proj_weight.view(3, heads, -1, width)
        query_bias, _, value_bias = self.attention.in_proj_bias.view(3, heads, -1)  # the key's moves no weight
        query, query_bias = query * (width // heads) ** -0.5, query_bias * (width // heads) ** -0.5
        folded = torch.bmm(key.transpose(1, 2), query).view(heads * width, width)
        folded_bias = torch.bmm(query_bias[:, None], key).view(heads * width)
        wanted = functional.linear(queries, folded, folded_bias).view(batch, -1, width)
        weights = torch.baddbmm(bias[:, None], wanted, rows.transpose(1, 2)).softmax(
            2
        )  # (batch, queries * heads, rows)
        weights = torch.bmm(valid[:, None], weights.view(batch, valid.shape[1], -1)).view(batch, heads, -1)
        mixed = torch.bmm(torch.bmm(weights, rows).transpose(0, 1), value.transpose(1, 2))  # (heads, batch, each)
        count = valid.sum(1, keepdim=True)
        values = mixed.transpose(0, 1).reshape(batch, width) + count * value_bias.reshape(width)
        out = self.attention.out_proj
        return functional.linear(values, out.weight) + count * out.bias

    def _active(self, values: Tensor) -> Tensor:
        return ACTIVATIONS[self.preset.activation](values)

    def _constant(self, name: str, values: Tensor) -> None:
        self.register_buffer(name, values, persistent=False)

    def _initialise(self, widths: list[int]) -> None:
        for part in torch.split(self.weight.data, widths):  # as if each kind had a layer of its own
            part.copy_(orthogonal(torch.empty(part.shape[1], part.shape[0]), GAIN).T)
        for layer in (self.own, self.attention.out_proj):
            orthogonal(layer.weight, GAIN)
            nn.init.zeros_(layer.bias)


class Tower(nn.Module):
    """Two dense layers and a linear one: (batch, 2 * width) to (batch, outputs)."""

    def __init__(self, preset: Preset, outputs: int, gain: float) -> None:
        super().__init__()
        self.activation = ACTIVATIONS[preset.activation]
        self.first = nn.Linear(2 * preset.width, preset.hidden)
        self.second = nn.Linear(preset.hidden, preset.hidden)
        self.last = nn.Linear(preset.hidden, outputs)
        for layer, own in ((self.first, GAIN), (self.second, GAIN), (self.last, gain)):
            orthogonal(layer.weight, own)
            nn.init.zeros_(layer.bias)

    def forward(self, features: Tensor) -> Tensor:
        """(batch, 2 * width) to (batch, outputs)."""
        out: Tensor = self.last(self.inner(features))
        return out

    def inner(self, features: Tensor) -> Tensor:
        """Before the last layer: (batch, hidden)."""
        return self.activation(self.second(self.activation(self.first(features))))


def _chosen(rows: Tensor, where: Tensor) -> Tensor:
    """Rows (batch, rows, width) of these numbers (batch, some): (batch, some, width)."""
    return rows.gather(1, where[:, :, None].expand(-1, -1, rows.shape[2]))


def orthogonal(weight: Tensor, gain: float) -> Tensor:
    """Fill a weight (outputs, inputs) with an orthogonal matrix and return it."""
    filled: Tensor = nn.init.orthogonal_(weight, gain)
    return filled
