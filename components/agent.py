"""Agents: their sides, and how observations describe them."""

from outlast.ecs import Array, Component, Observation, Singleton, column


class Side(Component):
    """The side an agent belongs to: its team, or in free-for-all its own index."""

    side: Array = column("i4", fill=-1)


class Sides(Singleton):
    """Whether agents play in teams."""

    teams: Array = column("u1")  # 1: sides are teams, 0: every agent for itself


class SelfView(Observation):
    """The observer's own row: id, [team], health, x, y, angle, vx, vy, omega; zeros after id and team once dead."""

    own: Array = column("f4", "agents", "features")


class OthersView(Observation):
    """The other agents in order of id, self left out; rows as in SelfView. Mask: 1 = visible."""

    others: Array = column("f4", "agents", "others", "features")
    others_mask: Array = column("f4", "agents", "others", low=0, high=1)
