"""Respawn: agents that died return at a free place."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Died, Floor, Health, Phase, Respawned, Respawns, Return, Shape, Solid
from outlast.components.limits import TICKS
from outlast.ecs import (
    Add,
    Archetype,
    Array,
    Clock,
    Entity,
    Layout,
    Module,
    NumberError,
    Random,
    Read,
    Rows,
    Singleton,
    Write,
    emit,
    exists,
    kernel,
    number,
    of,
)
from outlast.ecs.kernels.random import uniform2

from .geometry.broad_phase import gap

TRIES = 32  # maximum places tried for an agent in a tick
INDEX = 0xFFFFFFFF  # the part of an identity that numbers the entities of a kind
HALF, ZERO = np.float32(0.5), np.float32(0)


@dataclass(frozen=True)
class Respawn(Module):
    """Agents return `ticks` ticks after their death: at rest, with their initial hit points.

    Their place is drawn uniformly among free places. If none of 32 draws is free, they wait another tick. Items that
    they dropped are not returned. Since deaths are not final, episodes end at their limit: ending_rule = "never".
    """

    ticks: int = number(100, low=1, high=TICKS, per_agent=True, unit="ticks", about="time from death to return")

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Return(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Respawned(), Respawns()]

    def check(self, layout: Layout) -> None:
        if layout.numbers("ending").get("rule", "never") != "never":
            raise NumberError(
                "respawn: agents return, so the death of a side does not end an episode: take "
                'replace(ending_rule="never", ending_limit=1000), or another number of ticks'
            )


@Respawn.system(Phase.SPAWN)
def keep_health(back: Write[Return], health: Read[Health], agents: Rows[Return]) -> None:
    """Record the hit points with which the episode begins."""
    for e in agents:
        back.health[e] = health.points[e]


@kernel
def is_free(body: Array, shape: Array, entities: Array, solids: Array, e: int) -> bool:
    """Return whether `e` touches nothing at its place."""
    for o in solids:
        if o != e and entities.alive[o] and gap(body, shape, e, o) <= ZERO:
            return False
    return True


@Respawn.system(Phase.RESPAWN, after=(Died, Entity))
def come_back(
    back: Write[Return],
    body: Write[Body],
    entities: Write[Entity],
    health: Write[Health],
    died: Write[Died],
    events: Write[Respawned],
    count: Add[Respawns],
    shape: Read[Shape],
    floor: Read[Floor],
    clock: Read[Clock],
    agents: Rows[Return],
    solids: Rows[Solid],
    key: Random,
) -> None:
    """Bring back the agents whose tick of return has come, in order of agents."""
    for e in agents:
        if back.tick[e] < 0 or back.tick[e] > np.int64(clock.tick[0]) or not exists(entities, e):
            continue
        for k in range(TRIES):
            x, y = uniform2(key, (entities.identity[e] & INDEX) * TRIES + k)
            body.x[e], body.y[e] = floor.size[0] * (x - HALF), floor.size[floor.size.size - 1] * (y - HALF)
            if is_free(body, shape, entities, solids, e):
                revive(body, health, died, e)
                health.points[e] = back.health[e]
                entities.alive[e], back.tick[e] = 1, -1
                count.respawns[0] += 1
                n = emit(events)
                events.agent[n] = e
                break


@kernel
def revive(body: Array, health: Array, died: Array, e: int) -> None:
    """Revive an agent: at rest, facing +x, its death forgotten."""
    body.angle[e], body.cosine[e], body.sine[e] = 0, 1, 0
    body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0
    health.damage_type[e], health.source[e], health.fatal_tick[e] = -1, -1, -1
    died.damage_type[e], died.source[e] = -1, -1


@Respawn.system(Phase.DIE, after=Died)
def wait(back: Write[Return], died: Read[Died], clock: Read[Clock], agents: Rows[Return], ticks: int) -> None:
    """Set the tick of return of agents that died in this tick."""
    for e in agents:
        if died.now[e]:
            back.tick[e] = np.int64(clock.tick[0]) + of(ticks, e)
