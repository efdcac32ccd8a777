"""Spaces, built from what the scenario's components declare."""

from typing import Any

import numpy as np
from gymnasium import spaces

from outlast.ecs import Action, Column, Component, Observation, Statistic, Worlds

LARGEST = float(np.finfo(np.float32).max)  # where a column has no bound: libraries want finite ones


def published(worlds: Worlds, base: type[Component]) -> list[tuple[str, type[Component], str, Column]]:
    """(key, component, column name, column) of all columns of a kind, in order of their keys' components.

    Actions come in the order that their components declare; everything else in order of keys.
    """
    found = [
        (column.key or name, component, name, column)
        for component in worlds.components
        if issubclass(component, base)
        for name, column in component.columns.items()
    ]
    if base is Action:
        return sorted(found, key=lambda entry: worlds.layout.actions.index((entry[1], entry[2])))
    return sorted(found, key=lambda entry: entry[0])


def observation_space(worlds: Worlds) -> spaces.Dict:
    """What all agents of one world see: key -> Box float32 of shape (agents, ...)."""
    return spaces.Dict(
        {
            key: spaces.Box(
                max(column.low, -LARGEST), min(column.high, LARGEST), component.row_shape(name, worlds.dims), np.float32
            )
            for key, component, name, column in published(worlds, Observation)
        }
    )


def action_space(worlds: Worlds) -> spaces.MultiDiscrete:
    """What all agents of one world do: MultiDiscrete of shape (agents, actions), (3, 3, 3, 2, 2, 2) in the paper."""
    sizes = [int(column.high - column.low) + 1 for _, _, _, column in published(worlds, Action)]
    return spaces.MultiDiscrete(np.tile(sizes, (worlds.dims["agents"], 1)))


def statistics(worlds: Worlds, where: np.ndarray[Any, Any]) -> dict[str, np.ndarray[Any, Any]]:
    """Copies of the episode statistics; rows of worlds that are not `where` are zero. Shapes (worlds,) or (worlds, n).

    A column with one entry a cause of harm becomes one key for each: "deaths_zone".
    """
    result = {}
    for key, component, name, column in published(worlds, Statistic):
        values = np.where(where[:, None], getattr(worlds[component], name), 0)
        if column.dims == ("causes",):
            result.update({f"{key}_{cause}": values[:, k] for k, cause in enumerate(worlds.layout.causes)})
        else:
            result[key] = values if column.dims else values[:, 0]
    return result
