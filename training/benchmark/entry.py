"""An entry: an agent with a seed in a task. It is trained, plays itself and the suite, and gets a best response.

Every part can be stopped at any time and continued: files in the folder are always complete.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from outlast.envs.errors import ActionError
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import newest
from outlast.envs.storage.folder_lock import FolderLock

from ..arena.players import Contender
from ..base import log_file, policy_file
from ..base.config import FAST, OPPONENTS, TrainingConfig, Workload
from ..base.config import SELF as OWN
from ..base.errors import TrainingError
from ..base.files import write_files
from ..policies.player import weights_of
from ..runs.run import TrainingRun
from . import result
from .agents import FUNCTION, PRESET, Agent
from .matches import digest, play
from .policy_facts import STEPS, described, response_config
from .result import BEST, NAME, POLICY, RESPONSE, SELF, Content, Result
from .suite import suite
from .tasks import Task, TaskGame, check_training_seed, response_steps

RATES = {"fast": 80_000, "original": 5_000, "paper": 5_000, "scaled": 5_000}  # agent-steps a second on one core
TRAINED = "trained"  # the folder of a run
Progress = Callable[[int, str], None]  # work done, in agent-steps of training; and a description of the current work


@dataclass(frozen=True)
class Entry:
    """The work for an agent with a seed in a task.

    threads: Threads of training; 0: the default of `outlast.train`.
    """

    task: Task
    agent: Agent
    seed: int
    budget: int
    games: int
    out: Path
    threads: int = 0

    def __post_init__(self) -> None:
        """Check the seed. Raises TrainingError."""
        check_training_seed(self.seed)

    @property
    def name(self) -> str:
        """The name of the entry in messages."""
        return f"{self.task.name} {self.agent.name}/{self.seed}"

    @property
    def folder(self) -> Path:
        """The folder of its result."""
        return self.out / str(self.budget) / self.task.name / self.agent.name / str(self.seed)

    @property
    def wanted(self) -> list[tuple[TaskGame, str]]:
        """The matches to be played: in every game, against itself and the suite."""
        names = [SELF, *(member.name for member in suite(self.task))]
        return [(game, name) for game in self.task.games for name in names]

    @property
    def responds(self) -> bool:
        """Return whether a best response can be trained, which plays against a saved policy."""
        return self.agent.kind != FUNCTION

    def config(self) -> TrainingConfig:
        """Return the config of the training. Raises TrainingError."""
        options = dict(self.agent.options)
        options["opponents"] = parse_lineup(options.get("opponents", OWN), OPPONENTS)
        return TrainingConfig(
            self.task.scenario, self.agent.source, self.budget, self.seed, threads=self.threads, **options
        )

    @property
    def work(self) -> int:
        """All the work, in agent-steps: of training, and for each match as many as take the same time."""
        trained = Workload.of(self.config()).total if self.agent.kind == PRESET else 0
        response = response_steps(self.budget) if self.responds else 0
        return trained + response + (len(self.wanted) + self.responds) * self.match_work

    @property
    def match_work(self) -> int:
        """The work of a match: the agent-steps of training that take about the same time."""
        return 1000 * self.games * int(self.task.scenario.numbers()["agents_count"])

    def done(self) -> int:
        """Return the part of `work` that is done, judging by the files in the folder."""
        logs = sum(log_file.last_step(self.folder / name / log_file.NAME) for name in (TRAINED, BEST))
        return logs + len(list(self.folder.glob("*.rec"))) * self.match_work


def estimate(entries: Iterable[Entry]) -> float:
    """Return the estimated seconds of one core for all entries, on a machine like that of docs/performance.md."""
    seconds = 0.0
    for entry in entries:
        trained = entry.budget / RATES[entry.agent.source] if entry.agent.kind == PRESET else 0.0
        rest = entry.work - (Workload.of(entry.config()).total if entry.agent.kind == PRESET else 0)
        seconds += trained + rest / RATES[FAST]
    return seconds


class EntryRun:
    """Training of an entry's agent, and its matches."""

    def __init__(self, entry: Entry, progress: Progress = lambda done, text: None) -> None:
        """Begin, or continue the work in the folder. Raises TrainingError if the folder holds another entry."""
        self.entry, self.progress, self.result = entry, progress, self._there(entry)

    @staticmethod
    def _there(entry: Entry) -> Result:
        """Return the result in the folder, or an empty one if it has none."""
        agent = {"agent": entry.agent.name, "source": entry.agent.source, "options": entry.agent.options}
        begun = result.begun(entry.task, **agent, seed=entry.seed, budget=entry.budget, games=entry.games)
        fresh = json.loads(json.dumps(begun))
        there = entry.folder / NAME
        found = result.read(there) if there.exists() else Result(entry.folder, fresh)
        for key in ("task", "agent", "source", "options", "seed", "budget", "games", "fingerprints"):
            if (kept := found.content[key]) != (mine := fresh[key]):
                wrong = f"{there} has {key} {kept!r:.80}, not {mine!r:.80}"
                raise TrainingError(f"{wrong}: choose another name for the agent, or another --out")
        return found

    def run(self) -> Result:
        """Do all remaining work. Ctrl-C saves, and is raised. Raises TrainingError."""
        with self._alone():
            self.result = self._there(self.entry)  # another process may have continued it
            return self._run()

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Create the folder and lock it against other processes."""
        folder = self.entry.folder
        lock = FolderLock(folder, "plays this entry", (NAME, f"*{policy_file.SUFFIX}", "*.rec"))
        try:
            lock.acquire()
        except BlockingIOError as error:
            raise TrainingError(str(error)) from None
        except OSError as error:
            raise TrainingError(f"{folder} cannot be a folder: {error.strerror}; choose another --out") from error
        try:
            yield
        finally:
            lock.release()

    def _run(self) -> Result:
        self._enter()
        own = self._contender()
        for game, name in self.entry.wanted:
            if (game.name, name) not in self.result.against:
                self._play(game, name, own)
        if self.entry.responds:
            self._respond(own)
        return self.result

    def _enter(self) -> None:
        """Put the policy into the folder: train it, or copy an existing one, which must be the one that played."""
        content, kept = self.result.content, self.entry.folder / POLICY
        played = self.result.matches or content["response"]
        replaced = not played and self.entry.agent.kind != PRESET  # copied anew, since it may have changed
        if content["policy"] is None or replaced:
            content["policy"] = self._policy()
            self.result.write()
            return
        found = digest(kept) if kept.exists() else self._policy()["digest"]
        if found != content["policy"]["digest"]:
            raise TrainingError(
                f"{self.entry.folder}: the policy is not the one that played {len(self.result.against)} "
                "matches there: give the agent another name, or choose another --out"
            )

    def _policy(self) -> Content:
        """Put the policy into the folder, unless it is a function; return its entry in the result."""
        entry = self.entry
        if entry.agent.kind == FUNCTION:
            made = entry.agent.made(entry.task.name, entry.seed)
            return {"digest": digest(made.file), STEPS: None, "of_task": False, "met": []}
        if entry.agent.kind == PRESET:
            return self._keep(self._train(entry.config(), TRAINED), POLICY)
        return self._keep(entry.agent.policy(entry.task.name, entry.seed), POLICY)

    def _keep(self, path: Path, name: str) -> Content:
        """Copy a policy, with weights in half precision; return its entry in the result."""
        kept = self.entry.folder / name
        saved = path.suffix == policy_file.SUFFIX
        write_files({kept: path.read_bytes() if saved else policy_file.content(*weights_of(path))})
        return described(kept, self.entry.task)

    def _train(self, config: TrainingConfig, name: str) -> Path:
        """Begin or continue a training; return the newest checkpoint."""
        folder = self.entry.folder / name
        with self._timed(name):
            run = TrainingRun(config, folder, resume=folder.exists())
            run.train(lambda run: self.progress(self.entry.done(), f"{name}: {run.now}"))
        return newest(folder)

    def _contender(self) -> Contender:
        entry = self.entry
        if entry.agent.kind == FUNCTION:
            return entry.agent.made(entry.task.name, entry.seed)
        return Contender(entry.agent.name, str(entry.folder / POLICY))

    def _play(self, game: TaskGame, name: str, own: Contender, other: Contender | None = None, known: str = "") -> None:
        """Play a match, and enter it. other, known: An opponent outside the suite, and its digest."""
        if other is None and name != SELF:
            member = next(member for member in suite(self.entry.task) if member.name == name)
            other, known = member.contender(), member.digest
        self.progress(self.entry.done(), f"{game.name} against {name}")
        path = self.entry.folder / result.recording_name(game.name, name)
        pair = [own] if other is None else [own, other]
        with self._timed("matches"):
            try:
                found = play(game, pair, self.entry.games, path)
            except ActionError as error:
                raise TrainingError(f"{game.name} against {name}: {error}") from error
        match = {"game": game.name, "against": name, "opponent": known, **found}
        self.result.matches.append(match)
        self.result.write()

    def _respond(self, own: Contender) -> None:
        """Train a best response to the policy, and play their match."""
        entry, content, game = self.entry, self.result.content, self.entry.task.games[0]
        if content["response"] is None:
            config = response_config(entry.task, entry.seed, entry.budget, entry.folder / POLICY, entry.threads)
            path = self._train(config, BEST)
            content["response"] = self._keep(path, RESPONSE)
            self.result.write()
        if (game.name, BEST) not in self.result.against:
            best = Contender(BEST, str(entry.folder / RESPONSE))
            self._play(game, BEST, own, best, content["response"]["digest"])

    @contextmanager
    def _timed(self, name: str) -> Iterator[None]:
        """Add the time of the body to the recorded time: seconds of wall clock and of CPU."""
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            seconds: dict[str, Any] = self.result.content["seconds"]
            for key, spent in (("wall", time.perf_counter() - wall), ("cpu", time.process_time() - cpu)):
                seconds[f"{name} {key}"] = round(seconds.get(f"{name} {key}", 0.0) + spent, 2)
            self.result.write()
