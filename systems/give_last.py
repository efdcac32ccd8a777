"""Giving: the last item of the bag goes to the nearest agent."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Bag, Body, Gift, Give, Item, ItemGiven, Phase, Side, Sides
from outlast.components.inventory import empty, empty_handed, full, pop, push
from outlast.components.limits import FAR
from outlast.components.respawn import inactive
from outlast.ecs import (
    Archetype,
    Array,
    Entity,
    Module,
    Read,
    RowIndex,
    Rows,
    Singleton,
    WorldsView,
    Write,
    emit,
    kernel,
    number,
    of,
)

from .geometry.bodies import Bodies, discs_near

ANY = 1  # index into the choices of GiveLast.nearest


@dataclass(frozen=True)
class GiveLast(Module):
    """Gifts to the nearest suitable agent (paper, section 3.4): alive, and of the giver's team if there are teams.

    nearest = "suitable": the nearest such agent. "any": the nearest body of any kind, but only if it is such an
    agent, as in the paper's runs (reference rules, section 6, point 4). If the receiver's bag is full, the giver keeps
    the item. passes_on: an agent with an empty bag passes on an item that it receives in the same tick from an agent of
    lower id; an item that two agents give to each other then comes straight back, as in the paper's runs.
    """

    reach: float = number(
        2.0,
        above=0,
        high=FAR,
        per_agent=True,
        unit="metres",
        about="greatest distance to the taker, from centre to centre",
    )
    nearest: str = number(
        "suitable",
        choices=("suitable", "any"),
        about="the taker is the nearest suitable agent (suitable), or the nearest body, if it is such an agent (any)",
    )
    passes_on: bool = number(
        False, about="an agent with an empty bag can give away an item in the tick in which it is given it"
    )

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Gift(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Give(), ItemGiven()]

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        passes_on = worlds.number(f"{self.name}_passes_on")
        return {"give": inactive(worlds) | empty_handed(worlds, received=passes_on)}


@kernel
def may_take(side: Array, sides: Array, index: Array, me: int, e: int) -> bool:
    """Return whether body `e` is an agent that may take an item from `me`. Rows of other kinds have side 0."""
    return bool(index[e] >= 0 and (sides.teams[0] == 0 or side.side[e] == side.side[me]))


@GiveLast.system(Phase.GIVE)
def choose(
    gift: Write[Gift],
    give: Read[Give],
    bag: Read[Bag],
    body: Read[Body],
    side: Read[Side],
    sides: Read[Sides],
    entities: Read[Entity],
    agents: Rows[Side, Gift],
    index: RowIndex[Side, Gift],
    bodies: Bodies,
    reach: float,
    nearest: int,
    passes_on: bool,
) -> None:
    """Choose all receivers before any item is handed over."""
    givers = 0  # agents with an item: without any, nothing can be passed on either
    for i in range(agents.size):
        me = agents[i]
        gift.taker[me] = -1
        givers += entities.alive[me] != 0 and give.give[i] != 0 and not empty(bag, me)
    if givers == 0:
        return
    for i in range(agents.size):
        me = agents[i]
        if not entities.alive[me] or not give.give[i] or not (passes_on or not empty(bag, me)):
            continue
        closest, far = np.float32(np.inf), of(reach, me)
        for k in range(discs_near(bodies, bodies.members, body.x[me], body.y[me], far)):
            e = bodies.rows[k]
            if e == me or (nearest != ANY and not may_take(side, sides, index, me, e)):
                continue
            x, y = body.x[e] - body.x[me], body.y[e] - body.y[me]
            square = x * x + y * y
            if square <= far * far and square < closest:
                closest = square
                gift.taker[me] = e
        if gift.taker[me] >= 0 and not may_take(side, sides, index, me, gift.taker[me]):
            gift.taker[me] = np.int32(-1)


@GiveLast.system(Phase.GIVE, after="give_last.choose")
def hand_over(
    bag: Write[Bag],
    item: Write[Item],
    gifts: Write[ItemGiven],
    gift: Read[Gift],
    agents: Rows[Side, Gift],
    items: Rows[Item],
) -> None:
    """Hand over the items, in order of agents."""
    for me in agents:
        taker = gift.taker[me]
        if taker >= 0 and not empty(bag, me) and not full(bag, taker):
            row = pop(bag, item, me)
            push(bag, item, taker, row)
            k = emit(gifts)
            gifts.giver[k], gifts.taker[k], gifts.item[k] = me, taker, row
