"""Descriptors of each agent's behaviour in an episode, for searches and curricula."""

from outlast.ecs import Array, Singleton, Statistic, column


class Track(Singleton):
    """The basis of an agent's descriptors, updated in every tick. Written by behaviour."""

    x: Array = column("f4", "agents")  # metres, at the end of the last tick
    y: Array = column("f4", "agents")
    here: Array = column("u1", "agents")  # 1: it was alive then
    visited: Array = column("u1", "agents", "behaviour cells")  # 1: it was in this cell of the room's grid
    cells: Array = column("i4", "agents")  # number of visited cells
    enemies: Array = column("i4", "agents")  # ticks with an enemy alive
    mates: Array = column("i4", "agents")  # ticks with another agent of its side alive


class Condition(Singleton):
    """The hit points of agents, which determine whether they need a heal. Written by behaviour."""

    start: Array = column("i4", "agents")  # hit points at the start of the episode
    last: Array = column("i4", "agents")  # hit points at the end of the last tick in which it was alive


class Travelled(Statistic):
    """The life of each agent: its length, the way travelled, and the cells visited."""

    ticks_alive: Array = column("i4", "agents")  # ticks at whose end it was alive
    distance_travelled: Array = column("f8", "agents")  # metres
    cells_visited: Array = column("f8", "agents", low=0, high=1)  # share of the room's grid


class Encounters(Statistic):
    """The nearness of each agent to others, over the ticks at the end of which it was alive."""

    enemy_distance: Array = column("f8", "agents")  # mean metres to the nearest living enemy; 0: there never was one
    mate_distance: Array = column(
        "f8", "agents"
    )  # mean metres to the nearest living agent of its side; 0: there never was one
    enemy_in_view: Array = column("f8", "agents", low=0, high=1)  # share of ticks with an enemy in view


class Exposure(Statistic):
    """The time of each agent outside the safe zone."""

    outside_zone: Array = column("f8", "agents", low=0, high=1)  # share of ticks


class Aggression(Statistic):
    """The strikes of each agent."""

    strikes: Array = column("i4", "agents")
    strikes_landed: Array = column("f8", "agents", low=0, high=1)  # share of strikes that hit an enemy
    damage_dealt: Array = column("i4", "agents")  # hit points taken from enemies


class Care(Statistic):
    """The use of heals by each agent."""

    heals_in_need: Array = column("i4", "agents")  # heals used with few hit points left
    heals_given: Array = column("i4", "agents")  # heals given to others


class Cover(Statistic):
    """The use of boxes as cover by each agent."""

    boxes_between: Array = column("i4", "agents")  # boxes set up between it and the nearest enemy
