"""A training run: collect, update, log, save, and resume."""

import contextlib
import csv
import errno
import io
import itertools
import json
import logging
import os
import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.record_writer import RecordWriter

from outlast.ecs.kernels.available import available_cores
from outlast.envs.rollout.saved import CHECKPOINT, ENDINGS, checkpoints, is_saved, models
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.storage.interrupts import interrupts_held, one_interrupt, save_requests
from outlast.envs.storage.outputs import FolderLock, atomic_write, is_lock, target_name

from ..base import curves, policy_file
from ..base.config import TrainingConfig, parse_warm_start
from ..base.errors import TrainingError
from ..base.presets import preset
from ..policies import checkpoint
from ..policies.torch_settings import learning
from ..ppo.crew import Crew, recruit, recruit_on_cluster
from ..ppo.rollout import Rollout
from ..ppo.trainer import Trainer, capture, check_learned, restore
from .film import film_checkpoint

FORMAT = "brain.Event:2"  # content of the first event of a file
_numbers = itertools.count()  # one for each event file of this process, which may create several in one second
WRITTEN = (policy_file.RUN_JSON, curves.LOG, "steps_*")  # names of the files that only a run itself writes
FILES = re.compile(rf"[^,]+({'|'.join(map(re.escape, ENDINGS))})(?=:)")  # a saved policy among the opponents of a plan
logger = logging.getLogger(__name__)


class RunLog:
    """The logs of a run that has done `steps` agent-steps; entries of later steps are removed, or hidden.

    When `write` returns, all entries are in the files, or OSError is raised; TensorBoard's own writer has a thread.
    """

    def __init__(self, folder: Path, steps: int) -> None:
        curves.truncate_log(folder / curves.LOG, steps)
        self.rows = (folder / curves.LOG).open("a", newline="", encoding="utf-8")
        if self.rows.tell() == 0:
            self.rows.write(",".join(curves.HEADING) + "\n")
            self.rows.flush()
        name = f"events.out.tfevents.{int(time.time()):010}.{socket.gethostname()}.{os.getpid()}.{next(_numbers):06}"
        self.events = (folder / name).open("wb")
        self.records = RecordWriter(self.events)
        self._add(file_version=FORMAT, step=steps + 1)
        self._add(session_log=SessionLog(status=SessionLog.START), step=steps + 1)
        self.events.flush()

    def write(self, values: Mapping[str, float], step: int) -> None:
        """Log values by tag at an agent-step, sorted by tag."""
        text = io.StringIO()
        rows = csv.writer(text, lineterminator="\n")
        rows.writerows((tag, step, repr(float(value))) for tag, value in sorted(values.items()))
        self.rows.write(text.getvalue())
        for tag, value in values.items():
            self._add(summary=Summary(value=[Summary.Value(tag=tag, simple_value=float(value))]), step=step)
        for file in (self.rows, self.events):
            file.flush()

    def close(self) -> None:
        """Close the files."""
        self.rows.close()
        self.events.close()

    def _add(self, **event: Any) -> None:
        self.records.write(Event(wall_time=time.time(), **event).SerializeToString())


Progress = Callable[["TrainingRun"], None]


class Callbacks:
    """Functions that are called during a run, in its first process. An object with some of these methods is enough.

    They may read everything and call `run.log.write(values, run.done)`. An exception ends the run, which is saved in
    the state after its last update.
    """

    def on_rollout(self, run: "TrainingRun", rollout: Rollout) -> None:
        """Act after a rollout, before its update; run.done does not count it yet."""

    def on_update(self, run: "TrainingRun", tags: dict[str, float]) -> None:
        """Act after an update, which counts as done. tags: Logged values."""

    def on_checkpoint(self, run: "TrainingRun", path: Path) -> None:
        """Act when a checkpoint is written, except after an interrupt or an error."""


MOMENTS = {name for name in vars(Callbacks) if name.startswith("on_")}


def check_callbacks(callbacks: Any) -> None:
    """Raise TrainingError unless each object has methods of Callbacks, and no other methods that begin with on_."""
    if not isinstance(callbacks, Sequence):
        raise TrainingError(f"callbacks = {callbacks!r:.200}: must be a list of objects")
    for each in callbacks:
        names = {name for name in dir(each) if name.startswith("on_")}
        if not names or names - MOMENTS:
            raise TrainingError(f"callbacks: {each!r:.200} has {sorted(names)}: it must have some of {sorted(MOMENTS)}")


def prepared(config: TrainingConfig, files: dict[str, bytes] | None, crew: Crew) -> Trainer:
    """Return the trainer of a process, which continues from the files of a checkpoint, if any."""
    threads = config.threads or max(1, min(torch.get_num_threads(), available_cores()) // crew.size)
    torch.set_num_threads(1)
    trainer = Trainer(config, threads, crew)
    if files is not None:
        restore(trainer, files)
    else:
        trainer.take_weights()
    return trainer


def follow(crew: Crew, config: TrainingConfig, files: dict[str, bytes] | None) -> None:
    """Do the same as the first process in another one, without logs and files."""
    trainer = prepared(config, files, crew)
    if files is None and config.warm_start:
        trainer.imitate(lambda done, tags: None)
        trainer.captured()
    if not trainer.steps:
        trainer.captured()
    while trainer.steps < config.steps:
        left, rollout = 1 - trainer.steps / config.steps, trainer.collect()
        trainer.report()
        trainer.update(rollout, left)
        trainer.captured()


class TrainingRun:
    """A run in a folder: run.json, log.csv, TensorBoard's events, checkpoints. A killed one can be resumed.

    Attributes:
        anew: Whether the run begins at 0 although it was to be resumed, since it has no checkpoint yet.
        done: Agent-steps of complete updates.
        saved: Agent-steps in the newest checkpoint.
        tags: The last logged numbers.
        now: Current activity of the run, in one or two words.
    """

    @learning()
    def __init__(
        self,
        config: TrainingConfig,
        folder: Path,
        *,
        resume: bool = False,
        film: bool = False,
        cluster: str | None = None,
        callbacks: Sequence[Any] = (),
    ) -> None:
        """Create the worlds and networks, and write run.json; the folder is created if it is missing. See RunOptions.

        A run that was stopped before its first checkpoint begins again. Raises ClusterError, and TrainingError if the
        run cannot begin or resume there; then nothing is written.
        """
        self.config, self.folder, self.film, self.callbacks = config, folder, film, callbacks
        there = self._there()
        files = self._find_checkpoint(there, resume)
        if files is None:
            config.check_teacher()
        else:
            self._check_plan(checkpoint.header_of(files))
        if cluster is None:
            self.crew = recruit(config.processes, follow, config, files)
        else:
            if config.processes == 1:
                raise TrainingError("a cluster requires several processes: add --processes 8, for example")
            self.crew = recruit_on_cluster(cluster, config.processes, follow, config, files)
        self.fresh, self._threads = files is None, torch.get_num_threads()
        self.lock = FolderLock(folder, "trains this run", WRITTEN)
        try:
            self.trainer = prepared(config, files, self.crew)
            with self._disk_errors():
                self._prepare(there)
                self.log = RunLog(folder, self.trainer.steps)
        except BaseException:
            self.lock.release()
            self.crew.close()
            torch.set_num_threads(self._threads)
            raise
        self.anew = resume and self.fresh
        self.saved = self.done = self.trainer.steps
        self.tags: dict[str, float] = {}
        self.now = "collecting"
        self.kept: tuple[int, dict[str, bytes]] | None = None  # the state after the last update: steps, checkpoint
        self.asked: list[int] = []  # signals that request a checkpoint

    @one_interrupt()
    @learning()
    def train(self, progress: Progress = lambda run: None) -> None:
        """Train up to the steps of the config. Ctrl-C saves the state after the last update and is raised again.

        SIGUSR1 saves that state, too, at the end of the rollout or epoch, and the run continues.

        progress: Called after each update and at the start of each of its epochs. Raises TrainingError if the disk is
        full, or a process is lost; the run can be resumed.
        """
        with save_requests() as self.asked:
            try:
                self._train(progress)
            finally:
                with interrupts_held(), self._disk_errors():  # a cluster may signal both this process and its parent
                    self.crew.close()
                    try:
                        if self.kept is not None:
                            self._save(self.kept)
                    finally:
                        self.log.close()
                        self.lock.release()
                        torch.set_num_threads(self._threads)

    def _train(self, progress: Progress) -> None:
        if self.fresh and self.config.warm_start:
            self._warm_start(progress)
        if not self.saved:
            self.kept = self._capture()
        while self.trainer.steps < self.config.steps:
            self._iterate(progress)
            self.done, self.now = self.trainer.steps, "collecting"
            self.kept = self._capture()
            self._call("on_update", self.tags)
            last = self.done >= self.config.steps
            if last or self.done // self.config.every > self.saved // self.config.every:
                self._save_and_call(self.kept)
                if self.film:
                    latest = self.folder / CHECKPOINT.format(self.saved)
                    film_checkpoint(latest, self.folder, self.config.scenario)
            self._save_if_asked()
            progress(self)

    def _save_if_asked(self) -> None:
        """Save the state after the last update, if SIGUSR1 has arrived."""
        if self.asked and self.kept is not None:
            self.asked.clear()
            path = self.folder / CHECKPOINT.format(self.kept[0])
            if not path.exists():
                self._save_and_call(self.kept)
                logger.info("saved %s after SIGUSR1", path)

    def _warm_start(self, progress: Progress) -> None:
        """Imitate the teacher, and save. After an interrupt, a resumed run imitates from the beginning."""

        def on_rollout(done: int, tags: dict[str, float]) -> None:
            what = f"the imitation that the run begins with diverged: after {done} agent-steps"
            check_learned(self.trainer, tags, what, "in units of smaller rewards, or without --warm-start")
            self.now, self.tags = f"imitated {done / 1e6:.1f} M agent-steps", tags
            progress(self)

        start = time.perf_counter()
        tags = self.trainer.imitate(on_rollout)
        self._save_and_call(self._capture())
        if tags:
            with self._disk_errors():  # after the checkpoint, so that the log cannot have it twice
                self.log.write(tags | {"time/imitation": time.perf_counter() - start}, 0)

    def _iterate(self, progress: Progress) -> None:
        """Collect a rollout, update from it, and log both."""

        def on_epoch(epoch: int) -> None:
            self.now = f"epoch {epoch}"
            self._save_if_asked()
            progress(self)

        trainer, times = self.trainer, [time.perf_counter()]
        left = 1 - trainer.steps / self.config.steps
        rollout = trainer.collect()
        times.append(time.perf_counter())
        self._call("on_rollout", rollout)
        times.append(time.perf_counter())
        tags = trainer.report() | trainer.update(rollout, left, on_epoch)
        what = f"training diverged: after {trainer.steps} agent-steps"
        check_learned(trainer, tags, what, "with a lower learning rate, or in units of smaller rewards")
        times.append(time.perf_counter())
        samples, collecting, updating = rollout.learner.size, times[1] - times[0], times[3] - times[2]
        tags |= {
            "time/env_steps": trainer.steps / trainer.env.num_agents,
            "time/fps": samples / (collecting + updating),
            "time/collected_per_second": samples / collecting,
            "time/updated_per_second": samples * tags.get("train/epochs", 0) / updating,
        }
        self.tags = tags
        with self._disk_errors():
            self.log.write(tags, trainer.steps)

    def _capture(self) -> tuple[int, dict[str, bytes]]:
        with self._disk_errors():  # worlds are written to a temporary file
            return self.trainer.steps, capture(self.trainer, self.config.header())

    def _call(self, moment: str, what: Any) -> None:
        for each in self.callbacks:
            if (call := getattr(each, moment, None)) is not None:
                call(self, what)

    def _save_and_call(self, kept: tuple[int, dict[str, bytes]]) -> None:
        self._save(kept)
        self._call("on_checkpoint", self.folder / CHECKPOINT.format(kept[0]))

    def _save(self, kept: tuple[int, dict[str, bytes]]) -> None:
        steps, files = kept
        with self._disk_errors():
            checkpoint.write_checkpoint(self.folder / CHECKPOINT.format(steps), files)
        self.saved = steps

    def _there(self) -> set[str]:
        """Return the names in the folder, except temporary files and the lock."""
        paths = self.folder.iterdir() if self.folder.is_dir() else ()
        return {path.name for path in paths if not target_name(path) and not is_lock(path)}

    def _find_checkpoint(self, there: set[str], resume: bool) -> dict[str, bytes] | None:
        """Return the checkpoint to resume from, if any. there: Names in the folder."""
        if there and not resume:
            raise TrainingError(f"{self.folder} is not empty: take --resume, or choose another folder with --out")
        if not resume or (self.folder.is_dir() and not there):  # stopped before run.json was written
            return None
        found = checkpoints(self.folder)
        if policy_file.RUN_JSON in there and not found:
            header = policy_file.read_run_folder(self.folder)
            self._check_plan(header)
            if other := preset(self.config.preset).difference(header["scenario"], self.config.scenario):
                raise TrainingError(f"the run in {self.folder} was begun with another scenario {other}")
            return None
        if not found:
            raise TrainingError(f"{self.folder} does not hold a run to resume")
        return checkpoint.read_checkpoint(found[-1])

    def _prepare(self, there: set[str]) -> None:
        """Lock the folder, and write the requested settings to run.json. there: Names when the checkpoint was read."""
        checkpoint.header_of(self.trainer.policy_files(self.config.header()))  # raises if it cannot be read again
        try:
            self.lock.acquire()
        except BlockingIOError as error:
            raise TrainingError(str(error)) from None
        if self._there() != there:
            raise TrainingError(f"{self.folder}: another process has just trained this run; continue with --resume")
        if (self.folder / policy_file.RUN_JSON).exists():
            header = policy_file.read_run_folder(self.folder)
        else:
            header = self.config.header() | {"scenario": fingerprint(self.trainer.env.scenario)}
        if header.get(policy_file.ASKED) != self.config.steps:
            with atomic_write(self.folder / policy_file.RUN_JSON) as place:
                text = json.dumps(header | {policy_file.ASKED: self.config.steps}, indent=1)
                place.write_text(text + "\n", encoding="utf-8")

    @contextlib.contextmanager
    def _disk_errors(self) -> Iterator[None]:
        """Turn errors of the disk into a TrainingError that names the cure."""
        try:
            yield
        except OSError as error:
            wrong = f"{error.filename or self.folder}: {error.strerror or error}"
            cure = "choose a folder that can be written to, --out"
            if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
                cure = "free some space, and continue with --resume"
            raise TrainingError(f"{wrong}; {cure}") from error

    def _check_plan(self, header: policy_file.Header) -> None:
        """Raise TrainingError for a different plan: it would not be the same run. Files of policies may have moved."""
        plans = header["plan"], self.config.header()["plan"]
        then, now = (json.loads(json.dumps(plan)) for plan in plans)
        free = ("device", "threads") if "steps" in header["plan"] else ("device", "threads", "steps")
        differ = [key for key in now if now[key] != then.get(key) and key not in free]
        if "settings" in differ and "preset" not in differ:
            with contextlib.suppress(TrainingError, TypeError, AttributeError):  # settings of a file may be invalid
                if self.config.numbers_by_policy == preset(self.config.preset).numbers_by_policy(then["settings"]):
                    differ.remove("settings")  # other settings are named, but their values are the preset's
        if "warm_start" in differ and _same_teacher(str(then.get("warm_start")), now["warm_start"]):
            differ.remove("warm_start")
        if FILES.sub("FILE", str(then.get("opponents"))) == FILES.sub("FILE", now["opponents"]):
            differ = [key for key in differ if key != "opponents"]
        if differ:
            others = ", ".join(f"{key} = {then.get(key)}, not {now[key]}" for key in differ)
            cure = "resume with the same, or choose another folder with --out"
            if differ == ["steps"]:
                cure = f"its learning rate depends on them; take --steps {then['steps']}, or another --out"
                cure += f", perhaps with --warm-start {self.folder}" * bool(checkpoints(self.folder))
            raise TrainingError(f"the run in {self.folder} was begun with {others}: {cure}")


def _same_teacher(then: str, now: str) -> bool:
    """Return whether two warm starts name one file that was moved, or equivalent files of one run."""
    (one, steps), (other, others) = parse_warm_start(then), parse_warm_start(now)
    moved = is_saved(one) and is_saved(other) and not {one, other} & models().keys() and steps == others
    return moved and (Path(one).name == Path(other).name or Path(one).parent.resolve() == Path(other).parent.resolve())
