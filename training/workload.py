"""How much a run comprises, which is known before it begins."""

from dataclasses import dataclass

from .config import SELF, TrainingConfig


@dataclass(frozen=True)
class Workload:
    """The agent-steps of a run, in rollouts that are always collected as a whole.

    Attributes:
        asked: Agent-steps that were asked for.
        each: Agent-steps of a rollout: worlds x steps of each world x agents.
        sizes: These three.
        partly: Whether some of them are played by opponents, which are not counted.
    """

    asked: int
    each: int
    sizes: tuple[int, int, int]
    partly: bool

    @classmethod
    def of(cls, config: TrainingConfig) -> "Workload":
        """That of a run."""
        (worlds, rollout), agents = config.size, config.agents
        partly = not config.opponents.keys() <= {SELF}
        return cls(config.steps, rollout * agents, (worlds, rollout // worlds, agents), partly)

    @property
    def rollouts(self) -> int:
        """How many there are, at least."""
        return -(-self.asked // self.each)

    @property
    def total(self) -> int:
        """Agent-steps at the end; about, where opponents play some."""
        return max(self.asked, self.each) if self.partly else self.rollouts * self.each

    def __str__(self) -> str:
        worlds, steps, agents = self.sizes
        sizes = f"{worlds:,} worlds x {steps:,} steps x {agents:,} agents"
        most = "at most " * self.partly
        if self.asked <= self.each:
            return f"{self.asked:,} agent-steps, rounded up to one rollout of {most}{self.each:,} ({sizes})"
        least = "at least " * self.partly
        return f"{self.asked:,} agent-steps in {least}{self.rollouts:,} rollouts of {most}{self.each:,} ({sizes})"
