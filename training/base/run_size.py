"""The size of a run, which is known before it begins."""

from dataclasses import dataclass

from .config import TrainingConfig


@dataclass(frozen=True)
class Workload:
    """The agent-steps of a run, including those of opponents, in rollouts that are always collected completely.

    asked: Agent-steps that were requested. each: Agent-steps of a rollout: worlds x steps of each world x agents.
    """

    asked: int
    each: int
    sizes: tuple[int, int, int]

    @classmethod
    def of(cls, config: TrainingConfig) -> "Workload":
        """The workload of a run."""
        (worlds, rollout), agents = config.size, config.agents
        return cls(config.steps, rollout * agents, (worlds, rollout // worlds, agents))

    @property
    def rollouts(self) -> int:
        """How many rollouts there are."""
        return -(-self.asked // self.each)

    @property
    def total(self) -> int:
        """The agent-steps at the end."""
        return self.rollouts * self.each

    def __str__(self) -> str:
        worlds, steps, agents = self.sizes
        sizes = f"{worlds:,} worlds x {steps:,} steps x {agents:,} agents"
        if self.asked <= self.each:
            return f"{self.asked:,} agent-steps, rounded up to one rollout of {self.each:,} ({sizes})"
        return f"{self.asked:,} agent-steps in {self.rollouts:,} rollouts of {self.each:,} ({sizes})"
