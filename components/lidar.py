"""Lidar: the surroundings of an agent, as distances along rays."""

from outlast.ecs import Array, Component, Field, Layout, Observation, column

RAYS = "rays"  # the name of the dimension


class Rays(Component):
    """An agent that has rays."""

    off: Array = column("u1")  # 1: the agent is blind, and all its rays read 0


def usual_depth(layout: Layout) -> float:
    """Return the scale of distances, metres."""
    return layout.numbers("lidar").get("depth") or 1.0


class LidarView(Observation):
    """Metres from each agent's centre to the hits of its rays, from right to left; zeros while it is dead or blind."""

    lidar: Array = column("f4", "agents", fields=(Field("distance", "m", low=0, scale=usual_depth, size=RAYS),))
