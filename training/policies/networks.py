"""The networks: entities are embedded, attend to each other and are averaged; dense towers follow.

Only the average of attention's output is needed, so linear maps of the rows are applied after the average, and only
visible rows are computed. The results are those of torch.nn.MultiheadAttention followed by the average. Attention that
also reaches hidden rows is in authors_attention.py.
"""

import math
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from ..base.observation_layout import ObservationLayout
from ..base.presets import Preset
from . import attention, authors_attention
from .rows import Observed, Rows
from .torch_settings import FLOAT

ACTIVATIONS = {"tanh": torch.tanh_, "relu": torch.relu_}  # in place
GAIN = math.sqrt(2)  # of orthogonal initial weights, as in Stable-Baselines3


class Extractor(nn.Module):
    """A network from observations to features (batch, 2 * width): half from their own numbers, half from entities."""

    own_scale: Tensor
    scale: Tensor

    def __init__(self, layout: ObservationLayout, preset: Preset, scales: tuple[Any, Any]) -> None:
        super().__init__()
        if preset.leaky and preset.activation != "tanh":
            raise ValueError(f"preset '{preset.name}': with leaky, the activation must be tanh, as in attend")
        self.layout, self.preset, width = layout, preset, preset.width
        self.own = nn.Linear(layout.own, width, **FLOAT)
        widths = [kind.features for kind in layout.kinds]
        self.weight = nn.Parameter(torch.empty(sum(widths), width, **FLOAT))  # of all kinds, stacked
        self.bias = nn.Parameter(torch.zeros(len(widths), width, **FLOAT))
        self.attention = nn.MultiheadAttention(width, preset.heads, batch_first=True, **FLOAT)  # for its parameters
        self.register_buffer("own_scale", torch.ones(layout.own, **FLOAT), persistent=False)
        self.register_buffer("scale", torch.ones(sum(widths), 1, **FLOAT), persistent=False)
        self.set_scales(scales)
        for part in torch.split(self.weight.data, widths):  # as if each kind had a layer of its own
            part.copy_(nn.init.orthogonal_(torch.empty(part.shape[1], part.shape[0], **FLOAT), GAIN).T)
        for layer in (self.own, self.attention.out_proj):
            begin(layer)

    def set_scales(self, scales: tuple[Any, Any]) -> None:
        """Set the factors of inputs, if the preset scales them: see observation_layout.scales."""
        if self.preset.scaled:
            own, kinds = (torch.as_tensor(each, **FLOAT) for each in scales)
            self.own_scale.copy_(own)
            self.scale.copy_(kinds[:, None])

    def forward(self, seen: Observed) -> Tensor:
        """Turn the observations of a batch of agents into features, float32 (batch, 2 * width)."""
        own = functional.linear(seen.own, self.own.weight * self.own_scale, self.own.bias)
        if isinstance(seen, Rows):
            entities = self._attend_seen(seen)
        else:
            entities = authors_attention.attend(seen, self.weight * self.scale, self.bias, self.attention)
        return torch.cat([self._active(own), entities], 1)

    def _attend_seen(self, seen: Rows) -> Tensor:
        """Return the average output of attention over each agent's rows, (batch, width); 0 for an agent without rows.

        Attention is over the pairs of rows of one agent, in one flat list over the batch, query after query.
        """
        embedded = self._active(seen.entities @ torch.cat([self.weight * self.scale, self.bias]))
        rows = functional.linear(embedded, self.attention.in_proj_weight, self.attention.in_proj_bias)
        mean = self._attended(seen, rows)
        out = self.attention.out_proj
        return torch.addmm((seen.count > 0)[:, None] * out.bias, mean, out.weight.T)

    def _attended(self, seen: Rows, each: Tensor) -> Tensor:
        """Average attention over the rows of each agent. each: float32 (rows, 3 * width), query, key and value."""
        if seen.room is None and attention.possible(each, self.preset.heads):
            return cast(Tensor, attention.Means.apply(each, seen.known))  # type: ignore[no-untyped-call]
        width, heads, batch, rows = self.preset.width, self.preset.heads, len(seen), len(seen.entities)
        query, key = seen.pairs
        queries, keys, values = each.chunk(3, 1)
        logits = queries.index_select(0, query) * keys.index_select(0, key)
        logits = logits.view(len(query), heads, width // heads).sum(2) * (width // heads) ** -0.5
        with torch.no_grad():  # so that exp cannot overflow
            highest = torch.segment_reduce(logits, "max", lengths=seen.each, unsafe=True)
        weights = (logits - highest.index_select(0, query)).exp()
        total = weights.new_zeros(rows, heads).index_add(0, query, weights)
        weights = weights / total.index_select(0, query)
        weights = weights.new_zeros(rows, heads).index_add(0, key, weights)  # of each row, summed over queries
        values = (values.reshape(rows, heads, width // heads) * weights[:, :, None]).view(rows, width)
        sums = values.new_zeros(seen.owners, width).index_add(0, seen.agent, values)[:batch]
        return sums / seen.count.clamp(min=1)[:, None]

    def _active(self, values: Tensor) -> Tensor:
        return ACTIVATIONS[self.preset.activation](values)


class Memory(nn.GRUCell):
    """Memory of the features of earlier steps (Cho et al., arXiv:1406.1078)."""

    def __init__(self, features: int, width: int) -> None:
        """Create a memory of `width` numbers for `features` in a step."""
        super().__init__(features, width, **FLOAT)
        for weight in (self.weight_ih, self.weight_hh):
            for gate in weight.data.chunk(3):
                nn.init.orthogonal_(gate)
        for bias in (self.bias_ih, self.bias_hh):
            nn.init.zeros_(bias)

    def through(self, features: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return the memory after each step (steps * agents, width), and after the last one (agents, width).

        features: float32 (steps * agents, features), step after step. memory: float32 (agents, width), before the first
        step. begins: bool (steps, agents), whether an agent's memory is reset to 0 before the step.
        """
        after, kept = [], (~begins).to(features.dtype)[:, :, None]
        for now, goes_on in zip(features.view(*begins.shape, features.shape[1]), kept, strict=True):
            memory = self(now, memory * goes_on)
            after.append(memory)
        return torch.cat(after), memory


class Tower(nn.Module):
    """Two dense layers and a linear one: (batch, inputs) to (batch, outputs)."""

    def __init__(self, preset: Preset, inputs: int, outputs: int, gain: float) -> None:
        super().__init__()
        self.activation = ACTIVATIONS[preset.activation]
        self.first = nn.Linear(inputs, preset.hidden, **FLOAT)
        self.second = nn.Linear(preset.hidden, preset.hidden, **FLOAT)
        self.last = nn.Linear(preset.hidden, outputs, **FLOAT)
        for layer, own in ((self.first, GAIN), (self.second, GAIN), (self.last, gain)):
            begin(layer, own)

    def forward(self, features: Tensor) -> Tensor:
        """Map (batch, inputs) to (batch, outputs)."""
        return self.last(self.inner(features))

    def inner(self, features: Tensor) -> Tensor:
        """Return the input of the last layer: (batch, hidden)."""
        return self.behind_first(self.activation(self.first(features)))

    def behind_first(self, first: Tensor) -> Tensor:
        """Return the input of the last layer, from the output of the first: both (batch, hidden)."""
        return self.activation(self.second(first))


def begin(layer: nn.Linear, gain: float = GAIN) -> nn.Linear:
    """Initialise a layer with orthogonal weights and a bias of 0, and return it."""
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer
