"""Pin the games of the benchmark's tasks: under its name, a task never changes.

    python -m tests.task_digests --write

adds the tasks that tests/data/benchmark_tasks.json does not have yet. The file
has the fingerprint of each game, how its worlds begin on every platform, and
for each platform how they go on. Entries never change: another digest is
another game, and needs a new version of the task.
"""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from outlast import make_vec
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.scenario import Scenario
from outlast.training.benchmark.tasks import Task, TaskGame, tasks
from tests.digests import numbered_actions, platform_name

FILE = Path(__file__).parent / "data" / "benchmark_tasks.json"
WORLDS, TICKS = 16, 60
Pinned = dict[str, dict[str, Any]]


def games(task: Task) -> dict[str, TaskGame]:
    """The games of a task by name, and as "training" the one that agents are trained in."""
    train = TaskGame("training", task.scenario, (), 0)
    return {game.name: game for game in (train, *task.games.values())}


def identity(scenario: Scenario) -> str:
    """A digest of a game: its numbers, what varies, and so on, but not its name."""
    content = {key: value for key, value in fingerprint(scenario).items() if key not in ("name", "label")}
    return hashlib.blake2b(json.dumps(content, sort_keys=True).encode(), digest_size=12).hexdigest()


def observed(game: TaskGame, ticks: int) -> str:
    """A digest of the first observations, and of those of some ticks, with always the same actions."""
    env, total = make_vec(game.scenario, WORLDS, seed=game.seed, copy=False), hashlib.blake2b(digest_size=12)
    if game.given:
        env.set_numbers(game.numbers(WORLDS))
    observations, _ = env.reset(seed=game.seed)
    for tick in range(ticks + 1):
        if tick:
            observations, *_ = env.step(numbered_actions(env, tick))
        for _, array in sorted(observations.items()):
            total.update(np.ascontiguousarray(array))
    env.close()
    return total.hexdigest()


def pinned() -> Pinned:
    """The content of the file: by task and game."""
    return dict(json.loads(FILE.read_text())) if FILE.exists() else {}


def write() -> None:
    """Add what is not there yet."""
    known = pinned()
    for task in tasks().values():
        own = known.setdefault(task.name, {})
        for name, game in games(task).items():
            found = {"fingerprint": identity(game.scenario), "begins": observed(game, 0), "goes on": {}}
            entry = own.setdefault(name, found)
            entry["goes on"].setdefault(platform_name(), observed(game, TICKS))
    FILE.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__" and sys.argv[1:] == ["--write"]:
    write()
