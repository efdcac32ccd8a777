"""A training run: collect, update, log, save, and go on from where it was stopped."""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from outlast.envs.errors import TrainingError
from outlast.envs.scenario import Scenario
from outlast.envs.state import identity

from . import checkpoint
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
        return {"plan": kept, "scenario": identity(self.scenario)}


class Run:
    """A run in a folder: log.csv, TensorBoard's events, checkpoints."""

    def __init__(self, plan: Plan, folder: Path, *, resume: bool = False) -> None:
        """resume: go on from the newest checkpoint. Raises TrainingError, and writes nothing, if that cannot be."""
        self.plan, self.folder = plan, folder
        files = checkpoint.read(checkpoint.newest(folder)) if resume else None
        if files is None and folder.exists() and any(folder.iterdir()):
            raise TrainingError(f"{folder} is not empty: go on with --resume, or choose another folder with --out")
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
        folder.mkdir(parents=True, exist_ok=True)
        self.model.set_logger(open_logs(folder, self.model.num_timesteps))
        self.saved = self.model.num_timesteps
        self.shown: dict[str, str] = {}  # a few of the numbers that were logged last

    def go(self, progress: Progress = lambda run: None) -> None:
        """Train to the end of the plan. Ctrl-C saves where the last update ended and is raised again."""
        kept = self._capture() if not self.saved else None
        try:
            while self.model.num_timesteps < self.plan.steps:
                self._iterate()
                kept = self._capture()
                if self.model.num_timesteps // self.plan.every > self.saved // self.plan.every:
                    self._save(kept)
                progress(self)
        finally:
            if kept is not None:
                self._save(kept)
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
        model.logger.dump(model.num_timesteps)

    def _capture(self) -> tuple[int, dict[str, bytes]]:
        return self.model.num_timesteps, checkpoint.capture(self.model, self.plan.about())

    def _save(self, kept: tuple[int, dict[str, bytes]]) -> None:
        steps, files = kept
        checkpoint.write(self.folder / checkpoint.NAME.format(steps), files)
        self.saved = steps

    def _check_plan(self, header: dict[str, Any]) -> None:
        """Going on with other numbers would not be the same run."""
        then, now = header["plan"], json.loads(json.dumps(self.plan.about()["plan"]))
        differ = [key for key in now if now[key] != then.get(key) and key not in ("device", "threads")]
        if differ:
            told = ", ".join(f"{key} = {then.get(key)}, not {now[key]}" for key in differ)
            raise TrainingError(f"the run in {self.folder} was begun with {told}")
