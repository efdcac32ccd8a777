"""The minibatches of an update: samples or, for a policy with a memory, chunks of several steps."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ..base.config import CHUNK
from ..base.presets import Hyperparameters
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

    They are shuffled in units of `length` steps of one agent: 1 or, for a policy with a memory, CHUNK, through which
    gradients flow back. Samples of others in a unit have weight 0.

    units: int64, indices of units of all processes that hold samples of the learner. On the CPU.
    """

    def __init__(self, rollout: Rollout, number: int, policy: Networks, device: torch.device) -> None:
        """Choose the samples of a learner, by its number. device: Where the policy is trained."""
        self.rollout, self.device, self.seen = rollout, device, rollout.seen[policy.preset.form].to(device)
        here = slice(rollout.first, rollout.first + rollout.actions.shape[1])
        own = {"advantages": rollout.advantages, "actions": rollout.actions, "old_log_probs": rollout.log_probs}
        own |= {"old_values": rollout.values[:, here], "returns": rollout.returns[:, here]}
        own |= {} if rollout.idle is None else {"free": ~rollout.idle}
        own |= {"memory": rollout.memory, "begins": rollout.begins} if policy.memory else {}
        self.own = {
            name: moved(torch.from_numpy(each.reshape(-1, *each.shape[2:])), device) for name, each in own.items()
        }
        self.advantages = self.own.pop("advantages")  # those of all processes
        self.remembered = [self.own.pop(name, None) for name in ("memory", "begins")]
        mine = rollout.learner == number
        self.length, self.agents = CHUNK if policy.memory else 1, mine.shape[1]
        self.units = torch.from_numpy(np.flatnonzero(mine.reshape(-1, self.length, self.agents).any(1)))
        self.mine = torch.from_numpy(mine.ravel())

    def select(self, part: Tensor, share: int = 0, shares: int = 1) -> Minibatch | None:
        """Return this process's share of the minibatch of some units, or a share of that; None if it has none."""
        first = part // self.agents * (self.length * self.agents) + part % self.agents
        index = (first + torch.arange(self.length, **INDEX)[:, None] * self.agents).flatten()
        weights = self.mine.index_select(0, index).double()
        weights /= weights.sum()
        where, own = self.rollout.here(index)
        if shares > 1:
            some = torch.arange(len(own), **INDEX).view(self.length, -1).tensor_split(shares, 1)[share].flatten()
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
        memory, begins = self.remembered
        if memory is not None and begins is not None:
            agents, first = self.rollout.actions.shape[1], own.view(self.length, -1)[0]
            chunks = first // (agents * self.length) * agents + first % agents
            found["memory"] = memory.index_select(0, moved(chunks, self.device))
            found["begins"] = begins.index_select(0, there).view(self.length, -1)
        return Minibatch(seen=self.seen.select(own), advantages=advantages, weights=weights, **found)


def normalised(advantages: Tensor, weights: Tensor) -> Tensor:
    """Bring advantages (batch,) to mean 0 and spread 1 over the counted samples; weights: see Minibatch."""
    count = 1 / weights.max()
    centred = advantages - weights @ advantages
    spread = (weights @ centred.square() * count / (count - 1)).sqrt()
    return centred / (spread + TINY)
