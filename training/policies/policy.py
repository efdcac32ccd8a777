"""Policy and value networks with several independent actions: their interface, and those of the presets."""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from outlast.envs.scenarios.mechanics import imported_code

from ..base.config import name_of
from ..base.errors import TrainingError
from ..base.observation_layout import ObservationLayout
from ..base.presets import Preset
from . import compiled_networks
from .networks import Extractor, Memory, Tower, begin
from .rows import Observed, Rows
from .torch_settings import FLOAT, INDEX, playing

NEVER = -1e9  # a logit of probability 0; minus infinity gives NaN if all logits have it
GAIN = 0.01  # of the initial weights of the action heads, as in Stable-Baselines3


class MultiCategorical(nn.Module):
    """Independent categorical distributions, given the logits of all of them in one row.

    Log probabilities are (values, actions, batch): PyTorch's softmax is several times as fast along the first axis.
    Actions with fewer values than others are padded with values of probability 0.
    """

    where: Tensor
    never: Tensor
    beyond: Tensor

    def __init__(self, sizes: Sequence[int]) -> None:
        """Take the number of values of each action."""
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
        """Log probabilities of all values, (values, actions, batch), from features that the head turns into logits."""
        weight, bias = head.weight.index_select(0, self.where), head.bias.index_select(0, self.where) + self.never
        logits = torch.addmm(bias[:, None], weight, features.T)
        return logits.view(*self.shape, len(features)).log_softmax(0)

    def log_softmax(self, logits: Tensor) -> Tensor:
        """Log probabilities of all values, (values, actions, batch), of logits (batch, values of all actions)."""
        chosen = logits.T.index_select(0, self.where) + self.never[:, None]
        return chosen.view(*self.shape, len(logits)).log_softmax(0)

    @staticmethod
    def of(actions: Tensor, logs: Tensor, free: Tensor | None = None) -> Tensor:
        """Return the log probabilities of joint actions (batch, actions): (batch,).

        free: bool (batch, actions), whether an action was drawn; others were given. None: all were drawn.
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
        """Return the log probabilities and the memory only, for callers without a state that do not need values."""
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

        scale: The divisor of the state's numbers here, over their divisor there: float32 (numbers,).
        Raises RuntimeError if networks differ, as load_state_dict, and TrainingError if scales of inputs differ and
        the networks cannot compensate for it.
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
        self.actor = Tower(preset, inputs + memory, sum(sizes), GAIN)
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
        """Return the memory after each step, and after the last one; see Memory.through."""
        if self.recurrent is None or memory is None or begins is None:
            raise ValueError("a policy with a memory needs `memory` and `begins`")
        return self.recurrent.through(features, memory, begins if begins.ndim == 2 else begins[None])

    def _valued(self, features: Tensor, seen: Observed) -> Tensor:
        """Return values from the features of the critic and, if it learns from it, the state of the worlds."""
        if self.overview is not None:
            features = torch.cat([features, self.critic.activation(self.overview(seen.state))], 1)
        return self.critic(features).flatten()

    def _both(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Log probabilities and values of the same features: the first layers of both towers are one product."""
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
