"""Mortality: who has no hit points left is gone."""

from dataclasses import dataclass

from outlast.components import Death, Health, Phase
from outlast.ecs import Entity, Module, Read, Rows, Write


@dataclass(frozen=True)
class Mortality(Module):
    """Agents whose health is 0 or less at the check despawn and count as dead (paper, section 3.1)."""


@Mortality.system(Phase.RESPAWN)
def forget(death: Write[Death], agents: Rows[Death]) -> None:
    """The deaths of the tick before are old news."""
    for e in agents:
        death.now[e] = 0


@Mortality.system(Phase.DIE)
def die(health: Read[Health], death: Write[Death], entities: Write[Entity], agents: Rows[Death, Health]) -> None:
    """Despawn, and track who did it and how."""
    for e in agents:
        if entities.alive[e] and health.points[e] <= 0:
            entities.alive[e] = 0
            death.now[e] = 1
            death.cause[e] = health.cause[e]
            death.source[e] = health.source[e]
