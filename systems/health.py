"""Mortality: how much health there can be, and who has none left is gone."""

from dataclasses import dataclass

import numpy as np

from outlast.components import Death, Health, Phase
from outlast.components.health import MOST
from outlast.ecs import Entity, Layout, Module, NumberError, Read, Rows, Write, number


@dataclass(frozen=True)
class Mortality(Module):
    """Agents whose health is 0 or less at the check despawn and count as dead (paper, section 3.1).

    limit: the most hit points that an agent keeps after items had their effect; 0: no maximum, as in the paper, which
    names that as its first flaw (section 5): nothing speaks against using a heal as soon as it is found.
    """

    name = "health"

    limit: int = number(0, low=0, high=MOST)  # hit points

    def check(self, layout: Layout) -> None:
        birth = layout.prefab_values(Health, "points").get("agent", 0)
        if self.limit and birth > self.limit:
            raise NumberError(f"health.limit = {self.limit}: agents are born with {birth}; take at least as many")


@Mortality.system(Phase.RESPAWN)
def forget(death: Write[Death], agents: Rows[Death]) -> None:
    """The deaths of the tick before are old news."""
    for e in agents:
        death.now[e] = 0


@Mortality.system(Phase.EFFECT, after="heals.cure")
def cap(health: Write[Health], agents: Rows[Death, Health], limit: int) -> None:
    """What is above the limit is lost."""
    if limit > 0:
        for e in agents:
            health.points[e] = min(health.points[e], np.int32(limit))


@Mortality.system(Phase.DIE)
def die(health: Read[Health], death: Write[Death], entities: Write[Entity], agents: Rows[Death, Health]) -> None:
    """Despawn, and track who did it and how."""
    for e in agents:
        if entities.alive[e] and health.points[e] <= 0:
            entities.alive[e] = 0
            death.now[e] = 1
            death.cause[e] = health.cause[e]
            death.source[e] = health.source[e]
