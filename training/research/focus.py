"""Focus of fire: whether agents of a side that fight at the same time strike the same enemy; a mechanic that counts."""

from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Hit, Phase, Side
from outlast.ecs import Array, Clock, Entity, Module, Read, RowIndex, Rows, Singleton, Statistic, Write, column, number


class LastHit(Singleton):
    """The latest hit of each agent on an enemy. Written by focus."""

    target: Array = column("i4", "agents")  # row of the enemy
    tick: Array = column("u8", "agents")  # 0: it has hit none yet


class Teamwork(Statistic):
    """The damage of each agent in fights in which a mate takes part, and in which there are several enemies to hit."""

    damage_beside: Array = column("i4", "agents")  # hit points
    damage_focused: Array = column("i4", "agents")  # those of them that it took from the enemy that a mate has hit


@dataclass(frozen=True)
class Focus(Module):
    """Statistics of whom mates strike; nothing else in the game changes.

    A mate takes part in a fight if its latest hit on an enemy was at most `within` ticks ago. Damage counts only if,
    at the end of the tick, another enemy than the one that was hit is alive, so that there is a choice.
    """

    within: int = number(10, low=0, high=1000, unit="ticks", about="after its latest hit, a mate still takes part")

    def singletons(self) -> Iterable[Singleton]:
        """Declare the columns that it writes."""
        return [LastHit(), Teamwork()]


@Focus.system(Phase.RECORD, needs=Hit)
def focus(
    teamwork: Write[Teamwork],
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
            teamwork.damage_beside[index[me]] += hits.amount[k]
            teamwork.damage_focused[index[me]] += focused * hits.amount[k]
