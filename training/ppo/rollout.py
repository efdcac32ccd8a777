"""A rollout: observations, actions and rewards of the agents of all worlds in a number of steps."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from ..base.errors import TrainingError
from ..base.presets import Form
from ..policies.checkpoint import REST
from ..policies.rows import Observed

Array = np.ndarray[Any, Any]
NOBODY = -1  # the learner of a sample that is not used for training
DEAREST = 1e30  # the largest reward or sum of rewards: float32 can hold it, and float64 its square


@dataclass(frozen=True)
class Rollout:
    """Samples (steps, agents, ...) of the agents of this process; of all processes, where noted, once completed."""

    seen: Mapping[Form, Observed]  # before each step, steps * agents, by the form in which networks take it
    own: Array  # float32 (steps, agents, layout.own), numbers that belong to no entity, as observed
    actions: Array  # int64 (steps, agents, actions)
    log_probs: Array  # float32, log-probabilities of the actions when they were chosen
    values: Array  # float32, by the critic; of all processes. A lane leaves out those computed apart, see Collector
    rewards: Array  # float32
    later: Array  # float32, the value of the next observation, where an episode was truncated after the step; else 0
    ends: Array  # bool, whether the agent's next step does not count for this one, since its episode ends
    begins: Array  # bool, whether the agent's memory is reset before the step
    alive: Array  # bool, whether the agent lived when it observed
    learner: Array  # int16, the learner that is trained on the sample, or NOBODY; of all processes
    idle: Array | None  # bool (steps, agents, actions), whether one was not drawn, for lack of effect; None: all were
    memory: Array  # float32 (chunks, agents, width), the agents' memory before each chunk of CHUNK steps
    last: Array  # float32 (agents,), values of the observations at the end
    advantages: Array = field(default_factory=lambda: np.empty(0, np.float32))  # of all processes
    first: int = 0  # index of this process's first agent among those of all processes

    @property
    def returns(self) -> Array:
        """float32, targets of the values."""
        return self.advantages + self.values

    def here(self, samples: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor]:
        """Find the samples of this process among some samples of all processes.

        samples: Indices of the samples, int64 (some,). Returns the positions in `samples` of this process's samples,
        None if all are; and their indices among its own samples.
        """
        agents, own = self.learner.shape[1], self.actions.shape[1]
        if own == agents:
            return None, samples
        step, agent = samples // agents, samples % agents - self.first
        where = torch.nonzero((agent >= 0) & (agent < own)).flatten()
        return where, (step * own + agent)[where]


class RewardScale:
    """The running standard deviation of discounted sums of rewards, the divisor of rewards.

    It makes the size of values and advantages about the same in all scenarios. After enough rollouts it moves slowly:
    all older rollouts have at most MEMORY times the weight of the newest one.
    """

    MEMORY = 50.0
    LEAST = 1e-8  # below it the spread is negligible, and rewards are not scaled

    def __init__(self, agents: int, gamma: float) -> None:
        """Allocate memory for a rollout. agents: Number of agents in all worlds. gamma: Discount of a step."""
        self.gamma, self.sums = gamma, np.zeros(agents)
        self.count, self.mean, self.variance = 0.0, 0.0, 1.0

    def update(self, rewards: Array, ends: Array) -> float:
        """Add the rewards of a rollout, and return the standard deviation; 1 if that is below LEAST.

        rewards: float32 (steps, agents). ends: bool (steps, agents), whether the sum is reset after the step.
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
        spread = math.sqrt(self.variance)
        return spread if spread >= self.LEAST else 1.0

    def state(self) -> dict[str, torch.Tensor]:
        """Return the state for a checkpoint: float64 tensors by name."""
        numbers = {"sums": self.sums, "count": self.count, "mean": self.mean, "variance": self.variance}
        return {name: torch.tensor(value, dtype=torch.float64, device="cpu") for name, value in numbers.items()}

    def restore(self, given: Any) -> None:
        """Restore tensors like those of `state`. Raises TrainingError if a number is out of bounds."""
        self.sums = given["sums"].numpy().copy()
        self.count, self.mean, self.variance = (float(given[name]) for name in ("count", "mean", "variance"))
        if wrong := self.wrong(f" in {REST} of the checkpoint"):
            raise TrainingError(f"rewards {wrong}")

    def wrong(self, where: str = "") -> str:
        """Name the number that is out of the bounds for a run, and the bounds; "" if none is.

        where: Text after the name of the number.
        """
        for name, value in self.state().items():
            low, high = (0.0, DEAREST**2) if name in ("count", "variance") else (-DEAREST, DEAREST)
            if not ((value >= low) & (value <= high)).all():
                return f"{name}{where} is beyond {low:g} to {high:g}"
        return ""
