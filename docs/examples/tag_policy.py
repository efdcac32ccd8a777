"""A scripted policy for tag: the agent that is it runs after the nearest other one, and all others run away from it."""

import numpy as np

from outlast.ecs import columns_of

# the highest level of Steering; metres within which to run away, and to strike or use a shield
FULL, NEAR, CLOSE = 3, 4.0, 1.5


def chase(env):
    """Make the policy. It reads the fields of rows by name, as their places depend on the scenario."""
    fields = env.fields["own"]
    place = columns_of(fields, "x", "y")
    it, angle, shield = (columns_of(fields, name) for name in ("it", "angle", "has_shield"))

    def policy(observations):
        own, others = observations["own"], observations["others"]
        chasing = own[..., it] > 0
        ways = others[..., place] - own[..., None, place]  # (worlds, agents, others, 2)
        far = np.where(chasing[..., None] | (others[..., it] > 0), np.hypot(ways[..., 0], ways[..., 1]), np.inf)
        nearest = far.argmin(-1)[..., None]
        far = np.take_along_axis(far, nearest, -1)[..., 0]
        x, y = np.moveaxis(np.take_along_axis(ways, nearest[..., None], -2)[..., 0, :], -1, 0)
        bearing = np.arctan2(y, x) - own[..., angle]
        speed = np.where(chasing, FULL, -FULL * (far < NEAR))  # agents that stand still get their breath back
        motion = np.rint([speed * np.cos(bearing), speed * np.sin(bearing), FULL * np.sin(bearing)])
        strike, use = chasing & (far < CLOSE), ~chasing & (far < CLOSE) & (own[..., shield] > 0)
        return np.stack([*(FULL + motion), strike, use], -1).astype(int)  # in the order of env.action_columns

    return policy
