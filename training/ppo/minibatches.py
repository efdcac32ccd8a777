"""The minibatches of an update: samples or, for a policy with a memory, chunks of several steps."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..base.config import CHUNK
from ..base.hyperparameters import Hyperparameters
from ..base.presets import Form
from ..policies.policy import Networks
from ..policies.rows import Observed, moved
from ..policies.torch_settings import INDEX
from .rollout import Rollout

TINY = 1e-8  # added to the spread of advantages, which may be 0


@dataclass(frozen=True, kw_only=True)
class Minibatch:
    """Some samples: tensors (batch,), and `actions` (batch, actions).

    Attributes:
        seen: Observations: Rows, or PaddedRows with preset `original`.
        actions: int64.
        old_log_probs: float32, log-probabilities of the actions when they were chosen.
        old_values: float32, the critic's values then.
        advantages: float32, normalised over the minibatch; before: returns - old_values.
        returns: float32, targets of the values.
        weights: float32, weight of each sample: 0 if it is masked, otherwise 1 / number of samples that are not.
        free: bool (batch, actions), whether an action was drawn, since it could have an effect; None: all were.
        memory: float32 (agents, width), before the first step; None for policies without a memory.
        begins: bool (steps, agents), where episodes begin; None for policies without a memory.
    """

    seen: Observed
    actions: Tensor
    old_log_probs: Tensor
    old_values: Tensor
    advantages: Tensor
    returns: Tensor
    weights: Tensor
    free: Tensor | None = None
    memory: Tensor | None = None
    begins: Tensor | None = None


@dataclass(frozen=True, kw_only=True)
class Batch(Minibatch):
    """Inputs of a loss: samples of a minibatch, and the present outputs of the networks.

    A minibatch is computed in shares, on several threads or processes. The loss of a minibatch is the sum of the losses
    of its shares, so it must be a sum over samples with `weights`: `batch.mean(x)`, and never `x.mean()`.

    Attributes:
        network: The networks that are trained.
        numbers: The numbers of PPO.
        logs: float32 (values, actions, batch), log-probabilities of all values of all actions.
        values: float32 (batch,), the critic's values.
    """

    network: Networks
    numbers: Hyperparameters
    logs: Tensor
    values: Tensor

    def mean(self, values: Tensor) -> Tensor:
        """Return this share's part of the mean of values (batch,) over the counted samples of the minibatch."""
        return self.weights @ values

    @cached_property
    @torch.enable_grad()
    def log_probs(self) -> Tensor:
        """float32 (batch,), log-probabilities of the joint actions, as far as they were drawn."""
        return self.network.choices.of(self.actions, self.logs, self.free)

    @cached_property
    @torch.enable_grad()
    def log_ratio(self) -> Tensor:
        """float32 (batch,), the increase of `log_probs` since the samples were collected."""
        return self.log_probs - self.old_log_probs

    @cached_property
    @torch.enable_grad()
    def ratio(self) -> Tensor:
        """float32 (batch,), the factor by which the probability of the joint actions has grown."""
        return self.log_ratio.exp()

    @cached_property
    @torch.enable_grad()
    def entropy(self) -> Tensor:
        """float32 (batch,), the entropy of the joint actions, as far as they are drawn."""
        return self.network.choices.entropy(self.logs, self.free)


class Samples:
    """A learner's samples of a rollout, on a device; on the CPU, these are views of the rollout's arrays.

    units: int64, indices of samples of all processes, which are shuffled and divided into minibatches. On the CPU.
    """

    LENGTH = 1  # samples of a unit

    def __init__(self, rollout: Rollout, number: int, form: Form, device: torch.device) -> None:
        """Choose the samples of a learner.

        number: The number of the learner. form: In which its networks take observations. device: Where it is trained.
        """
        self.rollout, self.device, self.seen = rollout, device, rollout.seen[form].to(device)
        here = slice(rollout.first, rollout.first + rollout.actions.shape[1])
        own = {"advantages": rollout.advantages, "actions": rollout.actions, "old_log_probs": rollout.log_probs}
        own |= {"old_values": rollout.values[:, here], "returns": rollout.returns[:, here]}
        own |= {} if rollout.idle is None else {"free": ~rollout.idle}
        self.own = {
            name: moved(torch.from_numpy(each.reshape(-1, *each.shape[2:])), device) for name, each in own.items()
        }
        self.advantages = self.own.pop("advantages")  # those of all processes
        self.units = torch.from_numpy(np.flatnonzero(rollout.learner == number))

    def select(self, part: Tensor, share: int = 0, shares: int = 1) -> Minibatch | None:
        """Return this process's share of the minibatch of some units, or a share of that; None if it has none."""
        weights = torch.full((len(part),), 1 / len(part), dtype=torch.float64, device="cpu")
        return self._select(part, weights, share, shares)

    def _select(self, index: Tensor, weights: Tensor, share: int, shares: int) -> Minibatch | None:
        """Return a share of the minibatch of some samples of all processes, with their weights, both on the CPU."""
        where, own = self.rollout.here(index)
        if shares > 1:
            some = torch.arange(len(own), **INDEX).view(self.LENGTH, -1).tensor_split(shares, 1)[share].flatten()
            where, own = some if where is None else where[some], own[some]
        if not len(own):
            return None
        weights = moved(weights.to(self.advantages.dtype), self.device)
        advantages = normalised(self.advantages.index_select(0, moved(index, self.device)), weights)
        if where is not None:
            there = moved(where, self.device)
            advantages, weights = advantages.index_select(0, there), weights.index_select(0, there)
        there = moved(own, self.device)
        found = {name: each.index_select(0, there) for name, each in self.own.items()}
        memory, begins = self._remembered(own)
        more: dict[str, Any] = {"weights": weights, "memory": memory, "begins": begins}
        return Minibatch(seen=self.seen.select(own), advantages=advantages, **found, **more)

    def _remembered(self, own: Tensor) -> tuple[Tensor | None, Tensor | None]:
        """Return the memory before some samples of this process, and where it is reset."""
        return None, None


class Chunks(Samples):
    """A learner's samples in chunks of CHUNK steps of one agent, through which gradients flow back.

    units: int64, indices of the chunks that hold samples of the learner; other samples in them have weight 0.
    """

    LENGTH = CHUNK

    def __init__(self, rollout: Rollout, number: int, form: Form, device: torch.device) -> None:
        """Choose from `rollout`, of a multiple of CHUNK steps. number, form, device: Of the learner."""
        super().__init__(rollout, number, form, device)
        mine = rollout.learner == number
        self.agents = mine.shape[1]
        self.units = torch.from_numpy(np.flatnonzero(mine.reshape(-1, CHUNK, self.agents).any(1)))
        self.mine = torch.from_numpy(mine.ravel())
        self.begins = moved(torch.from_numpy(rollout.begins.ravel()), device)
        self.memory = moved(torch.from_numpy(rollout.memory.reshape(-1, rollout.memory.shape[2])), device)

    def select(self, part: Tensor, share: int = 0, shares: int = 1) -> Minibatch | None:
        """Return this process's share of the minibatch of some units, or a share of that, step after step."""
        first = part // self.agents * (CHUNK * self.agents) + part % self.agents
        index = (first + torch.arange(CHUNK, **INDEX)[:, None] * self.agents).flatten()
        weights = self.mine.index_select(0, index).double()
        return self._select(index, weights / weights.sum(), share, shares)

    def _remembered(self, own: Tensor) -> tuple[Tensor | None, Tensor | None]:
        agents = self.rollout.actions.shape[1]
        first = own.view(CHUNK, -1)[0]
        chunks = first // (agents * CHUNK) * agents + first % agents
        begins = self.begins.index_select(0, moved(own, self.device)).view(CHUNK, -1)
        return self.memory.index_select(0, moved(chunks, self.device)), begins


def normalised(advantages: Tensor, weights: Tensor) -> Tensor:
    """Bring advantages (batch,) to mean 0 and spread 1 over the counted samples; weights: see Minibatch."""
    count = 1 / weights.max()
    centred = advantages - weights @ advantages
    spread = (weights @ centred.square() * count / (count - 1)).sqrt()
    return centred / (spread + TINY)
