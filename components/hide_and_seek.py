"""Hide and seek: things that can be held, locked and climbed, and their use. Not part of the survival game."""

from outlast.ecs import Action, Array, Component, Event, Singleton, Statistic, column

from .body import Solid
from .masks import Idle

HIDERS, SEEKERS = 0, 1  # the sides
NOBODY = -1


class Movable(Component):
    """A solid that agents can hold and lock: a crate, a plank or a ramp."""

    requires = (Solid,)
    locked_by: Array = column("i4", fill=NOBODY, unit="side")  # the side that has locked it; -1: none
    lockable: Array = column("u1", fill=1, high=1)
    start_x: Array = column("f4")  # metres, its position at the start of the episode
    start_y: Array = column("f4")


class Crate(Component):
    """A mark of crates and planks, absent in ramps."""


class Ramp(Component):
    """A mark of ramps: low where x is least in their own frame, high where it is most."""


class Aloft(Component):
    """Ticks for which an agent stays above walls and things."""

    ticks: Array = column("i4")  # 0: it is on the ground


class Handle(Action, order=2):
    """grab: 1 holds the nearest thing in reach, while it is 1. lock: 1 locks the nearest thing, -1 unlocks it."""

    grab: Array = column("i1", "agents", low=0, high=1)
    lock: Array = column("i1", "agents", low=-1, high=1)


class OutOfReach(Idle):
    """The agents that cannot hold a thing, and those that can neither lock nor unlock one."""

    grab: Array = column("u1", "agents", high=1)
    lock: Array = column("u1", "agents", high=1)


class Locked(Event, capacity="agents", who="agent", whom="thing"):
    """A thing was locked, or unlocked."""

    agent: Array = column("i4", unit="entity")
    thing: Array = column("i4", unit="entity")
    locked: Array = column("u1")  # 1: locked, 0: unlocked


class Climbed(Event, capacity="agents", who="agent", whom="ramp"):
    """An agent has left the ground by a ramp."""

    agent: Array = column("i4", unit="entity")
    ramp: Array = column("i4", unit="entity")


class Doors(Singleton):
    """The middles of the doors of a quadrant."""

    open: Array = column("u1", "doors")  # 1: a door, 0: a wall
    x: Array = column("f4", "doors")  # metres
    y: Array = column("f4", "doors")


class Tracked(Statistic):
    """Statistics that the published environments record (TrackStatWrapper), and the use of things.

    Moments: the end of the preparation, and the end of the episode.
    """

    ticks_seen: Array = column("i4")  # after the preparation, in which a seeker saw some hider
    held: Array = column("i4", "sides")  # ticks, summed over agents, in which they held something
    locks: Array = column("i4", "sides")  # number of locks
    unlocks: Array = column("i4", "sides")
    climbs: Array = column("i4", "sides")
    crates_moved: Array = column("f4", "moments")  # metres, of the crate or plank that is farthest from its start
    ramps_moved: Array = column("f4", "moments")
    crates_locked: Array = column("i4", "moments")
    ramps_locked: Array = column("i4", "moments")
    doors_closed: Array = column("i4", "moments")  # doors in which a thing stands, in the way of agents
