"""Teamwork: whether mates strike the same enemy, and use heals that one has fetched for the other; a mechanic."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Heal, Hit, Item, ItemUsed, Phase, Side
from outlast.ecs import (
    Archetype,
    Array,
    Clock,
    Component,
    Entity,
    Module,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Statistic,
    Write,
    column,
    number,
)


class LastHit(Singleton):
    """The latest hit of each agent on an enemy. Written by teamwork."""

    target: Array = column("i4", "agents")  # row of the enemy
    tick: Array = column("u8", "agents")  # 0: it has hit none yet


class Fetched(Component):
    """The agent that has picked up a heal, whoever carries it since then. Written by teamwork."""

    by: Array = column("i4", fill=-1, unit="entity")  # -1: it lies on the ground


class Fights(Statistic):
    """The damage of each agent while a mate fights and there is a choice of enemies."""

    damage_beside: Array = column("i4", "agents")  # hit points of enemies
    damage_focused: Array = column("i4", "agents")  # those of them that it took from the enemy that the mate has hit


class Supplies(Statistic):
    """The heals of each agent that others have fetched for it."""

    heals_of_mates: Array = column("i4", "agents")  # heals used that a mate had picked up


@dataclass(frozen=True)
class Teamwork(Module):
    """Statistics of what mates do together; nothing else in the game changes.

    A mate fights if its latest hit on an enemy was at most `within` ticks ago. There is a choice if, at the end of the
    tick, another enemy than the one that was hit is alive.
    """

    within: int = number(10, low=0, high=1000, unit="ticks", about="after its latest hit, a mate still fights")

    def archetypes(self) -> Iterable[Archetype]:
        """Declare what heals have in addition."""
        return [Archetype("heal", (Fetched(),))]

    def singletons(self) -> Iterable[Singleton]:
        """Declare the other columns that it writes."""
        return [LastHit(), Fights(), Supplies()]


@Teamwork.system(Phase.RECORD, needs=Hit)
def focus(
    fights: Write[Fights],
    last: Write[LastHit],
    hits: Read[Hit],
    side: Read[Side],
    entities: Read[Entity],
    clock: Read[Clock],
    agents: Rows[Side],
    index: RowIndex[Side],
    within: int,
) -> None:
    """Count the damage of this tick that agents did beside mates; of several hits of a mate in a tick, the last."""
    for k in range(hits.count[0]):
        me, target = hits.agent[k], hits.target[k]
        if me >= 0 and index[me] >= 0 and index[target] >= 0 and side.side[target] != side.side[me]:
            last.target[index[me]], last.tick[index[me]] = target, clock.tick[0]
    for k in range(hits.count[0]):
        me, target = hits.agent[k], hits.target[k]
        if me < 0 or index[me] < 0 or index[target] < 0 or side.side[target] == side.side[me]:
            continue
        choice, beside, focused = False, False, False
        for e in agents:
            j = index[e]
            if side.side[e] != side.side[me]:
                choice |= e != target and entities.alive[e] != 0
            elif e != me and last.tick[j] > 0 and clock.tick[0] <= last.tick[j] + within:
                beside, focused = True, focused or last.target[j] == target
        if choice and beside:
            fights.damage_beside[index[me]] += hits.amount[k]
            fights.damage_focused[index[me]] += focused * hits.amount[k]


@Teamwork.system(Phase.RECORD, needs=ItemUsed)
def fetch(
    supplies: Write[Supplies],
    fetched: Write[Fetched],
    uses: Read[ItemUsed],
    items: Read[Item],
    side: Read[Side],
    heals: Rows[Heal],
    index: RowIndex[Side],
) -> None:
    """Count the heals that agents used in this tick and mates had picked up, and record who carries new ones."""
    for k in range(uses.count[0]):
        me, other = uses.agent[k], fetched.by[uses.item[k]]
        if index[me] >= 0 and other >= 0 and other != me and side.side[other] == side.side[me]:
            supplies.heals_of_mates[index[me]] += 1
    for e in heals:
        if items.holder[e] < 0 or fetched.by[e] < 0:
            fetched.by[e] = items.holder[e]
