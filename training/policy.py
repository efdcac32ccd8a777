"""Policy and value networks with several independent actions."""

from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from .networks import Extractor, Tower
from .observation_layout import ObservationLayout
from .presets import Preset
from .rows import Observed

NEVER = -1e9  # a logit that softmax makes 0; infinity would make NaN where there is nothing else
GAIN = 0.01  # of the initial weights of the action heads, as in Stable-Baselines3


class MultiCategorical(nn.Module):
    """Independent categorical distributions, given the logits of all of them in one row.

    Log probabilities are (values, actions, batch): PyTorch's softmax is several times as fast along the first axis.
    Actions with fewer values than others are filled up with values of probability 0.
    """

    where: Tensor
    never: Tensor
    beyond: Tensor

    def __init__(self, sizes: Sequence[int]) -> None:
        """sizes: how many values each action has."""
        super().__init__()
        self.shape, start = (max(sizes), len(sizes)), 0
        where, never = torch.zeros(self.shape, dtype=torch.long), torch.full(self.shape, NEVER)
        for k, size in enumerate(sizes):
            where[:size, k] = torch.arange(start, start + size)
            never[:size, k] = 0
            start += size
        self.register_buffer("where", where.flatten(), persistent=False)
        self.register_buffer("never", never.flatten(), persistent=False)
        beyond = torch.arange(1, max(sizes))[:, None, None] >= torch.tensor(sizes)[:, None]
        self.register_buffer("beyond", beyond, persistent=False)

    def log_probabilities(self, features: Tensor, head: nn.Linear) -> Tensor:
        """(values, actions, batch) of all values, given the features that the head makes logits of."""
        weight, bias = head.weight.index_select(0, self.where), head.bias.index_select(0, self.where) + self.never
        logits = torch.addmm(bias[:, None], weight, features.T)
        return logits.view(*self.shape, len(features)).log_softmax(0)

    @staticmethod
    def of(actions: Tensor, logs: Tensor) -> Tensor:
        """The log probabilities of joint actions (batch, actions): (batch,)."""
        return logs.gather(0, actions.T[None]).sum((0, 1))

    @staticmethod
    def entropy(logs: Tensor) -> Tensor:
        """(batch,), of the joint actions."""
        return -(logs.exp() * logs).sum((0, 1))

    @staticmethod
    def likeliest(logs: Tensor) -> Tensor:
        """Joint actions, int64 (batch, actions)."""
        return logs.argmax(0).T

    def draw(self, logs: Tensor, uniform: Tensor) -> Tensor:
        """Sampled joint actions, int64 (batch, actions), from one uniform number for each, (batch, actions)."""
        below = logs.exp().cumsum(0)[:-1] + self.beyond  # rounding may leave the sum of all values below 1
        return (below <= uniform.T).sum(0).T


class ActorCritic(nn.Module):
    """Policy and value networks of a preset. Actions are int64 (batch, actions)."""

    def __init__(
        self, sizes: Sequence[int], *, layout: ObservationLayout, preset: Preset, scales: tuple[Any, Any]
    ) -> None:
        """Make networks with random weights.

        Args:
            sizes: How many values each action has.
            layout: Of the observations.
            preset: What the networks are like.
            scales: Of inputs, see observation_layout.scales.
        """
        super().__init__()
        self.layout, self.preset, self.memory = layout, preset, 0
        self.extractors = nn.ModuleList(Extractor(layout, preset, scales) for _ in range(1 if preset.shared else 2))
        self.actor, self.critic = Tower(preset, sum(sizes), GAIN), Tower(preset, 1, 1.0)
        self.choices = MultiCategorical(sizes)

    def forward(
        self, seen: Observed, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Log probabilities of all values of all actions (values, actions, batch), and values (batch,)."""
        features = [extractor(seen) for extractor in self.extractors]
        if len(features) == 2:
            return self._logs(self.actor.inner(features[0])), self.critic(features[1]).flatten(), None
        actor, critic = self.actor, self.critic  # the first layers of both as one product
        weight, bias = (torch.cat([getattr(t.first, name) for t in (actor, critic)]) for name in ("weight", "bias"))
        both = actor.activation(functional.linear(features[0], weight, bias)).chunk(2, 1)
        return self._logs(actor.behind_first(both[0])), critic.last(critic.behind_first(both[1])).flatten(), None

    def act(self, seen: Observed, generator: torch.Generator | None = None) -> Tensor:
        """Actions alone: sampled, or without a generator the likeliest."""
        logs = self._logs(self.actor.inner(self.extractors[0](seen)))
        if generator is None:
            return self.choices.likeliest(logs)
        return self.choices.draw(logs, torch.rand((len(seen), self.choices.shape[1]), generator=generator))

    def take(self, other: "ActorCritic") -> None:
        """Become the same function of observations as a policy whose inputs may be scaled otherwise.

        Raises RuntimeError, as load_state_dict does, if its networks are others.
        """
        self.load_state_dict(other.state_dict())
        with torch.no_grad():
            for one, two in zip(self.extractors, other.extractors, strict=True):
                own, its = cast(Extractor, one), cast(Extractor, two)
                own.own.weight.mul_(its.own_scale / own.own_scale)
                own.weight.mul_(its.scale / own.scale)

    def rescale(self, scales: tuple[Any, Any]) -> None:
        """Take other scales of inputs, those that weights were trained with."""
        for extractor in self.extractors:
            cast(Extractor, extractor).set_scales(scales)

    def _logs(self, inner: Tensor) -> Tensor:
        return self.choices.log_probabilities(inner, self.actor.last)
