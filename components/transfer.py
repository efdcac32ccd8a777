"""Transfer tests of hide and seek: what their mechanics remember, mark and record."""

from outlast.ecs import Array, Component, Singleton, Statistic, column


class Errand(Singleton):
    """The next thing to do: lock a crate, or come back."""

    crate: Array = column("i4", unit="entity")  # the next one to lock; -1: all are locked
    locked: Array = column("i4")  # crates that are locked
    way: Array = column("f4")  # metres from the agent to that crate, or to where it has begun; 0: nothing is left to do
    x: Array = column("f4")  # metres, where the agent has begun
    y: Array = column("f4")


class Target(Component):
    """A mark of what has to be sheltered."""


class Parade(Singleton):
    """The tick in which each crate leaves, and the side of the agent to which it goes."""

    tick: Array = column("i4", "crates")
    side: Array = column("i1", "crates")  # 1: to its left, -1: to its right


class Passed(Statistic):
    """The statistic of object counting."""

    went_left: Array = column("i4")  # crates that have begun to go to the left of the agent


class Solved(Statistic):
    """The statistic of tasks: for how long they were done."""

    solved: Array = column("i4")  # ticks
