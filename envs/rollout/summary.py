"""The summary of many episodes: means and standard errors of their statistics."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


@dataclass
class Summary:
    """Means and standard errors of all statistics of episodes; `str(summary)` is a table.

    Kept are sums for each world, nothing of single episodes. They are exact before they are rounded once, so worlds may
    be summed up in any order and in any parts.

    Attributes:
        episodes: How many were counted.
        episodes_per_world: How many of every world, its first ones; means and standard errors are unbiased. 0: all that
            ended before the worlds were stopped. Long ones are more likely to be cut off then, so means lean towards
            short ones.
        world_steps: How many were taken, of all worlds.
        sums: Of each statistic, float64 (worlds,) or (worlds, n), n agents, sides ...
        squares: The sums of squares, likewise.
    """

    episodes: int = 0
    episodes_per_world: int = 0
    world_steps: int = 0
    sums: dict[str, Array] = field(default_factory=dict)
    squares: dict[str, Array] = field(default_factory=dict)

    @classmethod
    def merge(cls, parts: Iterable["Summary"]) -> "Summary":
        """The summary of all worlds of `parts`, none of which may be in two of them."""
        parts = list(parts)
        per_world = min((part.episodes_per_world for part in parts), default=0)
        world_steps = sum(part.world_steps for part in parts)
        parts = [part for part in parts if part.episodes]
        sums, squares = (
            {key: np.concatenate([table[key] for table in tables]) for key in (tables[0] if tables else ())}
            for tables in ([part.sums for part in parts], [part.squares for part in parts])
        )
        return cls(sum(part.episodes for part in parts), per_world, world_steps, sums, squares)

    def add(self, statistics: dict[str, Any], where: Array) -> None:
        """Count the episodes of info["statistics"] in the worlds `where`, bool (worlds,)."""
        self.episodes += int(where.sum())
        for key, given in statistics.items():
            values = np.asarray(given, np.float64) * where.reshape(-1, *[1] * (np.ndim(given) - 1))
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
        lines = [self._heading(), "", f"{'per episode':<20} {'mean':>12} {'std. error':>12}"]
        lines += [f"{name:<20} {mean:>12.4f} {error:>12.4f}" for name, mean, error in self.rows()]
        return "\n".join(lines)

    def _heading(self) -> str:
        if not self.episodes_per_world:
            return (
                f"{self.episodes:,} episodes ended; those cut off at the end are missing, so means lean towards short "
                "episodes"
            )
        count = f"{self.episodes_per_world:,} " if self.episodes_per_world > 1 else ""
        return f"{self.episodes:,} whole episodes, the first {count}of every world"
