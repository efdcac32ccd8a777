"""A rollout: what the agents of all worlds observed, did and got in a number of steps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from .rows import Observed

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class Rollout:
    """Samples (steps, agents of all worlds, ...).

    Attributes:
        seen: What was observed before each step, steps * agents.
        actions: int64 (steps, agents, actions).
        log_probs: float32, of the actions, when they were chosen.
        values: float32, of what was observed.
        advantages: float32.
        learner: int8, which of the learners is trained on the sample; -1: none.
        alive: bool, whether the agent lived when it observed.
    """

    seen: Observed
    actions: Array
    log_probs: Array
    values: Array
    advantages: Array
    learner: Array
    alive: Array

    @property
    def returns(self) -> Array:
        """float32, what values are to become."""
        return self.advantages + self.values


class RewardScale:
    """The running standard deviation of discounted sums of rewards, which rewards are divided by.

    So values and advantages are of about the same size whatever a scenario pays. After enough rollouts it moves slowly:
    older ones count as MEMORY of the newest at most.
    """

    MEMORY = 50.0
    LEAST = 1e-8  # where nothing is paid for long, the deviation falls without end

    def __init__(self, agents: int, gamma: float) -> None:
        """agents: of all worlds. gamma: discount of a step."""
        self.gamma, self.sums = gamma, np.zeros(agents)
        self.count, self.mean, self.variance = 0.0, 0.0, 1.0

    def update(self, rewards: Array, ends: Array) -> float:
        """Take in the rewards of a rollout; the standard deviation.

        Args:
            rewards: float32 (steps, agents).
            ends: bool (steps, agents), whether the sum begins anew after the step.
        """
        sums = np.empty(rewards.shape)
        for t, reward in enumerate(rewards):
            self.sums = sums[t] = self.sums * self.gamma + reward
            self.sums = np.where(ends[t], 0, self.sums)
        kept = min(self.count, self.MEMORY * sums.size)
        share, apart = sums.size / (kept + sums.size), sums.mean() - self.mean
        self.variance += share * (sums.var() - self.variance + (1 - share) * apart**2)
        self.mean += share * apart
        self.count = kept + sums.size
        return max(math.sqrt(self.variance), self.LEAST)

    def state(self) -> dict[str, torch.Tensor]:
        """What a run goes on with: float64 tensors by name."""
        numbers = {"sums": self.sums, "count": self.count, "mean": self.mean, "variance": self.variance}
        return {name: torch.tensor(value, dtype=torch.float64) for name, value in numbers.items()}

    def restore(self, state: Mapping[str, torch.Tensor]) -> None:
        """Go on from what `state` returned."""
        self.sums = state["sums"].numpy().copy()
        self.count, self.mean, self.variance = (float(state[name]) for name in ("count", "mean", "variance"))
