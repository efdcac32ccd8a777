"""manifest.json: all that will be run, compared and called a difference, written before anything is evaluated.

A manifest never changes: every result names its digest, and what is planned but was not run is missing in every table.
"""

import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.rollout.saved import SAVED_AS, is_saved, located, models
from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word

from ..base.config import TrainingConfig
from ..base.errors import TrainingError
from ..base.presets import PRESETS
from .games import digest
from .result import Content, fault, is_count, is_digest, is_finite, is_name, made, read_json, write_json
from .suite import suite
from .tasks import CHECKPOINTS, PROTOCOL, Task, check_training_seed, task_of, track_of

NAME = "manifest.json"
FORMS = f"a preset ({', '.join(PRESETS)}), {SAVED_AS}, or FILE.py:FUNCTION"
OPTIONS = {"settings", "memory", "opponents", "worlds", "rollout"}  # of training, that an agent can have
Pairs = Sequence[tuple[str, ...]]
FORM = {
    "version": PROTOCOL,
    "tasks": {is_word: {"games": {is_word: is_fingerprint}, "suite": is_digest}},
    "agents": {is_name: {"source": is_word, "options": lambda given: given.keys() <= OPTIONS}},
    "seeds": lambda given: isinstance(given, list) and 0 < len({*given}) == len(given) and all(map(is_count, given)),
    "pairs": [lambda given: len(given) == len({*given}) == 2],
    "budget": lambda given: is_count(given) and given > 0,
    "games": lambda given: is_count(given) and 0 < given <= 10_000 and given % 2 == 0,
    "checkpoints": lambda given: is_count(given) and 0 < given <= 100,
    "responses": [is_count],
    "effect": lambda given: is_finite(given) and 0 <= given <= 1,
}


@dataclass(frozen=True)
class Agent:
    """An agent, for all seeds and all tasks.

    name: Name in tables and paths. source: A preset; the folder of a run or a saved policy; or FILE.py:FUNCTION, a
    function (env, seed) that returns a policy (observations) -> actions. {task}, {game} (the task without its version)
    and {seed} are replaced by the values of an entry. options: Options of its training that differ from the preset's:
    opponents, settings, memory.
    """

    name: str
    source: str
    options: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, text: str, options: dict[str, Any]) -> "Agent":
        """Return the agent that a user names: "fast" or "NAME=SOURCE". Raises TrainingError."""
        name, _, source = text.partition("=")
        agent = cls(name, source or name, options)
        if not is_name(name):
            raise TrainingError(f"{name!r} must consist of letters, digits and . _ - +, as in mine={FORMS}")
        saved = is_saved(agent.source) or "/" in agent.source or Path(agent.source).is_dir()
        if not (agent.trained or agent.function or saved):
            raise TrainingError(f"{agent.source}: unknown agent: it must be {FORMS}, as in mine=runs/ffa_2-fast-0")
        if options and not agent.trained:
            given = ", ".join(options)
            raise TrainingError(f"{given} has no effect on {text}, which is trained already: leave it out")
        return agent

    @property
    def trained(self) -> bool:
        """Return whether the benchmark trains it."""
        return self.source in PRESETS

    @property
    def function(self) -> bool:
        """Return whether it is a function of the user's."""
        return not self.trained and re.search(r"\.py:\w+$", self.source) is not None

    def check(self, task: str, seed: int, seeds: int) -> None:
        """Raise TrainingError or UsageError if it lacks a policy for a task and a seed, or has one for all seeds."""
        place = self.place(task, seed)
        if seeds > 1 and not (self.trained or self.function or "{seed}" in self.source):
            cure = "name one --seed, or put {seed} in it"
            raise TrainingError(f"{self.name}={self.source} is one training for all seeds: {cure}")
        if unknown := re.search(r"\{[^{}]*\}", place):
            raise TrainingError(f"{self.source}: {unknown[0]} is not replaced; {{task}}, {{game}} and {{seed}} are")
        if not (self.trained or self.file(task, seed).exists()):
            raise TrainingError(f"{self.name}, {task}, seed {seed}: {place} does not exist")

    def place(self, task: str, seed: int) -> str:
        """Return the source for a task and a seed."""
        game = task.rpartition("-")[0]
        return self.source.replace("{task}", task).replace("{game}", game).replace("{seed}", str(seed))

    def file(self, task: str, seed: int) -> Path:
        """Return the file of a function or a saved policy, the newest of a run. Raises TrainingError, UsageError."""
        text = self.place(task, seed)
        if self.function:
            return Path(text.rpartition(":")[0])
        if text not in models() and not Path(text).exists():
            raise TrainingError(f"{self.name}, {task}, seed {seed}: {text} does not exist; it must be {FORMS}")
        return located(text)

    def config(self, task: Task, seed: int, budget: int, checkpoints: int, threads: int) -> TrainingConfig:
        """Return the config of its training, with a checkpoint after each share of it. Raises TrainingError."""
        more: dict[str, Any] = {"threads": threads, "every": -(-budget // checkpoints)} | self.options
        return TrainingConfig(task.scenario, self.source, budget, seed, **more)


@dataclass(frozen=True)
class Manifest:
    """A plan in the folder of its results.

    folder: The folder, RESULTS. content: The content of manifest.json. digest: SHA-256 of the file.
    """

    folder: Path
    content: Content
    digest: str

    @cached_property
    def agents(self) -> dict[str, Agent]:
        """The agents by name."""
        return {name: Agent(name, own["source"], own["options"]) for name, own in self.content["agents"].items()}

    @cached_property
    def tasks(self) -> list[Task]:
        """The tasks. Raises TrainingError if their games or suites are not those of the manifest."""
        found = [task_of(name) for name in self.content["tasks"]]
        for task, own in zip(found, self.content["tasks"].values(), strict=True):
            for name, game in task.games.items():
                if other := difference(own["games"].get(name), fingerprint(game.scenario)):
                    raise TrainingError(f"the game '{name}' of the manifest differs from that of {task.name} {other}")
            if own["suite"] != suite(task).digest:
                raise TrainingError(f"the suite of the manifest is not that of {task.name}")
        return found

    @property
    def track(self) -> str:
        """The track; empty if its numbers belong to none."""
        seeds = self.content["seeds"]
        usual = self.content["checkpoints"] == CHECKPOINTS and seeds == [*range(len(seeds))]
        return track_of(self.content["budget"], self.content["games"]) if usual else ""


def write(
    folder: Path, tasks: list[Task], agents: list[Agent], seeds: Sequence[int], pairs: Pairs, **numbers: Any
) -> Manifest:
    """Write a manifest. numbers: budget, games, responses and effect.

    Raises TrainingError: names, seeds or options are not possible, or the folder has another manifest already.
    """
    names = [agent.name.lower() for agent in agents]  # some disks do not tell Fast from fast
    for what, given in (("task", [task.name for task in tasks]), ("agent", names), ("seed", seeds)):
        if not given or len(set(given)) < len(given):
            raise TrainingError(f"name each {what} once, and at least one")
    for pair in pairs:
        if len(set(pair)) < 2 or not {*pair} <= {agent.name for agent in agents}:
            raise TrainingError(f"{' and '.join(pair)}: a pair needs two of the agents {', '.join(names)}")
    for agent, task, seed in itertools.product(agents, tasks, seeds):
        check_training_seed(seed)
        agent.check(task.name, seed, len(seeds))
        if agent.trained:
            agent.config(task, seed, numbers["budget"], CHECKPOINTS, 1)
    games = {task.name: {name: fingerprint(game.scenario) for name, game in task.games.items()} for task in tasks}
    content = {
        "version": PROTOCOL,
        "tasks": {task.name: {"games": games[task.name], "suite": suite(task).digest} for task in tasks},
        "agents": {agent.name: {"source": agent.source, "options": agent.options} for agent in agents},
        "seeds": seeds,
        "pairs": pairs,
        "checkpoints": CHECKPOINTS,
        **numbers,
    }
    path, plan = folder / NAME, json.loads(json.dumps(content))
    if wrong := fault(plan, FORM):
        raise TrainingError(f"the plan is not possible: {wrong}")
    if not path.exists():
        write_json(path, plan | {"made": made()})
    elif {key: value for key, value in read(folder).content.items() if key != "made"} != plan:
        raise TrainingError(f"{path} exists, and a plan never changes: choose another folder")
    return read(folder)


def read(folder: Path) -> Manifest:
    """Read the manifest in a folder. Raises TrainingError."""
    path = folder / NAME
    if not path.is_file():
        raise TrainingError(f"{folder} does not hold {NAME}: make one by `outlast benchmark plan`")
    content = read_json(path, FORM)
    if unknown := [name for pair in content["pairs"] for name in pair if name not in content["agents"]]:
        raise TrainingError(f"{path} is not a result of the benchmark: its pairs name {unknown[0]!r:.80}")
    return Manifest(folder, content, digest(path))
