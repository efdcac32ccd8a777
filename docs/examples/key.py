"""A key and a door: whoever has picked the key up passes the door, for which it is a wall to all others."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Filter, Look, Phase, SelfView, Shape, Side, Solid
from outlast.components.contact import ALL
from outlast.ecs import Archetype, Array, Bitset, Component, Entity, Module, Read, Rows, Write, column
from outlast.queries import Bodies, nearest
from outlast.systems.observation_rows import more_fields

DOOR = 2  # the layer of the door


class Holder(Component):
    """Whether an agent has the key."""

    key: Array = column("u1", high=1)


class Key(Component):
    """What lies on the floor until somebody takes it."""


@dataclass(frozen=True)
class KeyAndDoor(Module):
    """The key is on the left of the door."""

    def archetypes(self):
        """The door is in a layer of its own."""
        door = Body(), Shape(half_width=0.1, half_height=6.0), Solid(), Filter(layer=DOOR)
        key = Body(x=-3.0, y=3.0), Shape(radius=0.2), Key()
        return [Archetype("agent", (Filter(), Holder())), Archetype("door", door, 1), Archetype("key", key, 1)]

    def fields(self):
        """Who has the key is seen."""
        return {"own": KEY}

    def looks(self):
        """A ring around who has the key."""
        return {"agent": Look(ring=Holder.key), "door": Look(color=(150, 90, 40)), "key": Look(color=(240, 200, 0))}


KEY = more_fields(KeyAndDoor, SelfView, "own", Side, key=Holder.key)


@KeyAndDoor.system(Phase.DRIVE, after=Body)
def take(
    holder: Write[Holder],
    filters: Write[Filter],
    entities: Write[Entity],
    body: Read[Body],
    keys: Rows[Key],
    agents: Bitset[Side],
    bodies: Bodies,
) -> None:
    """Who touches the key has it from now on."""
    for key in keys:
        e = nearest(bodies, agents, key, 0.0) if entities.alive[key] else -1
        if e >= 0:
            holder.key[e], filters.hits[e], entities.alive[key] = 1, ALL & ~DOOR, 0


KEY_AND_DOOR = yard("key_and_door", KeyAndDoor())
