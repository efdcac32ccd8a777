"""What to train, and how: everything that determines the numbers that come out of a run."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from outlast.components import Return
from outlast.ecs.checks.code_hash import full_name
from outlast.ecs.kernels.integers import as_whole, is_whole
from outlast.envs.levels import Level
from outlast.envs.rollout.policies import POLICIES as NAMED
from outlast.envs.rollout.saved import MASKED, SAVED_AS, cameras_mode, is_saved, policy_file
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.mechanics import imported_code
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.serialize import classes

from .annealing import Anneal
from .errors import TrainingError
from .hyperparameters import Hyperparameters
from .presets import DEAD, PRESETS, preset
from .run_header import Header

POLICIES = ("shared", "side", "agent")
HOW = ("processes", "halves")  # what decides how a run is computed, not which numbers come out
CRITICS = ("own", "state")
FAST = "fast"  # the preset unless another one is asked for
SELF, PAST = "self", "past"  # opponents that only training has
OPPONENTS = (SELF, PAST, *NAMED)
SNAPSHOTS = 10  # updates between past selves
CHUNK = 16  # steps over which gradients flow back through a memory
LEAST = dict.fromkeys(("steps", "seed", "worlds", "rollout", "threads", "memory"), 0)
LEAST |= dict.fromkeys(("processes", "every", "snapshots"), 1)
MOST = {"memory": 4096}  # whole numbers are at least as in LEAST and, if they are named here, at most this
Choose = Callable[[Any], Sequence[Level]]  # called with a curriculum.TrainingProgress
CODE = {  # what is code of the user's own; run.json has the names
    "levels": "a function is needed, of progress to a list of levels",
    "loss": "a function is needed, of a batch to a tensor, or to that and a dict of figures",
    "networks": "a subclass of outlast.training.policies.policy.Networks is needed",
}
AS_GIVEN = (  # what the command and `outlast.train` pass on as it is
    *("preset", "steps", "worlds", "rollout", "policies", "prioritised", "snapshots", "memory", "critic", "dead"),
    *("device", "processes", "halves", "every"),
)
TEACHERS = tuple(name for name in NAMED if name not in ("random", "noop"))  # worth imitating
IMITATED = 1_500_000  # agent-steps of imitation, unless others are asked for


def parse_warm_start(text: str) -> tuple[str, int]:
    """Parse what policies start from: a name or a path, and the agent-steps of imitation; 0: the weights are taken.

    "scripted" or "scripted:2e6", and others of TEACHERS: policies learn to imitate it, for so many agent-steps.
    "FILE.zip:2e6": they imitate the policy in a file, whatever networks it has. "FILE.zip": they take the weights in
    it, for which it needs a critic. "": random weights. A file may also be FILE.safetensors, and the folder of a run
    stands for its newest checkpoint. Raises TrainingError if the text is none of these.
    """
    whole = ":" not in text or is_saved(text) or Path(text).is_dir()  # as C:/runs is
    name, _, length = (text, "", "") if whole else text.rpartition(":")
    if text and name not in TEACHERS and not is_saved(policy_file(name, TEACHERS)):
        known = f"{', '.join(TEACHERS)} or a saved policy ({SAVED_AS})"
        raise TrainingError(f"warm start {text}: {known} is needed, perhaps with :STEPS")
    try:
        steps = float(length or (IMITATED if name in TEACHERS else 0))
    except ValueError:
        steps = math.nan
    if steps % 1 != 0 or (length and steps < 1):
        raise TrainingError(
            f"warm start {text}: a whole number of agent-steps of at least 1 is needed, as in {name}:2e6"
        )
    return name, int(steps)


def name_of(code: Any) -> str:
    """Return the name of a function or class with that of its module; of any other object, that of its class."""
    return full_name(code if hasattr(code, "__qualname__") else type(code))


def check_importable(name: str, code: Any) -> None:
    """Raise TrainingError unless other code finds a function or class by the names of its module and itself."""
    if imported_code(name_of(code)) is not code:
        raise TrainingError(
            f"{name} = {name_of(code)} cannot be imported, which is needed by other processes and whoever loads what "
            "is saved: define it by its name at the top of a module"
        )


@dataclass(frozen=True)
class TrainingConfig:
    """What to train, and how: the arguments of `outlast.train` by their names, of the same meaning, and checked.

    Equal configs give equal numbers, whatever `processes`, `halves` and `every` are.

    Attributes:
        scenario: What is played.
        opponents: Names or paths with their weights.
        warm_start: See parse_warm_start.
        anneal: Numbers of the scenario that change in training. Evaluations play the scenario as it is.
        levels: A function of a curriculum.TrainingProgress.
        loss: A function of a minibatches.Batch, see loss.Loss.
        networks: A policies.policy.Networks.
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
    memory: int = 0
    critic: str = "own"
    warm_start: str = ""
    anneal: tuple[Anneal, ...] = ()
    levels: Choose | None = None
    loss: Callable[[Any], Any] | None = None
    networks: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        """Check all values. Raises ScenarioError for an unknown preset, TrainingError for other impossible values."""
        for name, least in LEAST.items():
            value, most = as_whole(getattr(self, name)), MOST.get(name, 2**62 - 1)
            if not is_whole(value, least, most):
                up_to = f" to {most}" if name in MOST else ""
                raise TrainingError(f"{name} = {value!r}: a whole number from {least}{up_to} is needed")
            object.__setattr__(self, name, int(value))
        if self.dead not in DEAD:
            raise TrainingError(f"dead = {self.dead!r}: allowed are {', '.join(map(repr, DEAD))}")
        if self.dead == "drop" and self._comes_back():
            raise TrainingError("dead = 'drop': agents come back here, so no return ends at a death; take 'keep'")
        if self.policies not in POLICIES:
            raise TrainingError(f"policies = {self.policies!r}: allowed are {', '.join(map(repr, POLICIES))}")
        if self.prioritised and PAST not in self.opponents and len(self.opponents.keys() - {SELF}) < 2:
            raise TrainingError("prioritised needs several opponents to choose among: name some, such as self:1,past:1")
        if self.snapshots != SNAPSHOTS and PAST not in self.opponents:
            raise TrainingError("snapshots have no effect without past selves: name some opponents, such as past:0.5")
        if self.critic not in CRITICS:
            raise TrainingError(f"critic = {self.critic!r}: allowed are {', '.join(map(repr, CRITICS))}")
        _, (teacher, _), (worlds, rollout) = self.numbers, self.teacher, self.size  # these check themselves
        if (file := policy_file(teacher, TEACHERS)) != teacher:  # so that the run records which file it was
            object.__setattr__(self, "warm_start", self.warm_start.replace(teacher, file, 1))
        self._check_cameras()
        if self.memory and rollout // worlds % CHUNK:
            fitting = worlds * CHUNK * max(1, round(rollout / worlds / CHUNK))
            raise TrainingError(
                f"a rollout of {rollout} steps has {rollout // worlds} of each world: with a memory, a multiple of "
                f"{CHUNK} is needed, such as --rollout {fitting}"
            )
        for each in self.anneal:
            each.check(self.scenario)
        self._check_code()
        decisive = [name for name in ("agents_count", "teams_sizes") if name in dict(self.scenario.varied)]
        if self.policies == "side" and "teams" in self.scenario and decisive:
            raise TrainingError(
                f"policies = 'side': {decisive[0]} varies, and with it who is on which side; take 'shared' or 'agent'"
            )
        object.__setattr__(self, "anneal", tuple(replace(a, steps=a.steps or self.steps) for a in self.anneal))
        if self.processes > (most := self.size[0]):
            raise TrainingError(f"processes = {self.processes}: from 1 to {most}, one for each world, are possible")

    def check_teacher(self) -> None:
        """Raise TrainingError if a run cannot begin by imitating the teacher; it can still go on from a checkpoint."""
        name, imitated = self.teacher
        if imitated and is_saved(name) and (self.processes > 1 or self.halves):
            raise TrainingError(
                f"{name} draws numbers in turn: imitate it with one process and without halves, then resume with them"
            )

    def _comes_back(self) -> bool:
        """Return whether dead agents return to the world."""
        kinds = (kind for module in self.scenario.modules for kind in module.archetypes())
        return any(isinstance(part, Return) for kind in kinds for part in kind.parts)

    def _check_cameras(self) -> None:
        """Raise TrainingError if the preset would replace the cameras_mode that the scenario asks for."""
        trained, asked = preset(self.preset).cameras, cameras_mode(self.scenario)
        if asked not in (None, MASKED, trained):
            others = [name for name, each in PRESETS.items() if each.cameras == asked]
            cure = f", or take preset {' or '.join(others)}" if others else ""
            raise TrainingError(
                f"cameras_mode = {asked}: preset {self.preset} trains with {trained}; leave it as it was{cure}"
            )

    def _check_code(self) -> None:
        for name, needed in CODE.items():
            code = getattr(self, name)
            if code is None:
                continue
            if not callable(code):
                raise TrainingError(f"{name} = {code!r:.200}: {needed}")
            if name == "levels" and self.processes > 1:
                raise TrainingError("levels are chosen in one process, as the function is: leave out processes")
            if name == "networks" or (name == "loss" and self.processes > 1):
                check_importable(name, code)

    def header(self) -> Header:
        """Return the part of run.json that determines the numbers that come out."""
        worlds, rollout = self.size
        kept = {key: value for key, value in vars(self).items() if key not in ("scenario", "every", *HOW)}
        kept |= {name: kept[name] and name_of(kept[name]) for name in CODE}
        opponents = ",".join(f"{name}:{weight:g}" for name, weight in self.opponents.items())
        kept |= {"worlds": worlds, "rollout": rollout, "opponents": opponents}
        kept["anneal"] = ",".join(map(str, self.anneal))
        if not self.numbers.anneal_lr:  # then the steps decide no numbers, and the run may be made longer
            del kept["steps"]
        return {"plan": kept, "scenario": fingerprint(self.scenario), "modules": classes(self.scenario)}

    @property
    def numbers(self) -> Hyperparameters:
        """The numbers of PPO. Raises TrainingError if one does not exist or is out of range."""
        return preset(self.preset).numbers.changed(self.settings)

    @property
    def teacher(self) -> tuple[str, int]:
        """Return who is imitated first, and for how many agent-steps; see parse_warm_start. Raises TrainingError."""
        return parse_warm_start(self.warm_start)

    @property
    def size(self) -> tuple[int, int]:
        """Return the number of worlds, and the environment steps of a rollout."""
        return preset(self.preset).size(self.agents, self.worlds, self.rollout)

    @property
    def agents(self) -> int:
        """Agents of a world; where their number varies, the largest."""
        varied = dict(self.scenario.varied).get("agents_count")  # without agents, making worlds raises an error later
        return int(varied.extremes()[1] if varied else self.scenario.numbers().get("agents_count", 1))


@dataclass(frozen=True)
class Workload:
    """The agent-steps of a run, including those of opponents, in rollouts that are always collected completely.

    asked: Those that were requested. each: Those of a rollout, the product of `sizes`.
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
        """Return how many rollouts there are."""
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
