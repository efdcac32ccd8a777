"""Bolts: a weapon whose shots take time. It replaces the melee: who attacks shoots, if the last bolt is gone."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from outlast.components import Attack, Body, DamageType, Guard, Health, Hit, Phase, Seconds, SelfView, Side
from outlast.components.body import half_room
from outlast.components.health import hurt
from outlast.ecs import (
    Archetype,
    Array,
    Clock,
    Component,
    Entity,
    Field,
    Module,
    Read,
    Rows,
    Singleton,
    Write,
    column,
    number,
)
from outlast.queries import Bodies, first_on_ray
from outlast.systems import Melee
from outlast.systems.observation_rows import observe


class Bolt(Component):
    """An agent's bolt. Written by bolts."""

    left: Array = column("f4")  # metres that it can still fly; 0: it is gone
    x: Array = column("f4")  # metres; 0 once it is gone
    y: Array = column("f4")
    cosine: Array = column("f4")  # of the direction in which it flies
    sine: Array = column("f4")


@dataclass(frozen=True)
class Bolts(Module):
    """A bolt flies straight ahead, ends at the first body of any kind, and hurts it."""

    damage_type: ClassVar[str] = "bolt"

    speed: float = number(12.0, above=0, unit="metres per second", about="how fast bolts fly")
    reach: float = number(8.0, above=0, unit="metres", about="how far bolts fly")
    damage: int = number(10, low=0, unit="hit points", about="damage of a bolt")

    @classmethod
    def slot(cls) -> type:
        """A scenario has one weapon."""
        return Melee.slot()

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Bolt(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Attack(), Hit()]

    def dims(self) -> dict[str, int | str]:
        return {"hits": "agents"}

    def fields(self):
        """Agents observe their own bolt, and those of agents that they see."""
        place = (Field(f"bolt_{axis}", "m", scale=half_room) for axis in "xy")
        return {"own": (Field("bolt_left", "m", scale=10.0), *place)}


@Bolts.system(Phase.MELEE)
def shoot(
    bolt: Write[Bolt], attack: Read[Attack], body: Read[Body], entities: Read[Entity], agents: Rows[Bolt], reach: float
) -> None:
    """Let the bolts of attackers begin at their centres."""
    for i in range(agents.size):
        e = agents[i]
        if attack.attack[i] and entities.alive[e] and bolt.left[e] == 0:
            bolt.left[e], bolt.x[e], bolt.y[e] = reach, body.x[e], body.y[e]
            bolt.cosine[e], bolt.sine[e] = body.cosine[e], body.sine[e]


@Bolts.system(Phase.MELEE, after="bolts.shoot")
def fly(
    bolt: Write[Bolt],
    health: Write[Health],
    hits: Write[Hit],
    guard: Read[Guard],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Bolt],
    bodies: Bodies,
    seconds: Seconds,
    speed: float,
    damage: int,
    damage_type: DamageType,
) -> None:
    """Move the bolts; each ends at the first body on its way, other than the one that shot it."""
    for e in agents:
        way = min(speed * seconds, bolt.left[e])
        x, y, dx, dy = bolt.x[e], bolt.y[e], way * bolt.cosine[e], way * bolt.sine[e]
        target, _ = first_on_ray(bodies, bodies.members, x, y, dx, dy, e)
        bolt.left[e] = bolt.left[e] - way if target < 0 else 0
        flies = bolt.left[e] > 0
        bolt.x[e], bolt.y[e] = x + dx if flies else 0, y + dy if flies else 0
        if target >= 0 and health.has_health[target]:
            hurt(health, guard, hits, target, damage, damage_type, side.side[e], clock.tick[0], e)


observe(Bolts, SelfView, "own", Side, bolt_left=Bolt.left, bolt_x=Bolt.x, bolt_y=Bolt.y)
