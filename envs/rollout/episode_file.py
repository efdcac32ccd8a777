"""The statistics of single episodes: as arrays, and as a file with a row for each."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.ecs import Clock

from ..core.spaces import statistics
from ..core.vector_env import SurvivalVectorEnv
from .summary import column_names
from .table_file import table_file

Array = np.ndarray[Any, Any]


Ended = Callable[[Mapping[str, Any], Array], None]  # of rollout.local.rollout


def numbered(env: SurvivalVectorEnv) -> Callable[[Mapping[str, Any], Array], dict[str, Array]]:
    """What takes the episodes that count out of info["statistics"], given with their worlds, bool (worlds,).

    It returns `world`, `episode` (of the world, from 1) and all statistics by name, (episodes,) or (episodes, n).
    """
    clock, ahead = env.worlds[Clock], env.autoreset_mode is AutoresetMode.SAME_STEP  # where the next one has begun

    def rows(found: Mapping[str, Any], where: Array) -> dict[str, Array]:
        worlds = np.flatnonzero(where)
        numbers = {"world": worlds + env.first_world, "episode": clock.episode[worlds, 0].astype(np.int64) - ahead}
        return {**numbers, **{key: values[worlds] for key, values in found.items()}}

    return rows


@contextlib.contextmanager
def episode_file(path: str, env: SurvivalVectorEnv) -> Iterator[Ended]:
    """A new file for the episodes of a rollout, which is whole or not there.

    Columns are `world`, `episode` (of the world, from 1) and the statistics in alphabetical order; what has an entry an
    agent or side has a column for each, return_0, return_1. Rows are in the order in which episodes end.

    Args:
        path: NAME.csv.
        env: The environment.

    Yields:
        What adds a row for each episode that counts.

    Raises:
        UsageError: See table_file.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    names = [name for key in keys for name in column_names(key, none[key])]
    rows = numbered(env)
    with table_file(path, "episodes", ["world", "episode", *names]) as table:

        def add(found: Mapping[str, Any], where: Array) -> None:
            if where.any():
                own = rows(found, where)
                columns = [column for key in keys for column in own[key].reshape(where.sum(), -1).T]
                numbers = {name: own[name] for name in ("world", "episode")}
                table.add({**numbers, **dict(zip(names, columns, strict=True))})

        yield add
