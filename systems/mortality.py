"""Mortality: the limit of health, and the death of agents without any."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Death, Died, Health, Hit, Kills, Phase, Score, SelfView, Side
from outlast.components.health import MOST, fatal_agent, full_health
from outlast.ecs import (
    Clock,
    Entity,
    Field,
    Layout,
    Module,
    NumberError,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    emit,
    number,
    of,
)

from .observation_rows import observe


@dataclass(frozen=True)
class Mortality(Module):
    """Agents whose health is 0 or less at the check despawn and count as dead (paper, section 3.1).

    limit: the maximum hit points of an agent after items have had their effect; 0: no maximum, as in the paper, which
    names this as its first flaw (section 5): using a heal as soon as it is found has no cost.
    """

    limit: int = number(
        0, low=0, high=MOST, per_agent=True, unit="hit points", about="the most that an agent can have; 0: no maximum"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Death(), Hit(), Kills()]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("health", "hit points", scale=full_health, order=-1),)}  # behind id and team

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        """Return bounds without a lower end: damage may exceed health, and is observed before deaths."""
        return {"own": {"health": (-math.inf, self.limit or math.inf)}}

    def check(self, layout: Layout) -> None:
        prefab = layout.prefab_values(Health, "points").get("agent", 0)
        if self.limit and prefab > self.limit:
            raise NumberError(f"mortality.limit = {self.limit}: agents begin with {prefab}; take at least as many")


observe(Mortality, SelfView, "own", Side, health=Health.points)


@Mortality.system(Phase.RESPAWN)
def clear_deaths(died: Write[Died], agents: Rows[Died]) -> None:
    """Clear `Died.now` of the previous tick."""
    for e in agents:
        died.now[e] = 0


@Mortality.system(Phase.EFFECT, after=Health)
def cap(health: Write[Health], agents: Rows[Died, Health], limit: int) -> None:
    """Cut health to the limit."""
    for e in agents:
        if of(limit, e) > 0:
            health.points[e] = min(health.points[e], np.int32(of(limit, e)))


@Mortality.system(Phase.DIE)
def die(
    died: Write[Died],
    deaths: Write[Death],
    entities: Write[Entity],
    health: Read[Health],
    hits: Read[Hit],
    clock: Read[Clock],
    agents: Rows[Died, Health],
) -> None:
    """Despawn agents without health, and record the source and the type of the damage."""
    for e in agents:
        if entities.alive[e] and health.points[e] <= 0:
            entities.alive[e] = 0
            died.now[e] = 1
            died.damage_type[e] = health.damage_type[e]
            died.source[e] = health.source[e]
            k = emit(deaths)
            deaths.agent[k], deaths.by[k] = e, fatal_agent(health, hits, e, clock.tick[0])
            deaths.damage_type[k], deaths.side[k] = health.damage_type[e], health.source[e]


@Mortality.system(Phase.RECORD)
def count(
    kills: Write[Kills], score: Read[Score] | None, deaths: Read[Death], clock: Read[Clock], agents: RowIndex[Side]
) -> None:
    """Add kills by side, deaths by cause, and the tick of the first death to the statistics of the episode."""
    if score is not None:
        for s in range(score.kills.size):
            kills.kills[s] += score.kills[s]
    for k in range(deaths.count[0]):
        if agents[deaths.agent[k]] < 0:
            continue
        if deaths.damage_type[k] >= 0:
            kills.deaths[deaths.damage_type[k]] += 1
        if kills.first_death[0] == 0:
            kills.first_death[0] = clock.tick[0]
