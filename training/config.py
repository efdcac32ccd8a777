"""What to train, and how: everything that decides which numbers come out of a run."""

from dataclasses import asdict, dataclass, field
from typing import Any

from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.scenario import Scenario

from .errors import TrainingError
from .hyperparameters import Hyperparameters
from .presets import DEAD, preset
from .run_header import Header

POLICIES = ("shared", "side", "agent")
HOW = ("processes", "halves")  # what decides how a run is computed, not which numbers come out
FAST = "fast"  # the preset unless another one is asked for
SELF, PAST = "self", "past"  # opponents that only training has
SNAPSHOTS = 10  # updates between past selves


@dataclass(frozen=True)
class TrainingConfig:
    """What to train, and how.

    Attributes:
        scenario: What is played.
        preset: Name of the networks, see PRESETS.
        steps: Agent-steps to train for.
        seed: The same seed gives the same numbers.
        worlds: How many share a rollout; 0: as the preset has it.
        rollout: Environment steps of a rollout, of all worlds together; 0: as the preset has it.
        dead: What becomes of the samples of dead agents: "keep" or "drop".
        device: Of PyTorch.
        threads: Of the networks and the worlds; 0: one for each core, up to THREADS.
        every: Agent-steps between checkpoints.
        settings: Hyperparameters of PPO other than the preset's.
        policies: "shared": one for all agents. "side", "agent": one for each of them.
        opponents: Who the learners play against, with weights: "self", "past", the name of a policy that needs no
            training, or the path of a saved one.
        prioritised: Whether opponents are drawn the more often, the more they win.
        snapshots: Updates between past selves.
        processes: That share the worlds; the numbers are the same, but for rounding.
        halves: Whether half of the worlds are stepped while the networks are busy with the other half, on a CPU, too;
            the numbers are the same.
    """

    scenario: Scenario
    preset: str = FAST
    steps: int = 10_000_000
    seed: int = 0
    worlds: int = 0
    rollout: int = 0
    dead: str = "keep"
    device: str = "cpu"
    threads: int = 0
    every: int = 1_000_000
    settings: dict[str, Any] = field(default_factory=dict)
    policies: str = "shared"
    opponents: dict[str, float] = field(default_factory=lambda: {SELF: 1.0})
    prioritised: bool = False
    snapshots: int = SNAPSHOTS
    processes: int = 1
    halves: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be.

        Raises:
            ScenarioError: There is no such preset.
            TrainingError: Another value is not what it can be.
        """
        if self.dead not in DEAD:
            raise TrainingError(f"dead = {self.dead!r}: allowed are {', '.join(map(repr, DEAD))}")
        if self.policies not in POLICIES:
            raise TrainingError(f"policies = {self.policies!r}: allowed are {', '.join(map(repr, POLICIES))}")
        if self.prioritised and self.opponents.keys() <= {SELF}:
            raise TrainingError("prioritised has no effect without opponents: name some, such as self:0.5,past:0.5")
        if self.snapshots != SNAPSHOTS and PAST not in self.opponents:
            raise TrainingError("snapshots have no effect without past selves: name some opponents, such as past:0.5")
        _ = self.numbers, self.size  # they raise
        most = self.size[0]
        if not 1 <= self.processes <= most:
            raise TrainingError(f"processes = {self.processes}: from 1 to {most}, one for each world, are possible")

    def header(self) -> Header:
        """The part of run.json that decides which numbers come out."""
        worlds, rollout = self.size
        kept = {key: value for key, value in asdict(self).items() if key not in ("scenario", "every", *HOW)}
        opponents = ",".join(f"{name}:{weight:g}" for name, weight in self.opponents.items())
        kept |= {"worlds": worlds, "rollout": rollout, "opponents": opponents}
        if not self.numbers.anneal:  # then a run may go on for longer
            del kept["steps"]
        return {"plan": kept, "scenario": fingerprint(self.scenario)}

    @property
    def numbers(self) -> Hyperparameters:
        """Of PPO. Raises TrainingError if one is not there, or out of range."""
        return preset(self.preset).numbers.changed(self.settings)

    @property
    def size(self) -> tuple[int, int]:
        """Worlds, and environment steps of a rollout."""
        return preset(self.preset).size(self.scenario.numbers()["agents_count"], self.worlds, self.rollout)
