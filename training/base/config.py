"""Options of training and evaluation. TrainingConfig has those that determine the results of a run."""

import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from outlast.components import Return
from outlast.ecs.checks.code_hash import full_name
from outlast.ecs.kernels.integers import as_whole
from outlast.envs.api.options import check_options, default_of, option, options_of
from outlast.envs.levels import Level
from outlast.envs.rollout.lineup import checked_entries, parse_lineup
from outlast.envs.rollout.policies import POLICIES as NAMED
from outlast.envs.rollout.saved import MASKED, SAVED_AS, cameras_mode, is_saved, policy_file, text_of
from outlast.envs.scenarios.derivation import as_filename
from outlast.envs.scenarios.fingerprint import classes, fingerprint
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.scenario_json import imported_code

from .errors import TrainingError
from .policy_file import Header
from .presets import DEAD, KINDS, PRESETS, ChoicesBySide, Hyperparameters, parse_hyperparameters, preset

NEEDED = "NUMBER=FROM:TO or NUMBER=FROM:TO@STEPS is needed, as in rewards_kill=10:0@5e6"
HOW = ("processes",)  # settings that change the computation, not the results
LEARNED, OPPOSED, ROLLOUT, OUTPUT, MACHINE = "what is learned", "opponents", "a rollout", "output", "machine"
PLAYED = "what is played"
FAST = "fast"  # the preset by default
SELF, PAST = "self", "past"  # opponents that exist only in training
OPPONENTS = (SELF, PAST, *NAMED)
CHUNK = 16  # steps over which gradients flow back through a memory
Choose = Callable[[Any], Sequence[Level]]  # called with a curriculum.TrainingProgress
CODE = {  # settings that take the user's own code; run.json stores its names
    "levels": "must be a function that takes the progress and returns a list of levels",
    "loss": "must be a function that takes a batch and returns a tensor, or a tensor and a dict of figures",
    "networks": "must be a subclass of outlast.training.policies.policy.Networks",
}
TEACHERS = tuple(name for name in NAMED if name not in ("random", "noop"))  # teachers for imitation
IMITATED = 1_500_000  # agent-steps of imitation, by default


@dataclass(frozen=True)
class Anneal:
    """A number of the game that changes linearly over the first agent-steps of a run and then keeps its last value.

    Attributes:
        name: Name of the number in Scenario.replace.
        first: Value at the beginning.
        last: Value at the end.
        steps: Agent-steps that the change takes; 0: the length of the run.
    """

    name: str
    first: float
    last: float
    steps: int = 0

    def __str__(self) -> str:
        return f"{self.name}={self.first!r}:{self.last!r}@{self.steps}"

    def value(self, done: int, scenario: Scenario) -> float:
        """Return the value after `done` agent-steps, rounded if the scenario has an integer there."""
        share = min(1.0, done / max(1, self.steps))  # a run of 0 steps stays at its first value
        value = (1 - share) * self.first + share * self.last
        return round(value) if type(_current(scenario, self.name)) is int else value

    def check(self, scenario: Scenario) -> None:
        """Raise NumberError or TrainingError if the number cannot change in the scenario."""
        if isinstance(now := _current(scenario, self.name), (bool, str, tuple)):
            raise TrainingError(f"{self.name} is {now!r}: only a single number can be annealed; change it by --set")
        if "_".join(scenario.find_number(self.name)) in dict(scenario.varied):
            raise TrainingError(
                f"{self.name} varies from world to world; annealing sets one value for all: use one of the two"
            )
        for end in (self.first, self.last):
            scenario.replace(**{self.name: int(end) if type(now) is int and end == int(end) else end})


def _current(scenario: Scenario, name: str) -> object:
    """Return the value of a number in the scenario. Raises NumberError if it has no such number."""
    return scenario.numbers()["_".join(scenario.find_number(name))]


def parse_anneal(texts: Iterable[str]) -> tuple[Anneal, ...]:
    """Parse texts like "rewards_kill=10:0@5e6". Raises TrainingError, also if a number occurs twice."""
    found: dict[str, Anneal] = {}
    for text in texts:
        if not (match := re.fullmatch(r"(\w+)=([^:@]+):([^:@]+)(?:@([^:@]+))?", text.strip())):
            raise TrainingError(f"--anneal {text}: {NEEDED}")
        name, *ends, steps = match.groups()
        if name in found:
            raise TrainingError(f"--anneal {text}: {name} is given twice")
        try:
            first, last, length = float(ends[0]), float(ends[1]), float(steps or 0)
        except ValueError:
            raise TrainingError(f"--anneal {text}: {NEEDED}") from None
        if not math.isfinite(first + last + length) or length != int(length) or (steps and length < 1):
            raise TrainingError(f"--anneal {text}: numbers must be finite, and STEPS an integer of at least 1")
        found[name] = Anneal(name, first, last, int(length))
    return tuple(found.values())


def parse_warm_start(text: str) -> tuple[str, int]:
    """Return the teacher, a name or a path, and the agent-steps of imitation; 0: its weights are taken."""
    no_length = ":" not in text or is_saved(text) or Path(text).is_dir()  # such as C:/runs
    name, _, length = (text, "", "") if no_length else text.rpartition(":")
    if text and name not in TEACHERS and not is_saved(policy_file(name, TEACHERS)):
        known = f"{', '.join(TEACHERS)} or a saved policy ({SAVED_AS})"
        raise TrainingError(f"warm start {text}: must be {known}, optionally with :STEPS")
    try:
        steps = float(length or (IMITATED if name in TEACHERS else 0))
    except ValueError:
        steps = math.nan
    if steps % 1 != 0 or (length and steps < 1):
        raise TrainingError(f"warm start {text}: the agent-steps must be an integer >= 1, as in {name}:2e6")
    return name, int(steps)


def _settings(given: Any) -> dict[str, Any]:
    if isinstance(given, list):
        return parse_hyperparameters(given)
    try:
        return dict(given or {})
    except (TypeError, ValueError):
        raise TrainingError(
            f"settings = {given!r:.200}: must be numbers of PPO by name, as in {{'gamma': 0.995}}"
        ) from None


def _annealed(given: Any) -> tuple[Anneal, ...]:
    texts: Any = [given] if isinstance(given, str) else given
    if not isinstance(texts, Sequence) or not all(isinstance(each, str | Anneal) for each in texts):
        raise TrainingError(
            f"anneal = {given!r:.200}: must be a text or a list of texts, as in 'rewards_kill=10:0@5e6'; () for none"
        )
    return tuple(texts) if all(isinstance(each, Anneal) for each in texts) else parse_anneal(texts)


def _start(given: Any) -> str:
    start = text_of(given) if isinstance(given, os.PathLike) else given
    if isinstance(start, str):
        return start
    needed = f"must be a name, such as '{TEACHERS[0]}', or the path of a saved policy; '' for none"
    raise TrainingError(f"warm_start = {start!r:.200}: {needed}")


def _weights(given: Any) -> dict[str, float]:
    if isinstance(given, str):
        return parse_lineup(given, OPPONENTS)
    needed = "must be names or paths of saved policies, with weights, as in {'self': 1, 'runs/a': 1}"
    if not isinstance(given, Mapping):
        raise TrainingError(f"opponents = {given!r:.200}: {needed}")
    for name in given:
        if not isinstance(name, str | os.PathLike):
            raise TrainingError(f"opponents: {name!r:.200} is not an opponent: they {needed}")
    return {str(name): weight for name, weight in checked_entries(given.items(), OPPONENTS)}


# Settings that users give in several forms; the command line gives texts.
PARSERS: dict[str, Callable[[Any], Any]] = {
    "settings": _settings,
    "opponents": _weights,
    "warm_start": _start,
    "anneal": _annealed,
}


def name_of(code: Any) -> str:
    """Return the name of a function or class with its module; of another object, the name of its class."""
    return full_name(code if hasattr(code, "__qualname__") else type(code))


@dataclass(frozen=True)
class TrainingConfig:
    """Settings of a training run: arguments of `outlast.train` by name, checked, and parsed if they are texts.

    Equal configs give equal results, for any values of `processes` and `every`. Every option is declared here only, and
    described in the docstring of `outlast.train`, or here if that has more than the help of its flag;
    `python -m tests.options --write` copies declarations into the signature.
    """

    described: ClassVar[Any] = None  # outlast.train, once that is imported
    scenario: Scenario
    preset: str = option(FAST, LEARNED, choices=ChoicesBySide(PRESETS))
    steps: int = option(10_000_000, LEARNED, least=0)
    seed: int = option(0, LEARNED, least=0)
    worlds: int = option(0, ROLLOUT, least=0)
    rollout: int = option(0, ROLLOUT, least=0)
    dead: str = option("keep", LEARNED, choices=DEAD)
    device: str = option(
        "cpu", MACHINE, "PyTorch's device on which policies are updated, such as cuda; they always play on the CPU"
    )
    threads: int = option(0, MACHINE, least=0)
    every: int = option(1_000_000, OUTPUT, least=1)
    settings: dict[str, Any] = option(
        dict,
        LEARNED,
        "numbers of PPO that differ from the preset's, as in gamma=0.999, or with policies=side for one side, as in "
        f"seeker:ent_coef=0.01: {', '.join(KINDS)}",
        python='As a dict: {"gamma": 0.999}.',
        flag="--ppo",
        metavar="NAME=VALUE",
        many=True,
        takes="Mapping[str, Any] | None = None",
    )
    policies: str = option("shared", LEARNED, choices=("shared", "side", "agent"))
    opponents: dict[str, float] = option(
        lambda: {SELF: 1.0},
        OPPOSED,
        "the opponents of the agents, with weights, as in self:0.5,past:0.5. self is the policy itself, past one of "
        f"its earlier selves; also {', '.join(OPPONENTS[2:])}, {SAVED_AS} (default self)",
        python='Also as a dict: {"self": 0.5, "past": 0.5}.',
        metavar="NAME:WEIGHT,...",
        takes="str | Mapping[str | os.PathLike[str], float] = SELF",
    )
    prioritised: bool = option(False, OPPOSED)
    snapshots: int = option(10, OPPOSED, least=1)
    processes: int = option(1, MACHINE, metavar="N", least=1)
    memory: int = option(0, LEARNED, metavar="N", least=0, most=4096)
    critic: str = option("own", LEARNED, choices=("own", "state"))
    warm_start: str = option(
        "",
        LEARNED,
        f"begin by imitating {', '.join(TEACHERS)} (for STEPS agent-steps, by default 1.5e6) or FILE.zip:STEPS, or "
        "begin with the weights of FILE.zip; the folder of a run stands for its newest file (default: no such start)",
        metavar="NAME[:STEPS]",
        takes='str | os.PathLike[str] = ""',
    )
    anneal: tuple[Anneal, ...] = option(
        (),
        LEARNED,
        python="As a text, or a list of several.",
        metavar="NUMBER=FROM:TO[@STEPS]",
        many=True,
        takes="str | Sequence[str] = ()",
    )
    levels: Choose | None = option(None, "")
    loss: Callable[[Any], Any] | None = option(None, "")
    networks: Any = option(None, "", takes="type | Mapping[str, type] | None = None")

    def __post_init__(self) -> None:
        """Check all values. Raises ScenarioError for an unknown preset, TrainingError for other impossible values."""
        preset(self.preset)
        for name, parse in PARSERS.items():
            object.__setattr__(self, name, parse(getattr(self, name)))
        integers = {
            name: as_whole(getattr(self, name)) for name, each in options_of(self).items() if each.least is not None
        }
        try:
            check_options(self, vars(self) | integers)
        except ValueError as error:
            raise TrainingError(str(error)) from None
        for name, value in integers.items():
            object.__setattr__(self, name, int(value))
        _, (teacher, _), _ = self.numbers, self.teacher, self.size  # reading these checks them
        if (file := policy_file(teacher, TEACHERS)) != teacher:  # the run records the name of the file
            object.__setattr__(self, "warm_start", self.warm_start.replace(teacher, file, 1))
        for each in self.anneal:
            each.check(self.scenario)
        for problem in self._problems():
            raise TrainingError(problem)
        object.__setattr__(self, "anneal", tuple(replace(a, steps=a.steps or self.steps) for a in self.anneal))

    def _problems(self) -> Iterator[str]:
        """Yield why values do not go together."""
        worlds, rollout = self.size
        kinds = (kind for module in self.scenario.modules for kind in module.archetypes())
        if self.dead == "drop" and any(isinstance(part, Return) for kind in kinds for part in kind.parts):
            yield "dead = 'drop': agents respawn here, so a death does not end a return; take 'keep'"
        if self.prioritised and PAST not in self.opponents and len(self.opponents.keys() - {SELF}) < 2:
            yield "prioritised needs several opponents to choose among: name some, such as self:1,past:1"
        if self.snapshots != default_of(TrainingConfig, "snapshots") and PAST not in self.opponents:
            yield "snapshots have no effect without past selves: name some opponents, such as past:0.5"
        trained, asked = preset(self.preset).cameras, cameras_mode(self.scenario)
        if asked not in (None, MASKED, trained):
            others = " or ".join(name for name, each in PRESETS.items() if each.cameras == asked)
            cure = f"leave it as it was{others and f', or take preset {others}'}"
            yield f"cameras_mode = {asked}: preset {self.preset} trains with {trained}; {cure}"
        if self.memory and rollout // worlds % CHUNK:
            fitting = worlds * CHUNK * max(1, round(rollout / worlds / CHUNK))
            needed = f"with a memory, it must be a multiple of {CHUNK}, such as --rollout {fitting}"
            yield f"a rollout of {rollout} steps has {rollout // worlds} of each world: {needed}"
        for name, needed in CODE.items():
            given = getattr(self, name)
            for code in given.values() if name == "networks" and isinstance(given, Mapping) else [given]:
                shared = name == "networks" or (name == "loss" and self.processes > 1)
                if code is not None and not callable(code):
                    yield f"{name} = {code!r:.200}: {needed}"
                elif code is not None and name == "levels" and self.processes > 1:
                    yield "the levels function runs in one process only: leave out processes"
                elif code is not None and shared and imported_code(name_of(code)) is not code:
                    why = "other processes and readers of saved files must import it"
                    cure = "define it by its name at the top of a module"
                    yield f"{name} = {name_of(code)} cannot be imported, but {why}: {cure}"
        if self.policies == "shared" and (isinstance(self.networks, Mapping) or len(self.numbers_by_policy) > 1):
            needed = "need policies of their own: take policies = 'side'"
            yield f"a preset, networks or numbers of PPO of one side {needed}"
        decisive = [name for name in ("agents_count", "teams_sizes") if name in dict(self.scenario.varied)]
        if self.policies == "side" and "teams" in self.scenario and decisive:
            cure = "take 'shared' or 'agent'"
            yield f"policies = 'side': {decisive[0]} varies, and the sides of agents with it; {cure}"
        if self.processes > worlds:
            yield f"processes = {self.processes}: must be from 1 to {worlds}, the number of worlds"

    def check_teacher(self) -> None:
        """Raise TrainingError if a run cannot begin by imitating the teacher; a checkpoint can still be resumed."""
        name, imitated = self.teacher
        if imitated and is_saved(name) and self.processes > 1:
            raise TrainingError(f"{name} draws in sequence: imitate it with one process, then resume with several")

    def folder_name(self, *marks: str) -> str:
        """Return the usual name of the run's folder. marks: Differences from other runs that the game's name lacks."""
        return "-".join((self.scenario.file_name, *map(as_filename, (*marks, self.preset)), str(self.seed)))

    def header(self) -> Header:
        """Return the part of run.json that determines the results."""
        worlds, rollout = self.size
        kept = {key: value for key, value in vars(self).items() if key not in ("scenario", "every", *HOW)}
        for name in CODE:  # of networks by side, "seeker:mygame.Small,hider:mygame.Large"
            code = kept[name]
            by_side = isinstance(code, Mapping) and ",".join(f"{k}:{name_of(v)}" for k, v in code.items())
            kept[name] = code and (by_side or name_of(code))
        opponents = ",".join(f"{name}:{weight:g}" for name, weight in self.opponents.items())
        kept |= {"worlds": worlds, "rollout": rollout, "opponents": opponents}
        kept["anneal"] = ",".join(map(str, self.anneal))
        if not any(each.anneal_lr for each in self.numbers_by_policy.values()):  # such a run may be extended
            del kept["steps"]
        return {"plan": kept, "scenario": fingerprint(self.scenario), "modules": classes(self.scenario)}

    @property
    def numbers(self) -> Hyperparameters:
        """The numbers of PPO of policies without numbers of their own."""
        return self.numbers_by_policy[""]

    @property
    def numbers_by_policy(self) -> dict[str, Hyperparameters]:
        """The numbers of PPO by policy, see Hyperparameters.by_policy. Raises TrainingError if one is not possible."""
        return preset(self.preset).numbers_by_policy(self.settings)

    @property
    def teacher(self) -> tuple[str, int]:
        """Return the teacher, and the agent-steps of imitation; see parse_warm_start. Raises TrainingError."""
        return parse_warm_start(self.warm_start)

    @property
    def size(self) -> tuple[int, int]:
        """Return the number of worlds, and the environment steps of a rollout."""
        return preset(self.preset).size(self.agents, self.worlds, self.rollout)

    @property
    def agents(self) -> int:
        """Agents of a world; the largest number where it varies."""
        varied = dict(self.scenario.varied).get("agents_count")  # making worlds without agents is an error
        return int(varied.extremes()[1] if varied else self.scenario.numbers().get("agents_count", 1))

    @property
    def each(self) -> int:
        """Agent-steps of a rollout, including those of opponents."""
        return self.size[1] * self.agents

    @property
    def total(self) -> int:
        """The agent-steps at the end: rollouts are always collected completely."""
        return -(-self.steps // self.each) * self.each

    @property
    def workload(self) -> str:
        """The agent-steps of the run and of its rollouts, in words."""
        worlds, rollout = self.size
        sizes = f"({worlds:,} worlds x {rollout // worlds:,} steps x {self.agents:,} agents)"
        if self.steps <= self.each:
            return f"{self.steps:,} agent-steps, rounded up to one rollout of {self.each:,} {sizes}"
        return f"{self.steps:,} agent-steps in {self.total // self.each:,} rollouts of {self.each:,} {sizes}"


@dataclass(frozen=True)
class RunOptions:
    """Options of a run that do not change what it trains: further arguments of `outlast.train`."""

    described: ClassVar[Any] = None  # outlast.train, once that is imported
    folder: str | Path | None = option(None, OUTPUT, flag="--out")
    resume: bool = option(False, OUTPUT)
    film: bool = option(False, OUTPUT)
    quiet: bool = option(False, OUTPUT)
    cluster: str | None = option(None, MACHINE, python='"" stands for no ADDRESS.', flag="--ray", metavar="ADDRESS")
    callbacks: Sequence[Any] = option((), "")


@dataclass(frozen=True)
class EvaluationOptions:
    """Options of `outlast.evaluate`."""

    episodes: int = option(
        200, PLAYED, "episodes of each pairing, rounded up so that all worlds play the same number", least=1
    )
    worlds: int = option(64, PLAYED, "worlds that play at once", least=1)
    seed: int = option(0, PLAYED, "the same seed gives the same numbers", least=0, most=2**64 - 1)
    threads: int = option(1, MACHINE, "threads that share the worlds, with the same results", least=1)
    out: str | Path | None = option(
        None, OUTPUT, "write the tables to this folder, as CSV and JSON, after each pairing", metavar="FOLDER"
    )
    film: bool = option(
        False, OUTPUT, "write a film and a page of a typical episode of each pairing beside the tables, too"
    )
    quiet: bool = option(False, OUTPUT, "show no progress bar")
