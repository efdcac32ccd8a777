"""The return of agents that died."""

from outlast.ecs import Array, Clock, Component, Entity, Event, Statistic, WorldsView, column


class Return(Component):
    """The tick in which a dead agent returns, and its hit points then."""

    tick: Array = column("i8", fill=-1)  # tick of its return in the episode; -1: none
    health: Array = column("i4")  # the hit points with which it began the episode


def inactive(worlds: WorldsView) -> Array:
    """Return whether actions of each agent have no effect in the next tick: it is dead or absent, and does not return.

    Returns:
        bool (worlds, agents), a new array.
    """
    agents = worlds.span("agent")
    found: Array = worlds[Entity].alive[:, agents] == 0
    if Return in worlds:
        back = worlds[Return].tick[:, agents]
        found &= (back < 0) | (back > worlds[Clock].tick + 1)
    return found


class Respawned(Event, capacity=Return, who="agent"):
    """An agent returned."""

    agent: Array = column("i4", unit="entity")


class Respawns(Statistic):
    """The number of returns of agents in this episode."""

    respawns: Array = column("i4")
