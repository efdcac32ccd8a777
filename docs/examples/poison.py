"""Poison: an item that makes enemies near its user ill. Ill agents lose hit points in every tick, for a while."""

from dataclasses import dataclass
from typing import ClassVar

from outlast.components import Body, DamageType, Guard, Health, Hit, Item, Phase, SelfView, Shape, Side, Spawned
from outlast.components.body import PLACE
from outlast.components.health import hurt, immune
from outlast.ecs import (
    Add,
    Archetype,
    Array,
    Bitset,
    Clock,
    Component,
    Entity,
    Field,
    Module,
    Observation,
    Read,
    Rows,
    Statistic,
    Write,
    column,
    number,
    ref,
)
from outlast.systems.geometry.bodies import Bodies, near
from outlast.systems.observation_rows import more_fields, observe

# --- components


class Vial(Component):
    """An item full of poison."""

    strength: Array = column("i4")  # ticks for which it makes an agent ill


class Illness(Component):
    """How ill an agent is. Written by poison."""

    left: Array = column("i4")  # ticks until the agent is well again
    source: Array = column("i4", fill=-1)  # the row of the agent that used the vial


class VialView(Observation):
    """Vials on the ground, and the last slot of the bag if it holds one."""

    vials: Array = column("f4", "agents", "vials", fields=PLACE)
    vials_mask: Array = column("f4", "agents", "vials", low=0, high=1)
    vial_slot: Array = column("f4", "agents", 1, fields=(Field("strength", "ticks", scale=30.0),))
    vial_slot_mask: Array = column("f4", "agents", 1, low=0, high=1)


class VialsUsed(Statistic):
    """Vials used in this episode, by all agents."""

    vials_used: Array = column("i4")


# --- the mechanic: its numbers, and what it adds to the world


@dataclass(frozen=True)
class Poison(Module):
    """Vials lie around; an agent that uses one poisons all enemies within reach."""

    damage_type: ClassVar[str] = "poison"  # deaths by poison are counted as "deaths_poison"

    count: int = number(4, low=1, about="number of vials")
    radius: float = number(0.25, low=0.002, unit="metres", about="radius of a vial")
    reach: float = number(3.0, above=0, unit="metres", about="greatest distance to an enemy, from centre to centre")
    strength: int = number(30, low=1, unit="ticks", about="how long the illness lasts")
    damage: int = number(2, low=0, unit="hit points per tick", about="damage of the illness")

    def archetypes(self):
        """A new kind of item, and one more component for every agent."""
        vial = Body(), Shape(radius=ref("radius")), Spawned(), Item(), Vial(strength=ref("strength"))
        return [Archetype("vial", vial, ref("count")), Archetype("agent", (Illness(),))]

    def singletons(self):
        """What agents observe, what is counted, and what happens."""
        return [VialView(), VialsUsed(), Hit()]

    def dims(self):
        """The dimension "vials" of the columns above, and how many more hits there can be in a tick."""
        return {"vials": ref("count"), "hits": "agents"}

    def fields(self):
        """How ill agents are, in their own row and in its copies that the others see."""
        return {"own": ILLNESS}

    def bounds(self, layout):
        """No agent is ill for longer than a vial makes it. Positions of vials have no bounds here."""
        return {"own": {"illness": (0, self.strength)}}


# --- systems, each in its phase of the tick


@Poison.system(Phase.EFFECT, after=Body)
def spill(
    illness: Write[Illness],
    used: Add[VialsUsed],
    item: Read[Item],
    vial: Read[Vial],
    body: Read[Body],
    bodies: Bodies,
    side: Read[Side],
    guard: Read[Guard],
    agents: Bitset[Illness],
    vials: Rows[Vial],
    reach: float,
) -> None:
    """A used vial makes all agents near its user ill, but neither the user nor its team."""
    for e in vials:
        user = item.user[e]
        if user < 0:
            continue
        used.vials_used[0] += 1
        for k in range(near(bodies, agents, body.x[user], body.y[user], reach)):
            o = bodies.rows[k]
            x, y = body.x[o] - body.x[user], body.y[o] - body.y[user]
            if x * x + y * y <= reach * reach and o != user and not immune(guard, o, side.side[user]):
                illness.left[o], illness.source[o] = vial.strength[e], user


@Poison.system(Phase.MELEE, after="melee.strike")
def sicken(
    health: Write[Health],
    hits: Write[Hit],
    illness: Write[Illness],
    guard: Read[Guard],
    side: Read[Side],
    entities: Read[Entity],
    clock: Read[Clock],
    agents: Rows[Illness],
    damage: int,
    damage_type: DamageType,
) -> None:
    """The ill lose hit points; the agent that poisoned them did it, and its side is the source."""
    for e in agents:
        if entities.alive[e] and illness.left[e] > 0:
            illness.left[e] -= 1
            by = illness.source[e]
            hurt(health, guard, hits, e, damage, damage_type, side.side[by], clock.tick[0], by)


# --- what agents observe

observe(Poison, VialView, "vials", Vial, x=Body.x, y=Body.y)
observe(Poison, VialView, "vial_slot", Vial, strength=Vial.strength)
ILLNESS = more_fields(Poison, SelfView, "own", Side, illness=Illness.left)
