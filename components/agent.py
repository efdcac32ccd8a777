"""Agents: who they are with, what they are told of themselves and of each other."""

from outlast.ecs import Array, Component, Observation, Singleton, column


class Side(Component):
    """Whom an agent fights for: its team, or in free-for-all itself. Written by sides at reset."""

    side: Array = column("i4", fill=-1)


class Sides(Singleton):
    """Whether agents fight in teams. Brought by sides."""

    teams: Array = column("u1")  # 1: sides are teams, 0: every agent for itself


class SelfView(Observation):
    """The observer's own row: id, [team], health, x, y, angle, vx, vy, omega; zeros after id and team once dead."""

    me: Array = column("f4", "agents", "features", key="self")


class OthersView(Observation):
    """The other agents in order of id, self left out; rows as in SelfView. Mask: 1 = seen."""

    others: Array = column("f4", "agents", "others", "features")
    others_mask: Array = column("f4", "agents", "others", low=0, high=1)
