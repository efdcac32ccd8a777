"""The minibatches of an update: samples, or for a policy with a memory chunks of several steps."""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .config import CHUNK
from .rollout import Rollout
from .rows import Observed


@dataclass(frozen=True)
class Minibatch:
    """Some samples: tensors (batch,), of `actions` (batch, actions).

    Attributes:
        seen: What was observed.
        actions: int64.
        log_probs: float32, of the actions, when they were chosen.
        advantages: float32.
        returns: float32.
        weights: float32, how much each sample counts, see loss.ppo_loss.
        memory: float32 (agents, width), before the first step; None for policies without a memory.
        begins: bool (steps, agents), where episodes begin; likewise.
    """

    seen: Observed
    actions: Tensor
    log_probs: Tensor
    advantages: Tensor
    returns: Tensor
    weights: Tensor
    memory: Tensor | None = None
    begins: Tensor | None = None


class Samples:
    """The samples of a rollout that are a learner's, on a device; on the CPU, views of its arrays.

    Attributes:
        units: int64, what is shuffled and shared out among minibatches: numbers of samples. On the CPU.
    """

    def __init__(self, rollout: Rollout, number: int, device: torch.device) -> None:
        """number: of the learner. device: of its policy."""
        self.device, self.seen = device, rollout.seen.to(device)
        arrays = rollout.actions, rollout.log_probs, rollout.advantages, rollout.returns
        self.flat = [torch.from_numpy(each.reshape(-1, *each.shape[2:])).to(device) for each in arrays]
        self.units = torch.from_numpy(np.flatnonzero(rollout.learner == number))

    def select(self, part: Tensor) -> Minibatch:
        """That of some units."""
        index = part.to(self.device)
        return self._select(index, self.flat[-1].new_full((len(part),), 1 / len(part)))

    def _select(
        self, index: Tensor, weights: Tensor, memory: Tensor | None = None, begins: Tensor | None = None
    ) -> Minibatch:
        actions, log_probs, advantages, returns = (each.index_select(0, index) for each in self.flat)
        return Minibatch(
            self.seen.select(index), actions, log_probs, advantages, returns, weights, memory=memory, begins=begins
        )


class Chunks(Samples):
    """The same in chunks of CHUNK steps of one agent, which gradients flow back through.

    Attributes:
        units: int64, numbers of the chunks that hold samples of the learner's; the others in them count nothing.
    """

    def __init__(self, rollout: Rollout, number: int, device: torch.device) -> None:
        """rollout: Its steps are a multiple of CHUNK. number: of the learner. device: of its policy."""
        super().__init__(rollout, number, device)
        mine = rollout.learner == number
        self.agents = mine.shape[1]
        self.units = torch.from_numpy(np.flatnonzero(mine.reshape(-1, CHUNK, self.agents).any(1)))
        self.mine, self.begins = (torch.from_numpy(each.ravel()).to(device) for each in (mine, rollout.begins))
        self.memory = torch.from_numpy(rollout.memory.reshape(-1, rollout.memory.shape[2])).to(device)

    def select(self, part: Tensor) -> Minibatch:
        """That of some units: step after step of all of them."""
        chunks = part.to(self.device)
        first = chunks // self.agents * (CHUNK * self.agents) + chunks % self.agents
        steps = torch.arange(CHUNK, device=self.device)[:, None] * self.agents
        index = (first + steps).flatten()
        weights = self.mine.index_select(0, index).to(self.flat[-1].dtype)
        begins = self.begins.index_select(0, index).view(CHUNK, -1)
        return self._select(index, weights / weights.sum(), self.memory.index_select(0, chunks), begins)
