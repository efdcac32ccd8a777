"""manifest.json: all that will be run, compared and called a difference, written before anything is evaluated.

A manifest never changes: every result names its digest, so results of another plan are refused, and what is planned but
was not run is missing in every table.
"""

import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word

from ..base.errors import TrainingError
from . import result
from .agents import Agent
from .games import digest
from .policy_facts import agent_config
from .result import AGENT, KINDS, SELF, Content, Pairing, Result, is_count, is_digest, is_name, read_json
from .suite import suite
from .tasks import CHECKPOINTS, PROTOCOL, Task, check_training_seed, task_of, track_of

NAME = "manifest.json"
OPTIONS = {"settings", "memory", "opponents", "worlds", "rollout"}  # of training, that an agent can have


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
        return {name: Agent(name, **own) for name, own in self.content["agents"].items()}

    @cached_property
    def tasks(self) -> list[Task]:
        """The tasks, whose games and suites are those of the manifest. Raises TrainingError."""
        return [_checked(name, own) for name, own in self.content["tasks"].items()]

    @property
    def track(self) -> str:
        """The track; empty if its numbers belong to none."""
        seeds = self.content["seeds"]
        usual = self.content["checkpoints"] == CHECKPOINTS and seeds == [*range(len(seeds))]
        return track_of(self.content["budget"], self.content["games"]) if usual else ""

    def entries(self) -> list[tuple[str, Task, int]]:
        """Return the entries: agents, tasks and seeds."""
        return [*itertools.product(self.agents, self.tasks, self.content["seeds"])]

    def folder_of(self, agent: str, task: Task, seed: int) -> Path:
        """Return the folder of an entry."""
        return self.folder / agent / task.name / str(seed)

    def result(self, agent: str, task: Task, seed: int) -> Result:
        """Return the result of an entry, without any work if there is none yet. Raises TrainingError."""
        folder = self.folder_of(agent, task, seed)
        if not (folder / result.NAME).exists():
            return Result(folder, result.begun(self.digest, agent, task.name, seed))
        found = result.read(folder / result.NAME)
        for key, own in (("manifest", self.digest), ("agent", agent), ("task", task.name), ("seed", seed)):
            if found.content[key] != own:
                wrong = f"{folder / result.NAME} has {key} {found.content[key]!r:.80}, not {own!r}"
                raise TrainingError(f"{wrong}: it belongs to another {NAME}; choose another folder")
        return found

    def candidates(self, agent: Agent) -> int:
        """Return the number of checkpoints from which the validation chooses."""
        return int(self.content["checkpoints"]) if agent.trained else 1

    def games(self, pairing: Pairing) -> int:
        """Return the number of games of a match: of a validation, a tenth of a test's, and even."""
        games = int(self.content["games"])
        return games if pairing.candidate < 0 else max(2, games // 20 * 2)

    def validations(self, agent: Agent, task: Task) -> list[Pairing]:
        """Return the matches by which a checkpoint is chosen; none if there is no choice."""
        count = self.candidates(agent)
        names = suite(task).validators if count > 1 else []
        return [Pairing(task.validation.name, name, candidate=k) for k in range(count) for name in names]

    def tests(self, task: Task) -> list[Pairing]:
        """Return the tests of an entry, without those of best responses: against itself and the suite, with mates."""
        known = suite(task)
        tests = [Pairing(game.name, name) for game in task.tests for name in (SELF, *known.members)]
        mates = itertools.product(known.mates, known.mates) if task.mates else ()
        return tests + [Pairing(task.tests[0].name, against, mate) for mate, against in mates]

    def responses(self, agent: Agent, seed: int) -> list[str]:
        """Return the planned best responses to an entry, "scratch 5000000"; functions have none."""
        if agent.function or seed != self.content["seeds"][0]:
            return []
        return [f"{kind} {steps}" for kind in KINDS for steps in self.content["responses"]]

    def opponents(self, agent: str) -> list[str]:
        """Return the names of the agents that an agent is compared with, and plays against."""
        return [other for one, other in self.content["pairs"] if one == agent]

    def planned(self, agent: Agent, task: Task, seed: int) -> list[Pairing]:
        """Return all planned matches of an entry."""
        more = [*self.responses(agent, seed), *(AGENT + other for other in self.opponents(agent.name))]
        last = [Pairing(task.tests[0].name, name) for name in more]
        return [*self.validations(agent, task), *self.tests(task), *last]


def write(
    folder: Path,
    tasks: Sequence[Task],
    agents: Sequence[Agent],
    seeds: Sequence[int],
    pairs: Sequence[tuple[str, str]],
    **numbers: Any,
) -> Manifest:
    """Write a manifest. numbers: budget, games, responses and effect.

    Raises TrainingError: something is named twice, an agent of a pair is unknown, a seed or an option cannot be used;
    the folder has another manifest already, or cannot be written.
    """
    names = [agent.name.lower() for agent in agents]  # some disks do not tell Fast from fast
    for what, given in (("task", [task.name for task in tasks]), ("agent", names), ("seed", [*seeds])):
        if not given or len(set(given)) < len(given):
            raise TrainingError(f"name each {what} once, and at least one")
    for pair in pairs:
        if len(set(pair)) < 2 or not {*pair} <= {agent.name for agent in agents}:
            raise TrainingError(f"{' and '.join(pair)}: a pair needs two of the agents {', '.join(names)}")
    for seed in seeds:
        check_training_seed(seed)
    for agent in agents:
        agent.check_seeds(seeds)
        for task, seed in itertools.product(tasks, seeds):
            agent.check_place(task.name, seed)
            if agent.trained:
                agent_config(task, agent, seed, numbers["budget"], CHECKPOINTS, 1)
    content = {
        "version": PROTOCOL,
        "tasks": {
            task.name: {"games": {game.name: fingerprint(game.scenario) for game in task.games}}
            | {"suite": suite(task).digest}
            for task in tasks
        },
        "agents": {agent.name: {"source": agent.source, "options": agent.options} for agent in agents},
        "seeds": [*seeds],
        "pairs": [[*pair] for pair in pairs],
        "checkpoints": CHECKPOINTS,
        **numbers,
    }
    path, plan = folder / NAME, json.loads(json.dumps(content))
    if fault := _wrong(plan):
        raise TrainingError(f"the plan is not possible: {fault}")
    if not path.exists():
        result.write_json(path, plan | {"made": result.made()})
    elif {key: value for key, value in read(folder).content.items() if key != "made"} != plan:
        raise TrainingError(f"{path} exists, and a plan never changes: choose another folder")
    return read(folder)


def read(folder: Path) -> Manifest:
    """Read the manifest in a folder. Raises TrainingError."""
    path = folder / NAME
    if not path.is_file():
        raise TrainingError(f"{folder} does not hold {NAME}: make one by `outlast benchmark plan`")
    content = read_json(path, _wrong)
    return Manifest(folder, content, digest(path))


def _checked(name: str, own: Content) -> Task:
    """Return a task. Raises TrainingError if its games or its suite are not those of a manifest."""
    task = task_of(name)
    for game in task.games:
        if other := difference(own["games"].get(game.name), fingerprint(game.scenario)):
            raise TrainingError(f"the game '{game.name}' of the manifest differs from that of {name} {other}")
    if own["suite"] != suite(task).digest:
        raise TrainingError(f"the suite of the manifest is not that of {name}")
    return task


def _wrong(content: Content) -> str:
    """Return the fault in the content of a manifest; "" if it is valid. Raises KeyError or similar."""
    valid: dict[str, Callable[[Any], bool]] = {
        "tasks": lambda given: len(given) > 0 and all(map(is_word, given)) and all(map(_is_task, given.values())),
        "agents": lambda given: len(given) > 0 and all(map(is_name, given)) and all(map(_is_agent, given.values())),
        "seeds": lambda given: (
            isinstance(given, list) and 0 < len({*given}) == len(given) and all(map(is_count, given))
        ),
        "pairs": lambda given: all(len(pair) == len({*pair} & {*content["agents"]}) == 2 for pair in given),
        "budget": lambda given: is_count(given) and given > 0,
        "games": lambda given: is_count(given) and 0 < given <= 10_000 and given % 2 == 0,
        "checkpoints": lambda given: is_count(given) and 0 < given <= 100,
        "responses": lambda given: isinstance(given, list) and all(map(is_count, given)),
        "effect": lambda given: type(given) in (int, float) and 0 <= given <= 1,
    }
    return result.wrong_with_parts(content, valid)


def _is_task(given: Any) -> bool:
    games = given["games"]
    return all(map(is_word, games)) and all(map(is_fingerprint, games.values())) and is_digest(given["suite"])


def _is_agent(given: Any) -> bool:
    return given.keys() == {"source", "options"} and is_word(given["source"]) and given["options"].keys() <= OPTIONS
