"""A mechanic with items and bodies that outlast's own layers of pictures do not know."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Body, Item, Push, Shape, Solid, Spawned
from outlast.ecs import Archetype, Array, Component, Module, column


class Gem(Component):
    """An item."""

    worth: Array = column("i4")


@dataclass(frozen=True)
class Mine(Module):
    """Gems to be carried, a ball and a crate to be pushed, and a door that nothing can push."""

    def archetypes(self) -> Iterable[Archetype]:
        crate, door = (Shape(half_width=1.0, half_height=0.2) for _ in range(2))
        return [
            Archetype("big_gem", (Body(), Shape(radius=0.4), Spawned(), Item(), Gem()), 2),
            Archetype("ball", (Body(y=6), Push(), Shape(radius=0.8), Solid(dynamic=1)), 1),
            Archetype("crate", (Body(x=6, y=6), Push(), crate, Solid(dynamic=1)), 1),
            Archetype("door", (Body(y=-6), door, Solid(dynamic=0)), 1),
        ]
