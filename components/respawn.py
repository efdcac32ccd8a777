"""The return of agents that died."""

from outlast.ecs import Array, Component, Event, Statistic, column


class Return(Component):
    """When an agent that is dead comes back, and with how many hit points."""

    tick: Array = column("i8", fill=-1)  # of the episode; -1: it does not
    health: Array = column("i4")  # hit points: what it began the episode with


class Respawned(Event, capacity=Return, who="agent"):
    """An agent that came back."""

    agent: Array = column("i4", unit="entity")


class Respawns(Statistic):
    """Times that agents came back in this episode."""

    respawns: Array = column("i4")
