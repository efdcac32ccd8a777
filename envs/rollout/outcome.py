"""Who wins an episode."""

from typing import Any

import numpy as np

from outlast.components import Score
from outlast.ecs import Worlds

Array = np.ndarray[Any, Any]


def living_sides(worlds: Worlds) -> Array:
    """Return which sides have a living member, bool (worlds, sides). A side lives in ticks at whose end it has one."""
    return np.asarray(worlds[Score].alive > 0)


def own_wins(life: Array, own: Array) -> Array:
    """Return whether one side of each world wins against all others; see `wins`.

    Args:
        life: Ticks that each side lived, (worlds, sides).
        own: The one side of each world, (worlds,).

    Returns:
        float64 (worlds,): 1 where it wins, 0 where another side does, 0.5 for a draw.
    """
    mine = own[:, None] == np.arange(life.shape[1])
    best: Array = wins(np.stack([np.where(mine, life, 0).max(1), np.where(mine, 0, life).max(1)], 1))[:, 0]
    return best


def shares_outlived(life: Array, own: Array, sides: Array) -> Array:
    """Return the share of the other sides that one side of each world outlived.

    For sides that play equally well it is 1/2 on average, whatever their number; for two sides it is `own_wins`.

    Args:
        life: Ticks that each side lived, (worlds, sides).
        own: The one side of each world, (worlds,).
        sides: How many sides each world has, at least 2, (worlds,); those beyond are absent.

    Returns:
        float64 (worlds,): the share; a side that ended at the same time counts half.
    """
    number = np.arange(life.shape[1])
    others = (number < sides[:, None]) & (number != own[:, None])
    outlived = (1 + np.sign(np.take_along_axis(life, own[:, None], 1) - life)) / 2
    share: Array = (outlived * others).sum(1) / others.sum(1)
    return share


def wins(life: Array) -> Array:
    """Return who wins: the role whose longest-lived side lives longer.

    Args:
        life: Ticks that the longest-lived side of each role lived, (..., roles).

    Returns:
        float64 of the same shape: 1 for the winner, 0 for the other role, 0.5 for both in a draw.
    """
    return np.asarray((1 + np.sign(life - life[..., ::-1])) / 2)
