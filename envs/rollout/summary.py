"""The summary of many episodes: means and standard errors of their statistics."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from ..core.validation import Array, joined
from ..errors import UsageError

RESULTS = ("won", "drawn", "lost")
MOMENTS = ("first_death",)  # moments of an event; 0 in episodes without it, which the means leave out


@dataclass(repr=False)
class Summary:
    """Means and standard errors of all statistics of episodes; `str(summary)` is a table.

    It keeps sums for each world and, if asked to, what `arrays` returns about single episodes. Sums are exact and
    rounded only once, so worlds may be summed up in any order and in any parts.

    Attributes:
        episodes: How many episodes were counted.
        episodes_per_world: How many were counted in every world, its first ones; means and standard errors are then
            unbiased. 0: all episodes that ended before the worlds were stopped. Long ones are then more likely to be
            cut off, so means lean towards short ones.
        world_steps: How many steps were taken, added up over worlds.
        sums: The sum of each statistic, float64 (worlds,) or (worlds, n), n agents, sides ...
        squares: The sums of squares, in the same form.
        counts: For statistics that some episodes lack (those of agents and sides, and MOMENTS), how many episodes had
            each, int64 (worlds, n) or (worlds,). For all others, every episode counts.
        outcomes: How many of the episodes the policy won, drew and lost against each of the others, by name, int (3,);
            empty without others.
        kept: The statistics of single episodes, in the order in which they ended; None if they were not asked for.
        seconds: Wall time spent in "policy", that of the others included, and in "worlds"; summed over machines.
    """

    episodes: int = 0
    episodes_per_world: int = 0
    world_steps: int = 0
    sums: dict[str, Array] = field(default_factory=dict)
    squares: dict[str, Array] = field(default_factory=dict)
    counts: dict[str, Array] = field(default_factory=dict)
    outcomes: dict[str, Array] = field(default_factory=dict)
    kept: list[dict[str, Array]] | None = None
    seconds: dict[str, float] = field(default_factory=lambda: {"policy": 0.0, "worlds": 0.0})

    @classmethod
    def merge(cls, parts: Iterable["Summary"]) -> "Summary":
        """Return the summary of all worlds of `parts`; no world may be in two of them."""
        parts = list(parts)
        per_world = min((part.episodes_per_world for part in parts), default=0)
        world_steps = sum(part.world_steps for part in parts)
        names = dict.fromkeys(name for part in parts for name in part.outcomes)
        outcomes = {name: np.sum([p.outcomes[name] for p in parts if name in p.outcomes], 0) for name in names}
        lists = [part.kept for part in parts if part.kept is not None]
        kept = [each for some in lists for each in some] if len(lists) == len(parts) else None
        seconds = {name: sum(part.seconds[name] for part in parts) for name in ("policy", "worlds")}
        tables = [(part.sums, part.squares, part.counts) for part in parts if part.episodes]
        sums, squares, counts = map(joined, zip(*(tables or [({}, {}, {})]), strict=True))
        episodes = sum(part.episodes for part in parts)
        return cls(episodes, per_world, world_steps, sums, squares, counts, outcomes, kept, seconds)

    def add(self, statistics: Mapping[str, Any], where: Array, present: Mapping[str, Array] | None = None) -> None:
        """Count the episodes of info["statistics"], and info["statistics_present"], in the worlds `where`."""
        self.episodes += int(where.sum())
        for key, there in (present or {}).items():
            self.counts[key] = self.counts.get(key, 0) + (there & where[:, None])
        for key in MOMENTS:
            if key in statistics and np.ndim(statistics[key]) == 1:
                self.counts[key] = self.counts.get(key, 0) + (where & (statistics[key] > 0))
        for key, given in statistics.items():
            values = np.asarray(given, np.float64) * where.reshape(-1, *[1] * (np.ndim(given) - 1))
            if key not in self.sums:
                self.sums[key], self.squares[key] = np.zeros_like(values), np.zeros_like(values)
            self.sums[key] += values
            self.squares[key] += values**2

    def arrays(self) -> dict[str, Array]:
        """Return the statistics of every episode, in order of worlds, and within a world in order of time.

        They are arrays (episodes,) or (episodes, n), n agents, sides ..., by name; and, as in files of episodes,
        `world` and `episode`, int64 (episodes,), and with others also `against`, `own_side` and `result`. If some
        episodes lack agents or sides, their statistics are masked arrays. `first_death` is 0 without deaths. Empty if
        no episode ended. UsageError if the statistics were not kept.
        """
        if self.kept is None:
            raise UsageError("the statistics of single episodes were not kept: call outlast.rollout(..., keep=True)")
        found = joined(self.kept)
        order = np.argsort(found["world"], kind="stable") if found else ()
        return {key: values[order] for key, values in found.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON. Where `unbiased` is False, means lean towards short episodes."""
        counts = self.episodes_of()
        outcomes = {name: dict(zip(RESULTS, counts.tolist(), strict=True)) for name, counts in self.outcomes.items()}
        return {
            "episodes": self.episodes,
            "episodes_per_world": self.episodes_per_world,
            "unbiased": self.episodes_per_world > 0,
            "world_steps": self.world_steps,
            "statistics": {
                name: {"mean": _finite(mean), "std_error": _finite(error)}
                | ({"episodes": counts[name]} if name in counts else {})
                for name, mean, error in sorted(self.rows("_"), key=lambda row: row[0])
            },
            "against": outcomes,
        }

    def episodes_of(self, between: str = "_") -> dict[str, int]:
        """Return how many episodes had each agent, side or moment that some lack, by name of statistic."""
        return {
            name: int(count)
            for key, counts in self.counts.items()
            for name, count in zip(column_names(key, counts, between), np.atleast_1d(counts.sum(0)), strict=True)
            if key not in MOMENTS or count < self.episodes
        }

    def rows(self, between: str = " ") -> list[tuple[str, float, float]]:
        """Return (name, mean, standard error) of each column; NaN for agents and sides that no episode had."""
        found = []
        for key in sorted(self.sums):
            sums, squares = (table[key].reshape(len(table[key]), -1).T for table in (self.sums, self.squares))
            given, names = self.counts.get(key), column_names(key, self.sums[key], between)
            counts = [self.episodes] * len(sums) if given is None else np.atleast_1d(given.sum(0)).tolist()
            for name, *row in zip(names, sums, squares, counts, strict=True):
                found.append((name, *_mean_and_error(*row)))
        return found

    def __str__(self) -> str:
        lines = [self._heading(), *([""] if self.episodes else [])]
        lines += [f"{name:<20}" + "".join(f" {cell:>12}" for cell in cells) for name, *cells in self._table()]
        if self.outcomes:
            lines += ["", against_table(self.outcomes)]
        return "\n".join(lines)

    __repr__ = __str__

    def _repr_html_(self) -> str:
        """Return the summary as HTML, for notebooks."""
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>" for cells in self._table())
        against = f"<pre>{escape(against_table(self.outcomes))}</pre>" if self.outcomes else ""
        return f"<p>{self._heading()}</p>{f'<table>{rows}</table>' if rows else ''}{against}"

    def _table(self) -> Iterator[tuple[str, ...]]:
        """Yield the cells of the table by row, headings first; nothing if no episode ended."""
        counts = self.episodes_of(" ")
        if self.episodes:
            yield ("per episode", "mean", "std. error", *(["episodes"] if counts else []))
        for name, *pair in self.rows() if self.episodes else ():
            cells = [f"{each:.4f}" if math.isfinite(each) else "-" for each in pair]
            yield (name, *cells, *([f"{counts.get(name, self.episodes):,}"] if counts else []))

    def _heading(self) -> str:
        if not self.episodes:
            return "no episode ended: statistics are of whole episodes, which take more steps"
        if not self.episodes_per_world:
            bias = "those cut off at the end are missing, so means lean towards short episodes"
            return f"{self.episodes:,} episodes ended; {bias}"
        count = f"{self.episodes_per_world:,} " if self.episodes_per_world > 1 else ""
        return f"{self.episodes:,} whole episodes, the first {count}of every world"


def _mean_and_error(sums: Array, squares: Array, count: int) -> tuple[float, float]:
    """Return mean and standard error, given sums over the episodes of each world; NaN if there are too few episodes."""
    if not count:
        return math.nan, math.nan
    mean = math.fsum(sums) / count
    spread = max(math.fsum(squares) / count - mean**2, 0)
    return mean, math.sqrt(spread / (count - 1)) if count > 1 else math.nan


def _finite(value: float) -> float | None:
    """Return the number, or None if it is not finite, which JSON cannot express."""
    return value if math.isfinite(value) else None


def column_names(key: str, values: Any, between: str = "_") -> list[str]:
    """Return the names of a statistic's columns: its own, or key_0, key_1 ... if `values` are (worlds, n)."""
    return [key] if np.ndim(values) == 1 else [f"{key}{between}{k}" for k in range(math.prod(np.shape(values)[1:]))]


def against_table(outcomes: Mapping[str, Array]) -> str:
    """Return a table: shares of episodes won, drawn and lost against each, with errors. outcomes: see Summary."""
    width = max(20, *map(len, outcomes))
    lines = [f"{'against':<{width}} {'episodes':>12}" + "".join(f" {name:>17}" for name in RESULTS)]
    for name, counts in ((name, counts.tolist()) for name, counts in outcomes.items()):
        cells = [_share(count, sum(counts)) for count in counts]
        lines.append(f"{name:<{width}} {sum(counts):>12,}" + "".join(f" {cell:>17}" for cell in cells))
    return "\n".join(lines)


def _share(count: int, episodes: int) -> str:
    """Write a share and its standard error."""
    if not episodes:
        return "-"
    share = count / episodes
    error = f"{(share * (1 - share) / (episodes - 1)) ** 0.5:.4f}" if episodes > 1 else "-"
    return f"{share:.4f} ± {error}"
