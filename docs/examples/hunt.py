"""Unequal sides: one strong hunter against all others."""

from dataclasses import dataclass

import numpy as np

import outlast
from outlast.components import Guard, Health, Hit, Phase, Side, Weapon
from outlast.components.health import hurt
from outlast.ecs import Clock, DamageType, Layout, NumberError, Read, Rows, Write, number
from outlast.systems import Melee, Teams

HUNTERS = 0  # their side; the prey is side 1


@dataclass(frozen=True)
class Hunt(Teams):
    """Two teams: the first agents are hunters, with hit points of their own."""

    hunters: int = number(1, low=1)
    points: int = number(300, low=1, high=1_000_000, unit="hit points", about="of a hunter at the start")

    def check(self, layout: Layout) -> None:
        """There are two sides, and both have members."""
        agents = layout.dims["agents"]
        if self.count != 2 or self.hunters >= agents:
            asked = f"hunt.hunters = {self.hunters} of {agents} agents, hunt.count = {self.count} sides"
            raise NumberError(f"{asked}: two sides are needed, and at least one agent that is prey")


@Hunt.system(Phase.DRAW)
def split(
    side: Write[Side], guard: Write[Guard], health: Write[Health], agents: Rows[Side], hunters: int, points: int
) -> None:
    """In the place of the system of Teams that makes equal teams."""
    for i in range(agents.size):
        e = agents[i]
        side.side[e] = np.int32(i >= hunters)
        guard.immune_to[e] = side.side[e]
        if i < hunters:
            health.points[e] = points


@dataclass(frozen=True)
class Claws(Melee):
    """Melee in which hunters do other damage than their prey."""

    hunters_damage: int = number(20, low=0, high=1_000_000, unit="hit points")


@Claws.system(Phase.MELEE, after="claws.aim")
def strike(
    weapon: Read[Weapon],
    health: Write[Health],
    hits: Write[Hit],
    guard: Read[Guard],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Weapon],
    damage: int,
    hunters_damage: int,
    damage_type: DamageType,
) -> None:
    """In the place of the system of Melee that takes the same from everybody."""
    for me in agents:
        e = weapon.target[me]
        if e >= 0 and health.has_health[e]:
            amount = hunters_damage if side.side[me] == HUNTERS else damage
            hurt(health, guard, hits, e, amount, damage_type, side.side[me], clock.tick[0], me)


HUNT = outlast.Scenario(
    "hunt",
    outlast.variant("teams_2")
    .with_(Hunt(), Claws(blocked=True))
    .replace(n_agents=5, rewards_alive=0.0, rewards_dead=0.0, rewards_kill=10.0, rewards_death=-10.0)
    .modules,
    "one strong hunter against four; kills pay",
)
