"""The return of agents that died."""

from outlast.ecs import Array, Clock, Component, Entity, Event, Statistic, WorldsView, column


class Return(Component):
    """The tick in which a dead agent comes back, and its hit points then."""

    tick: Array = column("i8", fill=-1)  # tick of the episode in which it comes back; -1: it does not
    health: Array = column("i4")  # the hit points with which it began the episode


def inactive(worlds: WorldsView) -> Array:
    """Return which agents do nothing in the next tick, whatever their actions: dead or absent, and not coming back.

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
    """An agent came back."""

    agent: Array = column("i4", unit="entity")


class Respawns(Statistic):
    """The number of times that agents came back in this episode."""

    respawns: Array = column("i4")
