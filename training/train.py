"""A training run: collect, update, log, save, and go on from where it was stopped."""

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from outlast.envs.errors import TrainingError
from outlast.envs.scenarios.fingerprint import difference, fingerprint
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage.atomic_write import atomic_write, is_temporary, remove

from . import checkpoint, header
from .logs import open_logs
from .ppo import SharedPPO
from .presets import preset
from .settings import ROLLOUT

THREADS = 4  # more do not pay for networks this small
SHOWN = {"rollout/steps": "length", "rollout/reward0": "return", "train/epochs": "epochs"}
Progress = Callable[["Run"], None]


@dataclass(frozen=True)
class Plan:
    """What to train, and how. steps and every count agent-steps; settings are numbers of PPO other than the paper's."""

    scenario: Scenario
    preset: str = "original"
    steps: int = 10_000_000
    seed: int = 0
    worlds: int = 64
    rollout: int = ROLLOUT  # environment steps of a rollout
    dead: str = "keep"
    device: str = "cpu"
    threads: int = 0  # of the networks and the worlds; 0: one for each core, up to THREADS
    every: int = 1_000_000  # a checkpoint
    settings: dict[str, Any] = field(default_factory=dict)

    def about(self) -> dict[str, Any]:
        """What decides the numbers that come out, for a file."""
        kept = {key: value for key, value in asdict(self).items() if key not in ("scenario", "steps", "every")}
        return {"plan": kept, "scenario": fingerprint(self.scenario)}


class Run:
    """A run in a folder: run.json, log.csv, TensorBoard's events, checkpoints.

    A process that is killed at any moment leaves a run that can be resumed.
    """

    def __init__(self, plan: Plan, folder: Path, *, resume: bool = False) -> None:
        """resume: go on from the newest checkpoint, or begin again if the run was stopped before its first.

        Raises TrainingError, and writes nothing, if that cannot be.
        """
        self.plan, self.folder = plan, folder
        files = self._found(resume)
        threads = plan.threads or min(THREADS, torch.get_num_threads())
        torch.set_num_threads(threads)
        self.model = SharedPPO(
            plan.scenario,
            preset(plan.preset),
            worlds=plan.worlds,
            steps=plan.rollout,
            seed=plan.seed,
            dead=plan.dead,
            device=plan.device,
            threads=threads,
            **plan.settings,
        )
        if files is None:
            self.model.start()
        else:
            self._check_plan(checkpoint.about(files))
            checkpoint.restore(self.model, files)
        with self._writing():
            self._prepare()
            self.model.set_logger(open_logs(folder, self.model.num_timesteps))
        self.saved = self.done = self.model.num_timesteps  # in a checkpoint; and in updates that are done
        self.shown: dict[str, str] = {}  # a few of the numbers that were logged last

    def go(self, progress: Progress = lambda run: None) -> None:
        """Train to the end of the plan. Ctrl-C saves where the last update ended and is raised again.

        progress is called after each update, and as each of its epochs begins: the first ones take minutes.
        Raises TrainingError if the disk is full; what is in the folder can be resumed.
        """

        def begins(epoch: int) -> None:
            self.shown["now"] = f"epoch {epoch}"
            progress(self)

        self.model.rollout_buffer.watch = begins
        kept = self._capture() if not self.saved else None
        try:
            while self.model.num_timesteps < self.plan.steps:
                self._iterate()
                self.done, self.shown["now"] = self.model.num_timesteps, "collecting"
                kept = self._capture()
                if self.model.num_timesteps // self.plan.every > self.saved // self.plan.every:
                    self._save(kept)
                progress(self)
        finally:
            with self._writing():
                try:
                    if kept is not None:
                        self._save(kept)
                finally:
                    self.model.logger.close()

    def _iterate(self) -> None:
        """A rollout, an update, and what there is to say of them."""
        model, times = self.model, [time.perf_counter()]
        model.collect()
        times.append(time.perf_counter())
        tags = model.collector.episodes.report() | model.collector.behaviour.report(model.rollout_buffer)
        model._update_current_progress_remaining(model.num_timesteps, self.plan.steps)
        model.train()
        times.append(time.perf_counter())
        samples = model.rollout_buffer.alive.size
        collecting, updating = times[1] - times[0], times[2] - times[1]
        tags |= {
            "time/env_steps": model.num_timesteps / model.core.num_agents,
            "time/fps": samples / (times[2] - times[0]),
            "time/collected_per_second": samples / collecting,
            "time/updated_per_second": samples * model.logger.name_to_value["train/epochs"] / updating,
        }
        for tag, value in tags.items():
            model.logger.record(tag, value)
        shown = model.logger.name_to_value
        self.shown |= {name: f"{shown[tag]:.1f}" for tag, name in SHOWN.items() if tag in shown}
        with self._writing():
            model.logger.dump(model.num_timesteps)

    def _capture(self) -> tuple[int, dict[str, bytes]]:
        with self._writing():  # of a file for the worlds, which passes by
            return self.model.num_timesteps, checkpoint.capture(self.model, self.plan.about())

    def _save(self, kept: tuple[int, dict[str, bytes]]) -> None:
        steps, files = kept
        with self._writing():
            checkpoint.write(self.folder / checkpoint.NAME.format(steps), files)
        self.saved = steps

    def _found(self, resume: bool) -> dict[str, bytes] | None:
        """The checkpoint to go on from, if there is one."""
        there = [path for path in self.folder.iterdir() if not is_temporary(path)] if self.folder.is_dir() else []
        if there and not resume:
            raise TrainingError(f"{self.folder} is not empty: go on with --resume, or choose another folder with --out")
        if not resume or (self.folder.is_dir() and not there):  # it was stopped before it could say what it is
            return None
        if self.folder / header.NAME in there and not any(self.folder.glob("steps_*.zip")):
            self._check_begun()
            return None
        return checkpoint.read(checkpoint.newest(self.folder))

    def _check_begun(self) -> None:
        """A run that has no checkpoint yet is this one."""
        told = header.of_run(self.folder)
        self._check_plan(told)
        if other := difference(told["scenario"], fingerprint(preset(self.plan.preset).scenario(self.plan.scenario))):
            raise TrainingError(f"the run in {self.folder} was begun with another scenario {other}")

    def _prepare(self) -> None:
        """The folder, without what a killed process was writing in it, and what says what the run is."""
        self.folder.mkdir(parents=True, exist_ok=True)
        for path in filter(is_temporary, list(self.folder.iterdir())):
            remove(path)
        if not (self.folder / header.NAME).exists():
            told = self.plan.about() | {"scenario": fingerprint(self.model.core.scenario)}
            with atomic_write(self.folder / header.NAME) as place:
                place.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """A disk that takes no more is told as what it is."""
        try:
            yield
        except OSError as error:
            told = f"{error.filename or self.folder}: {error.strerror or error}"
            raise TrainingError(f"{told}; make room there, and go on with --resume") from error

    def _check_plan(self, told: dict[str, Any]) -> None:
        """Going on with other numbers would not be the same run."""
        then, now = told["plan"], json.loads(json.dumps(self.plan.about()["plan"]))
        differ = [key for key in now if now[key] != then.get(key) and key not in ("device", "threads")]
        if differ:
            others = ", ".join(f"{key} = {then.get(key)}, not {now[key]}" for key in differ)
            raise TrainingError(f"the run in {self.folder} was begun with {others}")
