"""A file of episodes: a row for each, with all of its statistics."""

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


@contextlib.contextmanager
def episode_file(path: str, env: SurvivalVectorEnv) -> Iterator[Callable[[Mapping[str, Any], Array], None]]:
    """A new file for the episodes of a rollout, which is whole or not there.

    Columns are `world`, `episode` (of the world, from 1) and the statistics in alphabetical order; what has an entry an
    agent or side has a column for each, return_0, return_1, which is empty where the episode had no such agent or side.
    Rows are in the order in which episodes end.

    Args:
        path: NAME.csv.
        env: The environment.

    Yields:
        What adds a row for each episode that counts: `ended` of rollout.local.rollout.

    Raises:
        UsageError: See table_file.
    """
    none = statistics(env.worlds, np.zeros(env.num_worlds, bool))
    keys = sorted(none)
    names = [name for key in keys for name in column_names(key, none[key])]
    clock, ahead = env.worlds[Clock], env.autoreset_mode is AutoresetMode.SAME_STEP  # where the next one has begun
    with table_file(path, "episodes", ["world", "episode", *names]) as table:

        def add(info: Mapping[str, Any], where: Array) -> None:
            if where.any():
                there = info.get("statistics_present", {})
                found = {
                    key: np.where(there[key], values.astype(object), "") if key in there else values
                    for key, values in info["statistics"].items()
                }
                columns = [column for key in keys for column in np.reshape(found[key][where], (where.sum(), -1)).T]
                rows = np.flatnonzero(where)
                numbers = {"world": rows + env.first_world, "episode": clock.episode[rows, 0] - ahead}
                table.add({**numbers, **dict(zip(names, columns, strict=True))})

        yield add
