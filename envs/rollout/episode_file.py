"""The statistics of single episodes: as arrays, and as a file with a row for each."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import numpy as np

from ..core.spaces import statistics
from ..core.vector_env import SurvivalVectorEnv
from .summary import column_names
from .table_file import table_file

Array = np.ndarray[Any, Any]
Result = TypeVar("Result")
Ended = Callable[[Mapping[str, Any], Array], Result]  # of info and the worlds in which an episode counts


def numbered(env: SurvivalVectorEnv, numbers: Array) -> Ended[dict[str, Array]]:
    """What takes the episodes that count out of info. numbers: of the episode that each world is in, int (worlds,).

    It returns `world`, `episode` (of the world, from 1) and all statistics by name, (episodes,) or (episodes, n). Of
    agents and sides that not all episodes have, they are masked arrays.
    """

    def rows(info: Mapping[str, Any], where: Array) -> dict[str, Array]:
        worlds, there = np.flatnonzero(where), info.get("statistics_present", {})
        found = {key: values[worlds] for key, values in info["statistics"].items()}
        masked = {key: np.ma.array(found[key], mask=~present[worlds]) for key, present in there.items()}
        return {"world": worlds + env.first_world, "episode": numbers[worlds]} | found | masked

    return rows


def _cells(values: Array) -> Array:
    """What a table has of these: nothing where they are masked."""
    return np.ma.filled(values.astype(object), "") if np.ma.isMaskedArray(values) else values


@contextlib.contextmanager
def episode_file(path: str, env: SurvivalVectorEnv, numbers: Array) -> Iterator[Ended[None]]:
    """A new file for the episodes of a rollout, which is whole or not there.

    Columns are `world`, `episode` (of the world, from 1) and the statistics in alphabetical order; what has an entry an
    agent or side has a column for each, return_0, return_1, which is empty where the episode had no such agent or side.
    Rows are in the order in which episodes end.

    Args:
        path: NAME.csv.
        env: The environment.
        numbers: Of the episode that each world is in, from 1, int (worlds,).

    Yields:
        What adds a row for each episode that counts.

    Raises:
        UsageError: See table_file.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    names = [name for key in keys for name in column_names(key, none[key])]
    rows = numbered(env, numbers)
    with table_file(path, "episodes", ["world", "episode", *names]) as table:

        def add(info: Mapping[str, Any], where: Array) -> None:
            if where.any():
                own = rows(info, where)
                columns = [column for key in keys for column in _cells(own[key]).reshape(where.sum(), -1).T]
                table.add({"world": own["world"], "episode": own["episode"], **dict(zip(names, columns, strict=True))})

        yield add
