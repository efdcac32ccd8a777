"""The melee: a segment straight ahead; it hurts what it touches."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from outlast.components import Attack, Body, Guard, Health, Phase, Shape, Side, Weapon
from outlast.components.health import MOST, hurt, immune
from outlast.ecs import (
    Archetype,
    Bitset,
    Clock,
    DamageType,
    Entity,
    Module,
    Read,
    Rows,
    Scratch,
    Singleton,
    Write,
    number,
)

from .inner.geometry import MISS, enters
from .inner.sweep import GROUP, SET, across, enclose, make_extent, make_groups, populated, row, without


@dataclass(frozen=True)
class Melee(Module):
    """Attack (paper, section 3.1).

    blocked: the strike ends at the first body of any kind on the segment, as in the paper's runs; otherwise it goes on
    to the nearest one that it can hurt (reference rules, section 6, point 2).
    """

    damage_type: ClassVar[str] = "melee"

    reach: float = number(2.0, above=0)  # metres from the agent's centre
    damage: int = number(5, low=0, high=MOST)  # hit points
    cooldown: int = number(0, low=0)  # ticks without attack after one that met something; 0: every tick
    blocked: bool = number(False)

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Weapon(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Attack()]

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return make_extent(dims) if name == "extent" else make_groups(dims)


@Melee.system(Phase.MELEE)
def aim(
    weapon: Write[Weapon],
    attack: Read[Attack],
    body: Read[Body],
    shape: Read[Shape],
    health: Read[Health],
    guard: Read[Guard],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Weapon],
    bodies: Bitset[Shape],
    extent: Scratch,
    groups: Scratch,
    reach: float,
    cooldown: int,
    blocked: bool,
) -> None:
    """All rays are cast before any damage is dealt, so two agents can kill each other."""
    crowd, count = enclose(extent, body, shape), populated(groups, entities, bodies)
    for i in range(agents.size):
        me = agents[i]
        weapon.target[me] = -1
        if not entities.alive[me]:
            continue
        if weapon.wait[me] > 0:
            weapon.wait[me] -= 1
            continue
        if not attack.attack[i]:
            continue
        x, y, dx, dy = body.x[me], body.y[me], reach * body.cosine[me], reach * body.sine[me]
        nearest = MISS
        for k in range(count):
            g = groups[GROUP, k]
            left = without(groups[SET, k] & across(crowd, g, x, y, dx, dy), g, me)
            while left:
                e = row(g, left)
                left &= left - 1
                if not (blocked or (health.mortal[e] and not immune(guard, e, side.side[me]))):
                    continue
                at = enters(body, shape, x, y, dx, dy, e)
                if at < nearest:
                    nearest = at
                    weapon.target[me] = e
        if weapon.target[me] >= 0:
            weapon.wait[me] = np.int32(cooldown)


@Melee.system(Phase.MELEE, after="melee.aim")
def strike(
    weapon: Read[Weapon],
    health: Write[Health],
    guard: Read[Guard],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Weapon],
    damage: int,
    cause: DamageType,
) -> None:
    """Targets with health lose some; the blame is the attacker's side's."""
    for me in agents:
        e = weapon.target[me]
        if e >= 0 and health.mortal[e]:
            hurt(health, guard, e, damage, cause, side.side[me], clock.tick[0])
