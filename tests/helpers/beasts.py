"""A mechanic with animals, which have hit points, and die, without being agents."""

from dataclasses import dataclass
from typing import Any

from outlast.components import Body, Death, Died, Guard, Health, Hit, Phase, Shape, Spawned
from outlast.components.health import hurt
from outlast.ecs import Archetype, Array, Clock, Component, Module, Read, Rows, Write, column, number, ref


class Beast(Component):
    age: Array = column("i4")


@dataclass(frozen=True)
class Beasts(Module):
    """Animals that starve."""

    count: int = number(2, low=1)
    order: int = number(60, low=0)  # of their rows; those of agents have 10

    def archetypes(self) -> Any:
        shape, life = Shape(radius=0.5, bound=0.5), Health(points=5)
        parts = (Body(), shape, life, Guard(), Died(), Spawned(), Beast())
        return [Archetype("beast", parts, ref("count"), order=self.order)]

    def singletons(self) -> Any:
        return [Hit(), Death()]

    def dims(self) -> Any:
        return {"hits": ref("count")}


@Beasts.system(Phase.MELEE, after=Health)
def starve(
    health: Write[Health], guard: Read[Guard], hits: Write[Hit], clock: Read[Clock], beasts: Rows[Beast]
) -> None:
    for e in beasts:
        if health.points[e] > 0:
            hurt(health, guard, hits, e, 1, 0, -1, clock.tick[0], -1)
