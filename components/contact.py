"""Contacts and materials: components that a solid may have. They cost nothing in games without them."""

from typing import Any

from outlast.ecs import Array, Component, Event, Singleton, column, kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load_flags, to_bits

from .body import Solid

ALL = 0xFFFF  # a mask of all sixteen layers


class Filter(Component):
    """A filter of contacts: two solids touch if the layer of each is among the layers that the other hits.

    A solid without this component is in layer 1 and hits all. It passes through solids that it does not hit, but
    nothing leaves the room. A solid in layer 0, or that hits 0, touches nothing.

    Filter(sensor=1) is clear unless clear=0 is given. A system that makes a solid a sensor in a tick writes both.
    """

    requires = (Solid,)
    layer: Array = column("u2", fill=1)  # bit mask of its layers
    hits: Array = column("u2", fill=ALL)  # bit mask of the layers that it hits
    sensor: Array = column("u1", high=1)  # 1: it touches without pushing: solids pass through it
    clear: Array = column("u1", high=1)  # 1: sight, rays of lidar and strikes pass through it

    def __init__(self, **fills: Any) -> None:
        super().__init__(**({"clear": fills["sensor"]} if "sensor" in fills else {}) | fills)


class Material(Component):
    """The material of a solid. -1, and solids without this component, stand for the numbers of physics.

    A contact has the geometric mean of both frictions, and the larger restitution.
    """

    requires = (Solid,)
    friction: Array = column("f4", fill=-1)  # coefficient
    restitution: Array = column("f4", fill=-1)  # 0: it stops, 1: it bounces off at the same speed
    linear_damping: Array = column("f4", fill=-1)  # per second
    angular_damping: Array = column("f4", fill=-1)  # per second


class Driven(Component):
    """A static solid that moves at the velocity of its body, unaffected by contacts: a door, a moving wall.

    It pushes dynamic solids, and is never pushed. It passes through static solids, and may leave the room.
    """

    requires = (Solid,)


class Touch(Event, capacity="touches", who="solid", whom="other"):
    """Two solids touched in this tick, in order of rows. Filled by physics in games with the mechanic Contacts."""

    solid: Array = column("i4", unit="entity")  # the solid with the smaller row
    other: Array = column("i4", unit="entity")
    x: Array = column("f4", unit="metres")  # the point of the strongest push; for a sensor, the middle of the other
    y: Array = column("f4", unit="metres")
    impulse: Array = column("f4", unit="newton-seconds")  # of the push that separates them; 0 for sensors
    began: Array = column("u1")  # 1: they did not touch in the previous tick


class Touching(Singleton):
    """The solids that touched in the last tick, in order of rows. Written by physics."""

    count: Array = column("i4")
    solid: Array = column("i4", "touches", unit="entity")
    other: Array = column("i4", "touches", unit="entity")


@kernel
def hits(filters: Any, filtered: Any, e: int, o: int) -> bool:
    """Return whether solid `o` is in a layer that solid `e` hits. See `pushes`."""
    mask = int(filters.hits[e]) if filtered[e] >= 0 else ALL
    return (mask & (int(filters.layer[o]) if filtered[o] >= 0 else 1)) != 0


@kernel
def pushes(filters: Any, filtered: Any, e: int, o: int) -> bool:
    """Return whether two solids would push each other if they touched.

    Args:
        filters: The table `Read[Filter] | None`.
        filtered: `RowIndex[Filter] | None`.
        e: The row of a solid.
        o: The row of another solid.
    """
    if filters is None:
        return True
    if filters.sensor[e] or filters.sensor[o]:
        return False
    return hits(filters, filtered, e, o) and hits(filters, filtered, o, e)


@kernel
def clear_bits(filters: Any, b: int) -> int:
    """Return the bitset of clear rows of block `b`. filters: the table `Read[Filter] | None`."""
    if filters is None:
        return 0
    return int(to_bits(load_flags(filters.clear, SIMD_WIDTH * b)))


@kernel
def is_clear(filters: Any, e: int) -> bool:
    """Return whether sight, rays and strikes pass through solid `e`. filters: as for `clear_bits`."""
    if filters is None:
        return False
    return bool(filters.clear[e])


@kernel
def fix(solid: Any, body: Any, e: int) -> None:
    """Make solid `e` static: nothing moves it until `free`."""
    solid.dynamic[e] = 0
    body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0


@kernel
def free(solid: Any, e: int) -> None:
    """Make solid `e` dynamic: solids that touch it can push it."""
    solid.dynamic[e] = 1
