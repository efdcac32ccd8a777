"""An entry: an agent with a seed in a task. It is trained, chosen by validation, tested, and gets best responses.

Every part can be stopped at any time and continued: files in the folder are always complete.
"""

import itertools
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs.kernels.errors import OutlastError
from outlast.envs.errors import ActionError
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import checkpoints, is_saved, steps_of
from outlast.envs.storage.outputs import FolderLock

from ..arena.players import Contender
from ..base import curves, policy_file
from ..base.config import FAST, IMITATED, OPPONENTS, TrainingConfig, parse_warm_start
from ..base.config import SELF as OWN
from ..base.errors import TrainingError
from ..base.files import write_files
from ..base.presets import preset
from ..policies.player import weights_of
from ..runs.run import TrainingRun
from .games import SUFFIX, digest, play
from .manifest import Agent, Manifest
from .result import AGENT, KINDS, NAME, NUMBERS, SELF, Content, Pairing, is_count, made, read, share, write_json
from .situations import passed
from .suite import suite
from .tasks import PROTOCOL, Task, check_training_seed

RATE, SLOW = 120_000, 5_000  # agent-steps a second on one core, of preset fast and of all others
TRAINING, RESPONDING = "training", "responding-"  # folders of runs; of best responses, with their kind
STEPS = "steps"
Progress = Callable[[int, str], None]  # work done, in agent-steps of training; and a description of the current work


@dataclass(frozen=True)
class Entry:
    """An agent with a seed in a task: what is planned, and its result in the folder RESULTS/AGENT/TASK/SEED.

    threads: Threads of training; 0: the default of `outlast.train`.
    """

    manifest: Manifest
    name: str
    task: Task
    seed: int
    threads: int = 0

    def __str__(self) -> str:
        return f"{self.name} {self.task.name} {self.seed}"

    @property
    def agent(self) -> Agent:
        """The agent."""
        return self.manifest.agents[self.name]

    @property
    def folder(self) -> Path:
        """The folder of its result, policies and matches."""
        return self.manifest.folder / self.name / self.task.name / str(self.seed)

    @property
    def first(self) -> bool:
        """Return whether its seed is the first one, which alone has best responses and is tried in situations."""
        return bool(self.seed == self.manifest.content["seeds"][0])

    @property
    def candidates(self) -> int:
        """The number of checkpoints from which the validation chooses."""
        return int(self.manifest.content["checkpoints"]) if self.agent.trained else 1

    @property
    def responses(self) -> list[str]:
        """The planned best responses, "scratch 5000000"; functions have none."""
        steps = self.manifest.content["responses"] if self.first and not self.agent.function else []
        return [f"{kind} {each}" for kind in KINDS for each in steps]

    @cached_property
    def planned(self) -> list[Pairing]:
        """All matches: validations, tests against itself and the suite, also with mates, and against other agents."""
        known, task, trained = suite(self.task), self.task, self.task.tests[0].name
        against = known.validators if self.candidates > 1 else []
        matches = [Pairing(task.validation.name, name, candidate=k) for k in range(self.candidates) for name in against]
        matches += [Pairing(game.name, name) for game in task.tests for name in (SELF, *known.members)]
        mates = itertools.product(known.mates, known.mates) if task.mates else ()
        matches += [Pairing(trained, name, mate) for mate, name in mates]
        agents = [AGENT + other for one, other in self.manifest.content["pairs"] if one == self.name]
        return [*matches, *(Pairing(trained, name) for name in (*self.responses, *agents))]

    def games(self, pairing: Pairing) -> int:
        """Return the number of games of a match: of a validation, a tenth of a test's, and even."""
        games = int(self.manifest.content["games"])
        return games if pairing.candidate < 0 else max(2, games // 20 * 2)

    @cached_property
    def content(self) -> Content:
        """The content of its result.json; one without any work if there is none. Raises TrainingError."""
        path, named = self.folder / NAME, {"agent": self.name, "task": self.task.name, "seed": self.seed}
        named["manifest"] = self.manifest.digest
        if not path.exists():
            work: Content = {"candidates": [], "policy": None, "responses": {}, "matches": [], "situations": None}
            return {"version": PROTOCOL, "made": made(), **named, **work}
        found = read(path)
        for key, own in named.items():
            if found[key] != own:
                wrong = f"{path} has {key} {found[key]!r:.80}, not {own!r}"
                raise TrainingError(f"{wrong}: it belongs to another manifest.json; choose another folder")
        return found

    @property
    def matches(self) -> dict[Pairing, Content]:
        """The matches that were played."""
        return {Pairing.of(match): match for match in self.content["matches"]}

    def policy(self, candidate: int = -1) -> Path:
        """Return the file of its policy, or of a candidate; it does not exist for a function."""
        return self.folder / f"{'policy' if candidate < 0 else f'candidate-{candidate}'}{policy_file.SUFFIX}"

    def response(self, name: str) -> Path:
        """Return the file of a best response."""
        return self.folder / f"response-{name.replace(' ', '-')}{policy_file.SUFFIX}"

    def write(self) -> None:
        """Write its result, completely or not at all. Raises TrainingError."""
        write_json(self.folder / NAME, self.content)

    def check_planned(self) -> None:
        """Raise TrainingError for matches that were not planned: nobody may choose among several plans afterwards."""
        if self.content["policy"] is None and any(pairing.candidate < 0 for pairing in self.matches):
            raise TrainingError(f"{self} has tests, but no policy that was chosen for them")
        responses = (name for name in self.content["responses"] if name not in self.responses)
        if more := [*responses, *(pairing for pairing in self.matches if pairing not in self.planned)]:
            raise TrainingError(f"{self}: {more[0]} is not in the manifest")
        for pairing, match in self.matches.items():
            if (games := sum(match[name] for name in NUMBERS)) != self.games(pairing):
                raise TrainingError(f"{self}: {pairing} has {games} games, and {self.games(pairing)} are planned")

    def chosen(self) -> int:
        """Return the number of the candidate that won most games in the validation; the last of equal ones."""
        shares = np.zeros(len(self.content["candidates"]))
        for pairing, match in self.matches.items():
            if 0 <= pairing.candidate < len(shares):
                shares[pairing.candidate] += share(match)
        return int(len(shares) - 1 - shares[::-1].argmax())

    def contender(self, candidate: int = -1) -> Contender:
        """Return its policy, or a candidate. Raises TrainingError, ScenarioError."""
        if self.agent.function:
            return Contender(self.name, self.agent.place(self.task.name, self.seed), seed=self.seed)
        return Contender(self.name, str(self.policy(candidate)))

    def rival(self, name: str) -> "Entry":
        """Return the entry of another agent with the same seed. name: Its name as an opponent."""
        return replace(self, name=name.removeprefix(AGENT))

    def others(self, pairing: Pairing, rival: Callable[["Entry"], Contender | None]) -> Iterator[Contender | None]:
        """Yield the other policies of a match, in the order of `games.play`. rival: Returns that of another entry."""
        members = suite(self.task).members
        for name in (pairing.against, pairing.mate):
            if name in members:
                yield members[name].contender()
            elif name.startswith(AGENT):
                yield rival(self.rival(name))
            elif name != SELF:
                yield Contender(name, str(self.response(name)))

    @cached_property
    def config(self) -> TrainingConfig:
        """The config of its training. Raises TrainingError."""
        own = self.manifest.content
        return self.agent.config(self.task, self.seed, own["budget"], own["checkpoints"], self.threads)

    @property
    def shares(self) -> list[int]:
        """The agent-steps after which its training gives each candidate."""
        return [min(self.config.steps, self.config.every * (k + 1)) for k in range(self.candidates)]

    def work(self) -> tuple[int, int, float]:
        """Return the work that is done, by the files in the folder, all work, and the seconds of all on one usual core.

        It is counted in agent-steps of training; for a match, in as many as take about the same time.
        """
        training = self.config.total if self.agent.trained else 0
        runs = {TRAINING: training} | {RESPONDING + kind: int(steps) for kind, steps in map(str.split, self.responses)}
        each = 800 * int(self.task.scenario.numbers()["agents_count"])
        games = {pairing.file: each * self.games(pairing) for pairing in self.planned}
        done = sum(curves.last_step(self.folder / name / curves.LOG) for name in runs)
        done += sum(games.get(path.name, 0) for path in self.folder.glob(f"*{SUFFIX}"))
        rest = sum((*runs.values(), *games.values())) - training
        return done, training + rest, training / (RATE if self.agent.source == FAST else SLOW) + rest / RATE


def entries_of(manifest: Manifest, only: str = "", threads: int = 0) -> list[Entry]:
    """Return the entries whose names begin with these words, "fast ffa_2-v2 0". Raises TrainingError: none do."""
    named = itertools.product(manifest.agents, manifest.tasks, manifest.content["seeds"])
    every = [Entry(manifest, agent, task, seed, threads) for agent, task, seed in named]
    found = [entry for entry in every if f"{entry} ".startswith(f"{only.strip()} ".lstrip())]
    if not found:
        raise TrainingError(f"no entry begins with the words {only!r}: they are {', '.join(map(str, every))}")
    return found


def described(path: Path, task: Task) -> Content:
    """Describe a policy that plays a task. Raises TrainingError: it is none, or its seed is one that evaluation uses.

    "of_task": whether all of its training was in the task's game, without chosen levels, numbers that changed, or
    weights or actions of a saved policy. "met": the members of the suite that it met, or that taught it.
    """
    header = policy_file.read_header(path, (STEPS, "scenario", "preset"))
    plan = header.get("plan", {})
    if not is_count(seed := plan.get("seed", 0)):
        raise TrainingError(f"{path} says that it was trained with seed {seed!r:.40}: an integer is needed")
    check_training_seed(seed)
    teacher, _ = parse_warm_start(plan.get("warm_start", ""))
    changed = plan.get("levels") or plan.get("anneal") or is_saved(teacher)
    of_task = not changed and not preset(header["preset"]).difference(header["scenario"], task.scenario)
    known = {Path(name).stem for name in (*opponents_in(plan), teacher)}
    met = [name for name in suite(task).members if name in known]
    return {"digest": digest(path), STEPS: header[STEPS], "of_task": of_task, "met": met}


def opponents_in(plan: Content) -> dict[str, float]:
    """Return the opponents in the plan of a training, with their weights."""
    return parse_lineup(plan.get("opponents") or OWN, OPPONENTS)


def response_config(task: Task, seed: int, kind: str, steps: int, policy: Path, threads: int = 0) -> TrainingConfig:
    """Return the config for training a best response to a policy. Raises TrainingError if that is impossible.

    It begins with random weights ("scratch"), or with the policy's own ("self"), which is imitated if its file lacks
    the critic, or its networks or memory are not those of preset fast.
    """
    warm = ""
    if kind == "self":
        header, policies = policy_file.read(policy)
        same = header["preset"] == FAST and not header["memory"] and not header["state"] and not header.get("networks")
        critic = len(policies) == 1 and any(name.startswith(policy_file.CRITIC) for name in policies[0])
        warm = str(policy) if same and critic else f"{policy}:{IMITATED}"
    opponents = {str(policy): 1.0}
    more: dict[str, Any] = {"opponents": opponents, "warm_start": warm, "threads": threads, "every": 5_000_000}
    return TrainingConfig(task.scenario, FAST, steps, seed, **more)


def most_steps(steps: int) -> int:
    """Return the most agent-steps of a training that is planned with `steps`: only whole rollouts are collected."""
    return int(1.01 * steps) + 2**16


@dataclass
class EntryRun:
    """Training of an entry's agent, and its matches; it continues the work in the folder."""

    entry: Entry
    progress: Progress = lambda done, text: None

    def run(self) -> Entry:
        """Do all remaining work. Ctrl-C saves, and is raised. Raises TrainingError."""
        lock = FolderLock(self.entry.folder, "plays this entry", (NAME, f"*{policy_file.SUFFIX}", f"*{SUFFIX}"))
        try:
            lock.acquire()
        except OSError as error:
            raise TrainingError(str(error)) from error
        try:
            entry = self.entry = replace(self.entry)  # another process may have continued it
            self._enter()
            for pairing in entry.planned:
                if pairing.candidate < 0 and entry.content["policy"] is None:
                    write_files({entry.policy(): entry.policy(entry.chosen()).read_bytes()})
                    entry.content["policy"] = entry.content["candidates"][entry.chosen()]
                    entry.write()
                if pairing not in entry.matches:
                    self._play(pairing)
            if entry.first and entry.content["situations"] is None:
                with self._named("situations"):
                    entry.content["situations"] = passed(entry.task.scenario, entry.contender())
                entry.write()
        finally:
            lock.release()
        return entry

    @contextmanager
    def _named(self, what: str) -> Iterator[None]:
        """Name the entry in errors of users' functions, and the line of the function. Raises TrainingError."""
        try:
            yield
        except ActionError as error:
            raise TrainingError(f"{self.entry}, {what}: {error}") from error
        except OutlastError:
            raise
        except Exception as error:
            task, seed, agents = self.entry.task.name, self.entry.seed, self.entry.manifest.agents.values()
            files = {own.file(task, seed).resolve() for own in agents if own.function}
            frames = [own for own in traceback.extract_tb(error.__traceback__) if Path(own.filename).resolve() in files]
            if not frames:
                raise
            where = f"{frames[-1].filename}, line {frames[-1].lineno}"
            raise TrainingError(f"{self.entry}, {what}: {where}: {type(error).__name__}: {error}") from error

    def _enter(self) -> None:
        """Put the candidates into the folder: train them, or copy a policy, which must be the one that played."""
        entry, content, agent = self.entry, self.entry.content, self.entry.agent
        place = entry.task.name, entry.seed
        before, count = (content["policy"], content["candidates"]), len(content["matches"])
        if agent.function:
            content["policy"] = {"digest": digest(agent.file(*place)), STEPS: None, "of_task": False, "met": []}
            if count and content["policy"] != before[0]:
                raise TrainingError(f"{agent.file(*place)} is not the function of {count} matches in {entry.folder}")
        elif agent.trained and not before[1]:
            paths = self._train(entry.config, TRAINING, entry.shares)
            content["candidates"] = [self._keep(path, entry.policy(k)) for k, path in enumerate(paths)]
        elif not agent.trained and not count:
            content["candidates"] = [self._keep(agent.file(*place), entry.policy(0))]
        for k, known in enumerate(content["candidates"]):
            if not (path := entry.policy(k)).exists() or digest(path) != known["digest"]:
                cure = f"put it back, or delete {NAME} beside it to begin anew"
                raise TrainingError(f"{path} is missing, or not the candidate that {NAME} describes: {cure}")
        if (content["policy"], content["candidates"]) != before:
            entry.write()

    def _keep(self, path: Path, kept: Path) -> Content:
        """Copy a policy, of a checkpoint with weights in half precision; return its entry in the result."""
        saved = path.suffix == policy_file.SUFFIX
        write_files({kept: path.read_bytes() if saved else policy_file.content(*weights_of(path))})
        return described(kept, self.entry.task)

    def _train(self, config: TrainingConfig, name: str, after: Sequence[int]) -> list[Path]:
        """Begin or continue a training; return its first checkpoints after so many agent-steps."""
        folder = self.entry.folder / name
        run = TrainingRun(config, folder, resume=folder.exists())
        run.train(lambda run: self.progress(self.entry.work()[0], f"{name}: {run.now}"))
        found = checkpoints(folder)
        return [next(path for path in found if steps_of(path) >= steps) for steps in after]

    def _play(self, pairing: Pairing) -> None:
        """Play a match, for which a best response may have to be trained, and enter it."""
        entry, name, opponent = self.entry, pairing.against, ""
        if name.startswith(AGENT):
            if (policy := entry.rival(name).content["policy"]) is None:
                return  # it has not been run yet
            opponent = policy["digest"]
        elif name in entry.responses and name not in entry.content["responses"]:
            kind, steps = name.split()
            longest = max(entry.manifest.content["responses"])
            config = response_config(entry.task, entry.seed, kind, longest, entry.policy(), entry.threads)
            (path,) = self._train(config, RESPONDING + kind, [int(steps)])
            entry.content["responses"][name] = self._keep(path, entry.response(name))
            entry.write()
        self.progress(entry.work()[0], str(pairing))
        with self._named(str(pairing)):
            policies = [entry.contender(pairing.candidate), *entry.others(pairing, Entry.contender)]
            played = play(entry.task.games[pairing.game], policies, entry.games(pairing))
        moves = played.moves.write(entry.folder / pairing.file)
        figures = played.outcome.pop("figures") if name == SELF else {}
        match = pairing._asdict() | {"opponent": opponent, "moves": moves, "figures": figures}
        entry.content["matches"].append(match | {key: played.outcome[key] for key in NUMBERS})
        entry.write()
