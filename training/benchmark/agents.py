"""Agents of the benchmark: presets that it trains, existing runs and policies, functions in files."""

import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.saved import SAVED_AS, is_saved, located, models

from ..arena.match import Act
from ..arena.players import Contender
from ..base.errors import TrainingError
from ..base.presets import PRESETS
from .result import is_name

PRESET, FILE, FUNCTION = "preset", "file", "function"
FORMS = f"a preset ({', '.join(PRESETS)}), {SAVED_AS}, or FILE.py:FUNCTION"


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
        if options and agent.kind != PRESET:
            given = ", ".join(options)
            raise TrainingError(f"{given} has no effect on {text}, which is trained already: leave it out")
        return agent

    @property
    def trained(self) -> bool:
        """Return whether the benchmark trains it."""
        return self.kind == PRESET

    @property
    def function(self) -> bool:
        """Return whether it is a function of the user's."""
        return self.kind == FUNCTION

    @property
    def kind(self) -> str:
        """PRESET, FUNCTION, or FILE for saved policies and folders. Raises TrainingError."""
        if self.source in PRESETS:
            return PRESET
        if re.search(r"\.py:\w+$", self.source):
            return FUNCTION
        if is_saved(self.source) or "/" in self.source or Path(self.source).is_dir():
            return FILE
        raise TrainingError(f"{self.source}: unknown agent: it must be {FORMS}, as in mine=runs/ffa_2-fast-0")

    def check_seeds(self, seeds: Collection[int]) -> None:
        """Raise TrainingError for several seeds of one training: all would score the same."""
        if len(seeds) > 1 and self.kind == FILE and "{seed}" not in self.source:
            raise TrainingError(
                f"{self.name}={self.source} is one training for all seeds: name one --seed, or put {{seed}} in it"
            )

    def check_place(self, task: str, seed: int) -> None:
        """Raise TrainingError or UsageError if the file of a task and a seed does not exist."""
        if unknown := re.search(r"\{[^{}]*\}", self.place(task, seed)):
            raise TrainingError(f"{self.source}: {unknown[0]} is not replaced; {{task}}, {{game}} and {{seed}} are")
        if self.kind == FILE:
            self.policy(task, seed)
        elif self.function and not Path(self.place(task, seed).rpartition(":")[0]).is_file():
            raise TrainingError(f"{self.name}, {task}, seed {seed}: {self.place(task, seed)} does not exist")

    def place(self, task: str, seed: int) -> str:
        """Return the source for a task and a seed."""
        game = task.rpartition("-")[0]
        return self.source.replace("{task}", task).replace("{game}", game).replace("{seed}", str(seed))

    def made(self, task: str, seed: int) -> "Made":
        """Return the policy that a function makes for a task and a seed. Raises TrainingError, ScenarioError."""
        return Made(self.name, self.place(task, seed), seed)

    def policy(self, task: str, seed: int) -> Path:
        """Return the saved policy for a task and a seed; the newest one of a run. Raises TrainingError, UsageError."""
        text = self.place(task, seed)
        if text not in models() and not Path(text).exists():
            raise TrainingError(f"{self.name}, {task}, seed {seed}: {text} does not exist; it must be {FORMS}")
        return located(text)


class Made(Contender):
    """A policy that a user's function (env, seed) makes, from the seed of the agent."""

    def __init__(self, label: str, source: str, seed: int) -> None:
        """Import "FILE.py:FUNCTION". seed: The seed of the agent. Raises TrainingError, ScenarioError."""
        super().__init__(label, source)
        self.file, self._seed = Path(source.rpartition(":")[0]), seed

    def act(self, env: SurvivalVectorEnv, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        """Make the policy for these worlds. It has its own random numbers: `keyed` and `slack` have no effect."""
        return super().act(env, self._seed)
