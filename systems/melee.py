"""The melee: a segment straight ahead; it damages what it hits."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from outlast.components import Attack, Body, DamageType, Filter, Guard, Health, Hit, Phase, Shape, Side, Strike, Weapon
from outlast.components.contact import is_clear
from outlast.components.health import MOST, hurt, immune
from outlast.components.limits import FAR, TICKS
from outlast.components.masks import of_agents
from outlast.components.melee import cooling
from outlast.components.respawn import inactive
from outlast.ecs import Archetype, Clock, Entity, Module, Read, Rows, Singleton, WorldsView, Write, emit, number, of

from .geometry.bodies import Bodies, on_ray
from .geometry.rays import NO_HIT, raycast_entity


@dataclass(frozen=True)
class Melee(Module):
    """Attack (paper, section 3.1).

    blocked: the strike ends at the first body of any kind on the segment, as in the paper's runs; otherwise at the
    nearest body that it can hurt (reference rules, section 6, point 2).
    """

    damage_type: ClassVar[str] = "melee"

    reach: float = number(
        2.0,
        above=0,
        high=FAR,
        per_agent=True,
        unit="metres",
        about="how far a strike goes, ahead from the agent's centre",
    )
    damage: int = number(5, low=0, high=MOST, per_agent=True, unit="hit points", about="damage of a strike")
    cooldown: int = number(
        0,
        low=0,
        high=TICKS,
        per_agent=True,
        unit="ticks",
        about="how long an agent cannot attack after a strike that hit something; 0: it can in every tick",
    )
    blocked: bool = number(False, about="a strike ends at the first body of any kind, not only at one that it can hurt")

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Weapon(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Attack(), Strike(), Hit()]

    def dims(self) -> dict[str, int | str]:
        return {"hits": "agents"}

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        return {"attack": inactive(worlds) | of_agents(cooling, worlds, Weapon)}


@Melee.system(Phase.MELEE)
def aim(
    weapon: Write[Weapon],
    strikes: Write[Strike],
    attack: Read[Attack],
    body: Read[Body],
    shape: Read[Shape],
    health: Read[Health],
    guard: Read[Guard],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Side, Weapon],
    filters: Read[Filter] | None,
    bodies: Bodies,
    reach: float,
    cooldown: int,
    blocked: bool,
) -> None:
    """Cast all rays before any damage is dealt, so that two agents can kill each other."""
    first = strikes.count[0]
    for i in range(agents.size):
        me = agents[i]
        weapon.target[me] = -1
        if cooling(weapon, me):  # ticks also pass for dead agents, which may return
            weapon.cooldown[me] -= 1
        elif entities.alive[me] and attack.attack[i]:
            k = emit(strikes)
            strikes.agent[k], strikes.target[k] = me, -1
    for n in range(first, strikes.count[0]):
        me = strikes.agent[n]
        x, y, far = body.x[me], body.y[me], of(reach, me)
        dx, dy = far * body.cosine[me], far * body.sine[me]
        nearest, target = NO_HIT, -1
        for k in range(on_ray(bodies, None, x, y, dx, dy)):
            e = bodies.rows[k]
            if (
                e == me
                or is_clear(filters, e)
                or not (blocked or (health.has_health[e] and not immune(guard, e, side.side[me])))
            ):
                continue
            at = raycast_entity(body, shape, x, y, dx, dy, e, bodies.polygons)
            if at < nearest:
                nearest, target = at, e
        weapon.target[me] = strikes.target[n] = target
        if target >= 0:
            weapon.cooldown[me] = np.int32(of(cooldown, me))


@Melee.system(Phase.MELEE, after="melee.aim")
def strike(
    weapon: Read[Weapon],
    health: Write[Health],
    hits: Write[Hit],
    guard: Read[Guard],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side, Weapon],
    damage: int,
    damage_type: DamageType,
) -> None:
    """Take hit points from targets that have health; the source is the attacker's side."""
    for me in agents:
        e = weapon.target[me]
        if e >= 0 and health.has_health[e]:
            hurt(health, guard, hits, e, of(damage, me), damage_type, side.side[me], clock.tick[0], me)
