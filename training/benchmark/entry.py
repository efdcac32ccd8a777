"""An entry: an agent with a seed in a task. It is trained, chosen by validation, tested, and gets best responses.

Every part can be stopped at any time and continued: files in the folder are always complete.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from outlast.envs.errors import ActionError
from outlast.envs.rollout.saved import checkpoints
from outlast.envs.storage.folder_lock import FolderLock

from ..arena.players import Contender
from ..base import log_file, policy_file
from ..base.config import FAST, TrainingConfig
from ..base.errors import TrainingError
from ..base.files import write_files
from ..policies.player import weights_of
from ..runs.run import TrainingRun
from .agents import Agent, Made
from .games import SUFFIX, digest, play
from .manifest import Manifest
from .policy_facts import STEPS, agent_config, described, response_config
from .result import AGENT, NAME, NUMBERS, SELF, Content, Pairing, Result, share
from .situations import passed
from .suite import suite
from .tasks import Task, TaskGame

RATES = {"fast": 120_000, "original": 5_000, "paper": 5_000, "scaled": 5_000}  # agent-steps a second on one core
TRAINING, RESPONDING = "training", "responding"  # folders of runs
Progress = Callable[[int, str], None]  # work done, in agent-steps of training; and a description of the current work


@dataclass(frozen=True)
class Entry:
    """The work for an agent with a seed in a task.

    threads: Threads of training; 0: the default of `outlast.train`.
    """

    manifest: Manifest
    name: str
    task: Task
    seed: int
    threads: int = 0

    @property
    def agent(self) -> Agent:
        """The agent."""
        return self.manifest.agents[self.name]

    def __str__(self) -> str:
        return f"{self.name} {self.task.name} {self.seed}"

    @property
    def folder(self) -> Path:
        """The folder of its result."""
        return self.manifest.folder_of(self.name, self.task, self.seed)

    def config(self) -> TrainingConfig:
        """Return the config of its training. Raises TrainingError."""
        content = self.manifest.content
        return agent_config(self.task, self.agent, self.seed, content["budget"], content["checkpoints"], self.threads)

    @property
    def planned(self) -> list[Pairing]:
        """All its matches."""
        return self.manifest.planned(self.agent, self.task, self.seed)

    @property
    def first(self) -> bool:
        """Return whether its seed is the first one, which alone is tried in situations."""
        return bool(self.seed == self.manifest.content["seeds"][0])

    @property
    def responses(self) -> dict[str, int]:
        """The longest training of each kind of best response, agent-steps."""
        names = (name.split() for name in self.manifest.responses(self.agent, self.seed))
        return {kind: max(self.manifest.content["responses"]) for kind, _ in names}

    @property
    def training(self) -> int:
        """The agent-steps of its training; 0 for an agent that exists."""
        return self.config().total if self.agent.trained else 0

    @property
    def work(self) -> int:
        """All the work, in agent-steps of training: of trainings, and for matches as many as take the same time."""
        return self.training + sum(self.responses.values()) + sum(map(self.match_work, self.planned))

    def match_work(self, pairing: Pairing) -> int:
        """Return the work of a match: the agent-steps of training that take about the same time."""
        return 800 * self.manifest.games(pairing) * int(self.task.scenario.numbers()["agents_count"])

    def done(self) -> int:
        """Return the part of `work` that is done, judging by the files in the folder."""
        names = (TRAINING, *(f"{RESPONDING}-{kind}" for kind in self.responses))
        logs = sum(log_file.last_step(self.folder / name / log_file.NAME) for name in names)
        there = {path.name for path in self.folder.glob(f"*{SUFFIX}")}
        return logs + sum(self.match_work(pairing) for pairing in self.planned if pairing.file in there)

    def seconds(self) -> float:
        """Return the estimated seconds on one core of a machine like that of docs/performance.md."""
        rate = RATES.get(self.agent.source, RATES[FAST])
        return self.training / rate + (self.work - self.training) / RATES[FAST]


def entries_of(manifest: Manifest, only: str = "", threads: int = 0) -> list[Entry]:
    """Return the entries of a manifest, or those whose names begin with the words in `only`: "fast ffa_2-v2 0".

    Raises TrainingError: there are none.
    """
    every = [Entry(manifest, agent, task, seed, threads) for agent, task, seed in manifest.entries()]
    chosen = [entry for entry in every if f"{entry} ".startswith(f"{only.strip()} ".lstrip())]
    if not chosen:
        raise TrainingError(f"no entry begins with the words {only!r}: they are {', '.join(map(str, every))}")
    return chosen


def seats(
    result: Result, task: Task, pairing: Pairing, own: Contender | None, rival: Callable[[str], Contender | None]
) -> list[Contender | None]:
    """Return the policies of a match, in the order of `games.play`. Raises TrainingError for unknown names.

    own: The agent. rival: Returns another agent of the manifest by its name, which plays this task with the same seed.
    """

    def named(name: str) -> Contender | None:
        if name in suite(task).members:
            return suite(task).members[name].contender()
        if name.startswith(AGENT):
            return rival(name.removeprefix(AGENT))
        if name not in result.content["responses"]:
            raise TrainingError(f"neither the suite of {task.name} nor the plan has an opponent {name}")
        return Contender(name, str(result.response(name)))

    others = [named(name) for name in (pairing.against, pairing.mate) if name != SELF]
    if pairing.against == SELF and pairing.mate != SELF:
        raise TrainingError(f"{pairing}: an agent does not meet itself with other mates")
    return [own, *others]


def game_of(task: Task, name: str) -> TaskGame:
    """Return a game of a task. Raises TrainingError."""
    found = [game for game in task.games if game.name == name]
    if not found:
        raise TrainingError(f"{task.name} has no game '{name}'")
    return found[0]


def chosen(result: Result) -> int:
    """Return the number of the candidate that won most games in the validation; the last of equal ones."""
    shares = np.zeros(len(result.content["candidates"]))
    for pairing, match in result.matches.items():
        if 0 <= pairing.candidate < len(shares):
            shares[pairing.candidate] += share(match)
    return int(len(shares) - 1 - shares[::-1].argmax())


def _after(paths: Sequence[Path], steps: int) -> Path:
    """Return the first of these checkpoints that has at least `steps` agent-steps."""
    return next(path for path in paths if int(path.stem.rpartition("_")[2]) >= steps)


class EntryRun:
    """Training of an entry's agent, and its matches."""

    def __init__(self, entry: Entry, progress: Progress = lambda done, text: None) -> None:
        """Begin, or continue the work in the folder. Raises TrainingError if the folder holds another entry."""
        self.entry, self.progress = entry, progress
        self.result = self._there()

    def _there(self) -> Result:
        return self.entry.manifest.result(self.entry.name, self.entry.task, self.entry.seed)

    def run(self) -> Result:
        """Do all remaining work. Ctrl-C saves, and is raised. Raises TrainingError."""
        with self._alone():
            self.result = self._there()  # another process may have continued it
            self._enter()
            for pairing in self.entry.planned:
                if pairing.candidate < 0 and self.result.content["policy"] is None:
                    self._choose()
                if pairing not in self.result.matches and self._ready(pairing):
                    self._play(pairing)
            if self.entry.first and self.result.content["situations"] is None:
                self.result.content["situations"] = passed(self.entry.task.scenario, self._agent(-1))
                self.result.write()
        return self.result

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Create the folder and lock it against other processes."""
        folder = self.entry.folder
        lock = FolderLock(folder, "plays this entry", (NAME, f"*{policy_file.SUFFIX}", f"*{SUFFIX}"))
        try:
            lock.acquire()
        except BlockingIOError as error:
            raise TrainingError(str(error)) from None
        except OSError as error:
            raise TrainingError(f"{folder} cannot be a folder: {error.strerror}; choose another folder") from error
        try:
            yield
        finally:
            lock.release()

    def _enter(self) -> None:
        """Put the candidates into the folder: train them, or copy a policy, which must be the one that played."""
        content, agent, count = self.result.content, self.entry.agent, len(self.result.content["matches"])
        before = content["policy"], content["candidates"]
        if agent.function:
            content["policy"] = {"digest": digest(self._made().file), STEPS: None, "of_task": False, "met": []}
            if count and content["policy"] != before[0]:
                raise TrainingError(
                    f"{self._made().file} is not the function of {count} matches in {self.entry.folder}"
                )
        elif not before[1] or not (count or agent.trained):
            paths = self._trained() if agent.trained else [self._saved()]
            content["candidates"] = [self._keep(path, self.result.policy(k)) for k, path in enumerate(paths)]
        else:
            for k, known in enumerate(before[1]):
                path = self.result.policy(k)
                if not path.exists() and not agent.trained:
                    self._keep(self._saved(), path)
                if not path.exists():
                    raise TrainingError(f"{path} is missing: put it back, or delete {NAME} beside it to begin anew")
                if digest(path) != known["digest"]:
                    raise TrainingError(f"{path} is not the candidate that {NAME} beside it describes")
        if (content["policy"], content["candidates"]) != before:
            self.result.write()

    def _choose(self) -> None:
        """Choose the policy, when all candidates are validated."""
        best = chosen(self.result)
        write_files({self.result.policy(): self.result.policy(best).read_bytes()})
        self.result.content["policy"] = self.result.content["candidates"][best]
        self.result.write()

    def _ready(self, pairing: Pairing) -> bool:
        """Return whether the opponent is there: another agent may not have been run yet."""
        name = pairing.against.removeprefix(AGENT)
        return name == pairing.against or self._other(name).content["policy"] is not None

    def _other(self, name: str) -> Result:
        """Return the result of another agent of the manifest."""
        return self.entry.manifest.result(name, self.entry.task, self.entry.seed)

    def _trained(self) -> list[Path]:
        """Train the agent. Return its checkpoints after equal shares of the training."""
        config, count = self.entry.config(), self.entry.manifest.candidates(self.entry.agent)
        every = self._train(config, TRAINING)
        return [_after(every, min(config.steps, config.every * (k + 1))) for k in range(count)]

    def _saved(self) -> Path:
        return self.entry.agent.policy(self.entry.task.name, self.entry.seed)

    def _made(self) -> Made:
        return self.entry.agent.made(self.entry.task.name, self.entry.seed)

    def _keep(self, path: Path, kept: Path) -> Content:
        """Copy a policy, of a checkpoint with weights in half precision; return its entry in the result."""
        saved = path.suffix == policy_file.SUFFIX
        write_files({kept: path.read_bytes() if saved else policy_file.content(*weights_of(path))})
        return described(kept, self.entry.task)

    def _train(self, config: TrainingConfig, name: str) -> list[Path]:
        """Begin or continue a training; return its checkpoints."""
        folder = self.entry.folder / name
        run = TrainingRun(config, folder, resume=folder.exists())
        run.train(lambda run: self.progress(self.entry.done(), f"{name}: {run.now}"))
        return checkpoints(folder)

    def _agent(self, candidate: int) -> Contender:
        if self.entry.agent.function:
            return self._made()
        return Contender(self.entry.name, str(self.result.policy(candidate)))

    def _rival(self, name: str) -> Contender:
        """Return another agent of the manifest."""
        return EntryRun(Entry(self.entry.manifest, name, self.entry.task, self.entry.seed))._agent(-1)

    def _play(self, pairing: Pairing) -> None:
        """Play a match, and enter it."""
        entry, opponent = self.entry, ""
        if pairing.against.startswith(AGENT):
            opponent = self._other(pairing.against.removeprefix(AGENT)).content["policy"]["digest"]
        elif pairing.against in entry.manifest.responses(entry.agent, entry.seed):
            self._respond(pairing.against)
        self.progress(entry.done(), str(pairing))
        policies = seats(self.result, entry.task, pairing, self._agent(pairing.candidate), self._rival)
        try:
            played = play(game_of(entry.task, pairing.game), policies, entry.manifest.games(pairing))
        except ActionError as error:
            raise TrainingError(f"{entry}, {pairing}: {error}") from error
        moves = played.moves.write(entry.folder / pairing.file)
        figures = played.outcome.pop("figures") if pairing.against == SELF else {}
        match = pairing._asdict() | {"opponent": opponent, "moves": moves, "figures": figures}
        self.result.content["matches"].append(match | {name: played.outcome[name] for name in NUMBERS})
        self.result.write()

    def _respond(self, name: str) -> None:
        """Train a best response to the policy, and keep its checkpoint after the agent-steps in its name."""
        if name in self.result.content["responses"]:
            return
        kind, steps = name.split()
        path, longest = self.result.policy(), self.entry.responses[kind]
        config = response_config(self.entry.task, self.entry.seed, kind, longest, path, self.entry.threads)
        every = self._train(config, f"{RESPONDING}-{kind}")
        kept = self._keep(_after(every, int(steps)), self.result.response(name))
        self.result.content["responses"][name] = kept
        self.result.write()
