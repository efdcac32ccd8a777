"""Policy and value networks with several independent actions: their interface, and those of the presets."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torch.nn import functional

from outlast.envs.scenarios.scenario_json import imported_code

from ..base.config import name_of
from ..base.errors import TrainingError
from ..base.observation_layout import ObservationLayout
from ..base.presets import Preset
from . import compiled_networks
from .rows import Observed, PaddedRows, Rows
from .torch_settings import FLOAT, INDEX, playing

NEVER = -1e9  # a logit of probability 0; minus infinity gives NaN if all logits have it
ACTOR_GAIN = 0.01  # of the initial weights of the action heads, as in Stable-Baselines3
ACTIVATIONS = {"tanh": torch.tanh_, "relu": torch.relu_}  # in place
GAIN = math.sqrt(2)  # of orthogonal initial weights, as in Stable-Baselines3


class MultiCategorical(nn.Module):
    """Independent categorical distributions, given the logits of all of them in one row.

    Log probabilities are (values, actions, batch): PyTorch's softmax is several times as fast along the first axis.
    Actions with fewer values than others are padded with values of probability 0.
    """

    where: Tensor
    never: Tensor
    beyond: Tensor

    def __init__(self, sizes: Sequence[int]) -> None:
        super().__init__()
        self.shape, start = (max(sizes), len(sizes)), 0
        where, never = torch.zeros(self.shape, **INDEX), torch.full(self.shape, NEVER, **FLOAT)
        for k, size in enumerate(sizes):
            where[:size, k] = torch.arange(start, start + size, **INDEX)
            never[:size, k] = 0
            start += size
        self.register_buffer("where", where.flatten(), persistent=False)
        self.register_buffer("never", never.flatten(), persistent=False)
        beyond = torch.arange(1, max(sizes), **INDEX)[:, None, None] >= torch.tensor(sizes, **INDEX)[:, None]
        self.register_buffer("beyond", beyond, persistent=False)

    def log_probabilities(self, features: Tensor, head: nn.Linear) -> Tensor:
        """Return log probabilities, (values, actions, batch), of features that the head turns into logits."""
        weight, bias = head.weight.index_select(0, self.where), head.bias.index_select(0, self.where) + self.never
        logits = torch.addmm(bias[:, None], weight, features.T)
        return logits.view(*self.shape, len(features)).log_softmax(0)

    def log_softmax(self, logits: Tensor) -> Tensor:
        """Return log probabilities, (values, actions, batch), of logits (batch, values of all actions)."""
        chosen = logits.T.index_select(0, self.where) + self.never[:, None]
        return chosen.view(*self.shape, len(logits)).log_softmax(0)

    @staticmethod
    def of(actions: Tensor, logs: Tensor, free: Tensor | None = None) -> Tensor:
        """Return the log probabilities of joint actions (batch, actions): (batch,).

        free: bool (batch, actions), whether an action was drawn; None: all were.
        """
        chosen = logs.gather(0, actions.T[None])
        return (chosen if free is None else chosen * free.T).sum((0, 1))

    @staticmethod
    def entropy(logs: Tensor, free: Tensor | None = None) -> Tensor:
        """Return the entropy of the joint actions: (batch,). free: see `of`."""
        each = logs.exp() * logs
        return -(each if free is None else each * free.T).sum((0, 1))

    @staticmethod
    def likeliest(logs: Tensor) -> Tensor:
        """Return the likeliest joint actions, int64 (batch, actions)."""
        return logs.argmax(0).T

    def draw(self, logs: Tensor, uniform: Tensor) -> Tensor:
        """Sample joint actions, int64 (batch, actions), by one uniform number for each action, (batch, actions)."""
        below = logs.exp().cumsum(0)[:-1] + self.beyond  # rounding may leave the sum of all probabilities below 1
        return (below <= uniform.T).sum(0).T


class Networks(nn.Module):
    """The networks of a policy and its critic. Your own networks are a subclass with `__init__` and `forward`.

    They are saved as their state_dict and the name of the class, which must be imported before a checkpoint is loaded.

    Attributes:
        sizes: Number of values of each action.
        layout: Layout of the observations.
        preset: The preset, which decides the form of observations: Rows, or PaddedRows for preset `original`.
        scales: Factors that bring inputs to about -1 to 1: float32 (layout.own,) and (numbers of all kinds,), see Rows.
        memory: Numbers that each agent keeps from step to step; 0: none.
        state: Numbers of the state of a world that the critic learns from; 0: none.
        choices: Log probabilities and draws of actions.
        apart: Whether values have networks of their own, so that computing them later repeats no work.
    """

    apart = False
    plan: Any = None  # layout for the compiled code, if that can compute them

    def __init__(
        self,
        sizes: Sequence[int],
        *,
        layout: ObservationLayout,
        preset: Preset,
        scales: tuple[Any, Any],
        memory: int = 0,
        state: int = 0,
    ) -> None:
        """Create networks with random weights; see the attributes."""
        super().__init__()
        self.sizes, self.layout, self.preset, self.scales = tuple(sizes), layout, preset, scales
        self.memory, self.state, self.choices = memory, state, MultiCategorical(sizes)

    def forward(
        self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Compute one step of a batch of agents or, with a memory, several.

        Args:
            seen: Observations: in several steps, those of the same agents, step after step. They include the state of
                worlds if the critic learns from it.
            memory: float32 (agents, width), before the first step; None for a policy without a memory.
            begins: bool (agents,) or (steps, agents), where episodes begin: there memory is reset to 0.

        Returns:
            Log probabilities of all values of all actions (values, actions, batch), as from `choices.log_softmax`;
            values (batch,); and the memory after the last step.
        """
        raise NotImplementedError

    def logs(
        self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Return the log probabilities and the memory only, without a state, for callers that do not need values."""
        logs, _, after = self(seen, memory, begins)
        return logs, after

    def values(self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None) -> Tensor:
        """Return the values only, for callers that do not choose actions; see `forward`."""
        return self(seen, memory, begins)[1]

    def choose(self, logs: Tensor, uniform: Tensor | None) -> Tensor:
        """Choose actions, int64 (batch, actions): sampled by uniform numbers (batch, actions); None: the likeliest."""
        return self.choices.likeliest(logs) if uniform is None else self.choices.draw(logs, uniform)

    def take(self, other: Any, scale: Any = 1.0) -> None:
        """Become the same function of observations, and of the state, as a policy whose scales of inputs may differ.

        scale: The divisor of the state's numbers here, over their divisor there: float32 (numbers,). Raises
        RuntimeError if networks differ, and TrainingError if they cannot compensate for other scales.
        """
        self.load_state_dict(other.state_dict())
        self.rescale(other.scales)
        if np.any(scale != 1.0):
            raise TrainingError(
                f"{name_of(self)} was trained with another scale of the state: imitate it, by NAME:STEPS"
            )

    def rescale(self, scales: tuple[Any, Any]) -> None:
        """Set the scales of inputs that the weights were trained with. Raises TrainingError if it cannot."""
        if not all(map(np.array_equal, self.scales, scales)):
            raise TrainingError(f"{name_of(self)} was trained with other scales of inputs: imitate it, by NAME:STEPS")


class ActorCritic(Networks):
    """The networks of a preset. Actions are int64 (batch, actions)."""

    def __init__(self, sizes: Sequence[int], **options: Any) -> None:
        """See Networks."""
        super().__init__(sizes, **options)
        preset, memory, state = self.preset, self.memory, self.state
        inputs, count = 2 * preset.width, 1 if preset.shared else 2
        self.extractors = nn.ModuleList(Extractor(self.layout, preset, self.scales) for _ in range(count))
        self.apart = not (preset.shared or memory)
        self.recurrent = Memory(inputs, memory) if memory else None
        self.overview = begin(nn.Linear(state, preset.hidden, **FLOAT)) if state else None
        self.actor = Tower(preset, inputs + memory, sum(sizes), ACTOR_GAIN)
        self.critic = Tower(preset, inputs + memory + (preset.hidden if state else 0), 1, 1.0)
        self.plan = compiled_networks.plan(self) if type(self) is ActorCritic else None  # subclasses may differ

    def forward(
        self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """See Networks."""
        if compiled_networks.possible(self, seen):
            logits, values = compiled_networks.evaluated(self, cast(Rows, seen))
            return self.choices.log_softmax(logits), values, None
        features = [extractor(seen) for extractor in self.extractors]
        if self.recurrent is not None:
            after, memory = self._remember(features[0], memory, begins)
            features = [torch.cat([each, after], 1) for each in features]
        if self.overview is None and len(features) == 1:
            return *self._both(features[0]), memory
        return self._logs(self.actor.inner(features[0])), self._valued(features[-1], seen), memory

    def logs(
        self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """See Networks."""
        features = self.extractors[0](seen)
        if self.recurrent is not None:
            after, memory = self._remember(features, memory, begins)
            features = torch.cat([features, after], 1)
        return self._logs(self.actor.inner(features)), memory

    def values(self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None) -> Tensor:
        """See Networks."""
        if self.apart:
            return self._valued(self.extractors[-1](seen), seen)
        return super().values(seen, memory, begins)

    def _remember(self, features: Tensor, memory: Tensor | None, begins: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return the memory after each step, and after the last one."""
        if self.recurrent is None or memory is None or begins is None:
            raise ValueError("a policy with a memory needs `memory` and `begins`")
        return self.recurrent.through(features, memory, begins if begins.ndim == 2 else begins[None])

    def _valued(self, features: Tensor, seen: Observed) -> Tensor:
        """Return values from the features of the critic and, if it learns from it, the state of the worlds."""
        if self.overview is not None:
            features = torch.cat([features, self.critic.activation(self.overview(seen.state))], 1)
        return self.critic(features).flatten()

    def _both(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Return both for the same features: the first layers of both towers are one product."""
        actor, critic = self.actor, self.critic
        weight, bias = (torch.cat([getattr(t.first, name) for t in (actor, critic)]) for name in ("weight", "bias"))
        both = actor.activation(functional.linear(features, weight, bias)).chunk(2, 1)
        return self._logs(actor.behind_first(both[0])), critic.last(critic.behind_first(both[1])).flatten()

    def take(self, other: "ActorCritic", scale: Any = 1.0) -> None:
        """See Networks."""
        self.load_state_dict(other.state_dict())
        with torch.no_grad():
            for one, two in zip(self.extractors, other.extractors, strict=True):
                own, its = cast(Extractor, one), cast(Extractor, two)
                own.own.weight.mul_(its.own_scale / own.own_scale)
                own.weight.mul_(its.scale / own.scale)
            if self.overview is not None:
                weight = self.overview.weight
                weight.mul_(torch.as_tensor(scale, dtype=weight.dtype, device=weight.device))

    def rescale(self, scales: tuple[Any, Any]) -> None:
        """See Networks."""
        for extractor in self.extractors:
            cast(Extractor, extractor).set_scales(scales)

    def _logs(self, inner: Tensor) -> Tensor:
        return self.choices.log_probabilities(inner, self.actor.last)


def networks_named(name: str) -> type[Networks]:
    """Return the class of networks of that full name, which must be imported; "": that of the presets."""
    found = imported_code(name) if name else ActorCritic
    if isinstance(found, type) and issubclass(found, Networks):
        return found
    raise TrainingError(
        f"its networks are {name}, which are not imported automatically: import the module first, "
        "as by --import FILE.py"
    )


def check_outputs(networks: Networks, seen: Observed) -> None:
    """Raise TrainingError unless the user's networks return the outputs that training and play need."""
    name, count, memory = name_of(networks), len(seen), None
    if networks.state and type(networks).logs is Networks.logs:
        raise TrainingError(f"{name} has a critic that learns from the state: define logs(), without the state")
    begins = torch.ones(count, dtype=torch.bool, device="cpu") if networks.memory else None
    with playing():
        if networks.memory:
            memory = torch.zeros((count, networks.memory), **FLOAT)
        found = networks(seen, memory, begins)
        shapes = [None if each is None else tuple(each.shape) for each in found]
        wanted = [(*networks.choices.shape, count), (count,), (count, networks.memory) if networks.memory else None]
        if shapes != wanted:
            raise TrainingError(f"forward of {name} returns tensors of shapes {shapes}: they must be {wanted}")
        if not torch.allclose(found[0].exp().sum(0), found[1].new_ones(())):
            raise TrainingError(
                f"forward of {name} does not return log probabilities: take self.choices.log_softmax(logits)"
            )


class Extractor(nn.Module):
    """A network from observations to features (batch, 2 * width): half from their own numbers, half from entities.

    Entities are embedded, attend to each other and are averaged, as by torch.nn.MultiheadAttention. Only the average is
    needed, so linear maps of the rows are applied after it, and only visible rows are computed.
    """

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
        """Return features, float32 (batch, 2 * width). An agent that sees no row gets zeros for entities."""
        own = self._active(functional.linear(seen.own, self.own.weight * self.own_scale, self.own.bias))
        if not isinstance(seen, Rows):
            return torch.cat([own, attend(seen, self.weight * self.scale, self.bias, self.attention)], 1)
        embedded = self._active(seen.entities @ torch.cat([self.weight * self.scale, self.bias]))
        rows = functional.linear(embedded, self.attention.in_proj_weight, self.attention.in_proj_bias)
        mean, out = self._attended(seen, rows), self.attention.out_proj  # linear maps come after the average
        return torch.cat([own, torch.addmm((seen.count > 0)[:, None] * out.bias, mean, out.weight.T)], 1)

    def _attended(self, seen: Rows, each: Tensor) -> Tensor:
        """Average attention over the rows of each agent. each: float32 (rows, 3 * width), query, key and value."""
        if seen.room is None and compiled_networks.can_attend(each, self.preset.heads):
            return cast(Tensor, compiled_networks.Means.apply(each, seen.known))  # type: ignore[no-untyped-call]
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
        super().__init__(features, width, **FLOAT)
        for weight in (self.weight_ih, self.weight_hh):
            for gate in weight.data.chunk(3):
                nn.init.orthogonal_(gate)
        for bias in (self.bias_ih, self.bias_hh):
            nn.init.zeros_(bias)

    def through(self, features: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return the memory after each step (steps * agents, width), and after the last one (agents, width).

        features: float32 (steps * agents, features), step after step. begins: bool (steps, agents), where it is reset.
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


def attend(padded: PaddedRows, weight: Tensor, bias: Tensor, attention: nn.MultiheadAttention) -> Tensor:
    """Return the outputs of torch.nn.MultiheadAttention, averaged over all rows, hidden ones as 0: (batch, width).

    Rows are embedded with tanh. The padding row, behind all others, is embedded as zeros and visible in every sample.
    Logits of hidden rows are raised by 1, as the authors add their mask to the logits: keys are all rows, even hidden
    ones, and queries are visible rows and the padding row.

    Samples are sorted by their number of queries, so that those with the same number are one batched product. Linear
    maps are applied where there are fewest rows: that of keys to the queries, those of values and outputs after the sum
    over queries. The gradient is written out: a few large products, where autograd would keep dozens of tensors.

    weight, bias: Parameters of the layers of all kinds, stacked, (numbers of all kinds, width) and (kinds, width).
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

    counts: (batch,), number of visible rows and the padding row, sorted. to_keys: The linear map from an embedded row
    to each head's factor for all rows, (heads * width, width + 1), the bias last.
    """

    @staticmethod
    def forward(ctx: Any, padded: PaddedRows, counts: Tensor, weight: Tensor, bias: Tensor, to_keys: Tensor) -> Tensor:
        layout, seen = padded.layout, functional.pad(padded.seen, (0, 1), value=1.0)
        kinds = zip(layout.kinds, torch.split(padded.rows, [kind.rows for kind in layout.kinds], 1), strict=True)
        inputs = [part.reshape(-1, layout.features)[:, : kind.features] for kind, part in kinds]
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


def _groups(counts: Tensor) -> Iterator[tuple[slice, slice, int]]:
    """Yield, for each number of queries, its samples, their queries, and the number. `counts` is sorted."""
    sample = query = 0
    for count, samples in enumerate(torch.bincount(counts).tolist()):
        if samples:
            yield slice(sample, sample + samples), slice(query, query + samples * count), count
        sample, query = sample + samples, query + samples * count
