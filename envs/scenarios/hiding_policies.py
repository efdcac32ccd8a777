"""The scripted policy of hide and seek: the opponent of `play` and `evaluate` where none is named."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from outlast.components.hide_and_seek import SEEKERS
from outlast.ecs import columns_of

FULL = 3  # the highest level of Steering
NEAR, BESIDE = 2.5, 0.8  # metres from a seeker within which a hider flees, and from a crate within which it is reached


def scripted(env: Any) -> Callable[[Mapping[str, Any]], Any]:
    """Make a policy: seekers run after the nearest hider that they see, and otherwise along the longest ray of lidar.

    Hiders run from seekers that are near; else they go to the nearest crate that they see, hold it, and lock it.
    Without lidar, an agent that sees no others turns.
    """
    own, others, crates = (env.fields[key] for key in ("own", "others", "crates"))
    place, team, angle, holds = (columns_of(own, *names) for names in (("x", "y"), ("team",), ("angle",), ("holds",)))
    theirs, their_team = columns_of(others, "x", "y"), columns_of(others, "team")
    lies, locked = columns_of(crates, "x", "y"), columns_of(crates, "locked")
    rays = env.scenario.numbers().get("lidar_rays", 0)
    beams = (np.arange(rays) + 0.5) * 2 * np.pi / max(rays, 1) - np.pi  # from right to left

    def nearest(me: Any, there: Any, counts: Any) -> tuple[Any, Any]:
        """Return the way to the nearest of several places that count, (..., 2), and its length, inf if none does."""
        if there.shape[-2] == 0:
            return np.zeros_like(me), np.full(me.shape[:-1], np.inf)
        ways = there - me[..., None, :]
        far = np.where(counts > 0, np.hypot(ways[..., 0], ways[..., 1]), np.inf)
        first = far.argmin(-1)[..., None]
        way = np.take_along_axis(ways, first[..., None], -2)[..., 0, :]
        return way, np.take_along_axis(far, first, -1)[..., 0]

    def policy(observations: Mapping[str, Any]) -> Any:
        mine, peers, things = (observations[key] for key in ("own", "others", "crates"))
        me, seeks = mine[..., place], mine[..., team] == SEEKERS
        enemies = (peers[..., their_team] == SEEKERS) != seeks[..., None]
        way, far = nearest(me, peers[..., theirs], observations["others_mask"] * enemies)
        to_crate, crate_far = nearest(me, things[..., lies], observations["crates_mask"] * (things[..., locked] == 0))
        fetches = ~seeks & (far > NEAR) & np.isfinite(crate_far)
        x, y = np.moveaxis(np.where(fetches[..., None], to_crate, way), -1, 0)
        bearing = np.arctan2(y, x) - mine[..., angle]
        flees = ~seeks & (far <= NEAR)
        lost = ~np.isfinite(far) & ~fetches
        if rays:
            ahead = beams[(observations["lidar"] - 0.5 * np.abs(beams)).argmax(-1)]
            bearing = np.where(lost, ahead, bearing)
        speed = np.where(flees, -FULL, FULL) * ~(lost & ((rays == 0) | ~seeks))
        turn = np.where(lost & ~seeks, FULL, FULL * np.sin(bearing))
        motion = np.rint([speed * np.cos(bearing), speed * np.sin(bearing), turn])
        reached = fetches & (crate_far < BESIDE)
        lock = reached & (mine[..., holds] > 0)
        return np.stack([*(FULL + motion), reached | (mine[..., holds] > 0), 1 + lock], -1).astype(int)

    return policy
