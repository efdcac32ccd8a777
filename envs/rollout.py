"""Rollouts: run a policy in many worlds for many steps and sum up the episodes."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .policies import Policy
from .scenario import Scenario
from .vector import SurvivalVectorEnv

Array = np.ndarray[Any, Any]

BLOCK = 256  # worlds in a block, at most: little to do again when a worker is lost


@dataclass
class Summary:
    """Mean and standard error of every episode statistic. Kept are sums for each world, nothing of single episodes.

    Sums over worlds are exact before they are rounded once, so worlds may be summed up in any order and in any parts.
    Episodes that were still running at the end are not in it, and long ones are more likely to be among them: with
    steps enough for only a few episodes a world, the means lean towards short episodes.
    """

    episodes: int = 0
    sums: dict[str, Array] = field(default_factory=dict)  # float64 (worlds,) or (worlds, n), n agents, sides ...
    squares: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def merge(cls, parts: Iterable["Summary"]) -> "Summary":
        """The summary of all worlds of `parts`, none of which may be in two of them."""
        parts = [part for part in parts if part.episodes]
        sums, squares = (
            {key: np.concatenate([table[key] for table in tables]) for key in (tables[0] if tables else ())}
            for tables in ([part.sums for part in parts], [part.squares for part in parts])
        )
        return cls(sum(part.episodes for part in parts), sums, squares)

    def add(self, statistics: dict[str, Any], where: Array) -> None:
        """Count the episodes `where` of info["statistics"], whose rows of other worlds are zero."""
        self.episodes += int(where.sum())
        for key, given in statistics.items():
            values = np.asarray(given, np.float64)
            if key not in self.sums:
                self.sums[key], self.squares[key] = np.zeros_like(values), np.zeros_like(values)
            self.sums[key] += values
            self.squares[key] += values**2

    def rows(self) -> list[tuple[str, float, float]]:
        """(name, mean, standard error); statistics with an entry an agent or side get a row for each."""
        rows = []
        for key in sorted(self.sums):
            columns, squares = (table[key].reshape(len(table[key]), -1).T for table in (self.sums, self.squares))
            names = [key] if self.sums[key].ndim == 1 else [f"{key} {k}" for k in range(len(columns))]
            rows += [(name, *self._row(*pair)) for name, *pair in zip(names, columns, squares, strict=True)]
        return rows

    def _row(self, sums: Array, squares: Array) -> tuple[float, float]:
        mean = math.fsum(sums) / self.episodes
        spread = max(math.fsum(squares) / self.episodes - mean**2, 0)
        return mean, math.sqrt(spread / max(self.episodes - 1, 1))

    def __str__(self) -> str:
        if not self.episodes:
            return "no episode ended; take more steps"
        lines = [f"{'per episode':<20} {'mean':>12} {'std. error':>12}"]
        lines += [f"{name:<20} {mean:>12.4f} {error:>12.4f}" for name, mean, error in self.rows()]
        return "\n".join(lines)


def rollout(
    env: SurvivalVectorEnv, policy: Policy, steps: int, progress: Callable[[int], None] = lambda world_steps: None
) -> Summary:
    """Reset everything, take `steps` steps of every world, and sum up all episodes that end.

    progress is called after every step with the number of world-steps done. Ctrl-C ends it early; the summary so far is
    returned by raising KeyboardInterrupt with it as its argument.
    """
    summary = Summary()
    observations, _ = env.reset()
    try:
        for step in range(steps):
            observations, _, _, _, info = env.step(policy(observations))
            if "statistics" in info:
                summary.add(info["statistics"], info["_statistics"])
            progress((step + 1) * env.num_worlds)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(summary) from None
    return summary


def ticks(env: SurvivalVectorEnv, policy: Policy, steps: int) -> Iterator[int]:
    """Reset everything, then take `steps` steps, one whenever the next item is asked for: the number of steps done.

    The first item is 0: the worlds are just reset. Between items the worlds can be looked at.
    """
    observations, _ = env.reset()
    yield 0
    for step in range(1, steps + 1):
        observations, *_ = env.step(policy(observations))
        yield step


@dataclass(frozen=True)
class Task:
    """A rollout as data. policy: makes one for an environment and a seed; see POLICIES."""

    scenario: Scenario
    policy: Callable[[SurvivalVectorEnv, int], Policy]
    steps: int
    seed: int


def play(task: Task, first: int, count: int) -> Summary:
    """The summary of `count` worlds from `first` on: the same as theirs in a rollout of all."""
    env = SurvivalVectorEnv(task.scenario, count, seed=task.seed, first_world=first, check_actions=False)
    try:
        return rollout(env, task.policy(env, task.seed), task.steps)
    finally:
        env.close()


def blocks(worlds: int, workers: int) -> list[tuple[int, int]]:
    """(first world, number of worlds) of each block: something for every worker, nothing larger than BLOCK."""
    size = min(BLOCK, -(-worlds // workers))
    return [(first, min(size, worlds - first)) for first in range(0, worlds, size)]
