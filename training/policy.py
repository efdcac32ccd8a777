"""Policy and value networks with several independent actions, in the form that Stable-Baselines3's PPO asks for."""

from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from .networks import NEVER, Extractor, Tower
from .observation_layout import ObservationLayout
from .presets import Preset

GAIN = 0.01  # of the initial weights of the action heads, as in Stable-Baselines3


class MultiCategorical(nn.Module):
    """Independent categorical distributions, given the logits of all of them in one row."""

    where: Tensor
    never: Tensor

    def __init__(self, sizes: Sequence[int]) -> None:
        """sizes: how many values each action has. Shorter ones are filled up with values of probability 0."""
        super().__init__()
        self.count, longest, start = len(sizes), max(sizes), 0
        where = torch.zeros(self.count, longest, dtype=torch.long)
        never = torch.full((self.count, longest), NEVER)
        for k, size in enumerate(sizes):
            where[k, :size] = torch.arange(start, start + size)
            never[k, :size] = 0
            start += size
        self.register_buffer("where", where.flatten(), persistent=False)
        self.register_buffer("never", never.flatten(), persistent=False)

    def log_probabilities(self, features: Tensor, head: nn.Linear) -> Tensor:
        """(batch, actions, values) of all values, given the features that the head makes logits of."""
        weight, bias = head.weight.index_select(0, self.where), head.bias.index_select(0, self.where) + self.never
        return functional.linear(features, weight, bias).view(len(features), self.count, -1).log_softmax(2)

    @staticmethod
    def of(actions: Tensor, logs: Tensor) -> Tensor:
        """The log probabilities of joint actions (batch, actions): (batch,)."""
        return logs.gather(2, actions[:, :, None]).sum((1, 2))

    @staticmethod
    def entropy(logs: Tensor) -> Tensor:
        """(batch,), of the joint actions."""
        return -(logs.exp() * logs).sum((1, 2))

    @staticmethod
    def draw(logs: Tensor, generator: torch.Generator | None) -> Tensor:
        """Sampled joint actions (batch, actions), int64: the value with the first of as many exponential clocks."""
        clocks = torch.empty_like(logs).exponential_(generator=generator)
        return (logs.exp() / clocks).argmax(2)


class ActorCritic(nn.Module):
    """Policy and value networks of a preset, and their optimiser.

    Packed observations, float32 (batch, layout.size), go in; actions are int64 (batch, actions).
    """

    entropy_gradients = False  # they cost time, and are of use only where the loss has a term for entropy

    def __init__(
        self,
        sizes: Sequence[int],
        lr_schedule: Callable[[float], float],
        *,
        layout: ObservationLayout,
        preset: Preset,
        scales: tuple[Any, Any],
    ) -> None:
        """sizes: how many values each action has. lr_schedule: the learning rate, given the share that is left."""
        super().__init__()
        self.layout, self.preset = layout, preset
        self.extractors = nn.ModuleList(Extractor(layout, preset, scales) for _ in range(1 if preset.shared else 2))
        self.actor, self.critic = Tower(preset, sum(sizes), GAIN), Tower(preset, 1, 1.0)
        self.choices = MultiCategorical(sizes)
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), eps=1e-5, fused=True)

    def forward(self, packed: Tensor, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Sampled actions, values (batch,), and log probabilities of the actions (batch,)."""
        logs, values = self._both(packed)
        actions = self.choices.draw(logs, generator)
        return actions, values, self.choices.of(actions, logs)

    def evaluate_actions(self, packed: Tensor, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log probabilities of given actions, entropies, (batch,) each."""
        logs, values = self._both(packed)
        entropy = self.choices.entropy(logs if self.entropy_gradients else logs.detach())
        return values, self.choices.of(actions, logs), entropy

    def predict_values(self, packed: Tensor) -> Tensor:
        """Values alone, (batch,)."""
        values: Tensor = self.critic(self.extractors[-1](packed)).flatten()
        return values

    def act(self, packed: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Actions alone: sampled, or without a generator the likeliest."""
        logs = self._logs(self.extractors[0](packed))
        return logs.argmax(2) if generator is None else self.choices.draw(logs, generator)

    def rescale(self, scales: tuple[Any, Any]) -> None:
        """Take other scales of inputs, those that weights were trained with."""
        for extractor in self.extractors:
            cast(Extractor, extractor).set_scales(scales)

    def set_training_mode(self, mode: bool) -> None:
        """Nothing here behaves differently in training."""
        self.train(mode)

    def _both(self, packed: Tensor) -> tuple[Tensor, Tensor]:
        features = [extractor(packed) for extractor in self.extractors]
        return self._logs(features[0]), self.critic(features[-1]).flatten()

    def _logs(self, features: Tensor) -> Tensor:
        return self.choices.log_probabilities(self.actor.inner(features), self.actor.last)
