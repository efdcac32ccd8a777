"""The statistics of single episodes: as arrays, and as a file with a row for each."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np

from ..core.spaces import statistics
from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from .against import PLAYED, Against
from .summary import MOMENTS, column_names
from .table_file import table_file

Result = TypeVar("Result")
# called with info, and with the worlds in which an ended episode counts
Ended = Callable[[Mapping[str, Any], Array], Result]


def numbered(env: SurvivalVectorEnv, numbers: Array, against: Against | None = None) -> Ended[dict[str, Array]]:
    """Make a function that extracts the episodes that count from info.

    It returns `world`, `episode` (of the world, from 1), with others what Against.played returns, and all statistics by
    name, (episodes,) or (episodes, n); masked arrays if some episodes lack agents or sides.

    Args:
        env: The environment.
        numbers: Number of the episode that each world is in, from 1, int (worlds,).
        against: Who plays, if there are others.
    """

    def rows(info: Mapping[str, Any], where: Array) -> dict[str, Array]:
        worlds, there = np.flatnonzero(where), info.get("statistics_present", {})
        found = {key: values[worlds] for key, values in info["statistics"].items()}
        masked = {key: np.ma.array(found[key], mask=~present[worlds]) for key, present in there.items()}
        played = against.played(worlds) if against else {}
        return {"world": worlds + env.first_world, "episode": numbers[worlds]} | played | found | masked

    return rows


def _cells(values: Array) -> Array:
    """Return the cells of a table with these values: empty where they are masked."""
    return np.ma.filled(values.astype(object), "") if np.ma.isMaskedArray(values) else values


@contextlib.contextmanager
def episode_file(
    path: str, env: SurvivalVectorEnv, numbers: Array, against: Against | None = None
) -> Iterator[Ended[None]]:
    """Open a new file for the episodes of a rollout. In the end it is complete, or not there.

    Columns are `world`, `episode` (of the world, from 1), with others those of Against.played, and the statistics in
    alphabetical order. A statistic with an entry per agent or side has a column for each (return_0, return_1), which is
    empty if the episode had no such agent or side; that of a moment (first_death) is empty if it never came. Rows are
    in the order in which episodes end.

    Args:
        path: NAME.csv.
        env: As for `numbered`.
        numbers: Likewise.
        against: Likewise.

    Yields:
        A function that adds a row for each episode that counts.

    Raises:
        UsageError: See table_file.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    names = [name for key in keys for name in column_names(key, none[key])]
    rows = numbered(env, numbers, against)
    firsts = ["world", "episode", *(PLAYED if against else ())]
    with table_file(path, "episodes", [*firsts, *names]) as table:

        def add(info: Mapping[str, Any], where: Array) -> None:
            if where.any():
                own = rows(info, where)
                own |= {key: np.ma.masked_equal(own[key], 0) for key in keys if key in MOMENTS}
                columns = [column for key in keys for column in _cells(own[key]).reshape(where.sum(), -1).T]
                table.add({name: own[name] for name in firsts} | dict(zip(names, columns, strict=True)))

        yield add
