"""Behaviour: descriptors of each agent's behaviour in an episode, for quality-diversity search and curricula."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Aggression,
    Body,
    BoxPlaced,
    Care,
    Condition,
    Cover,
    Encounters,
    Exposure,
    Floor,
    Heal,
    Health,
    Hit,
    ItemGiven,
    ItemUsed,
    ObservationMasks,
    Phase,
    Shape,
    Side,
    Strike,
    Track,
    Travelled,
    Zone,
)
from outlast.components.zone import outside
from outlast.ecs import Array, Bitset, Entity, Module, Read, RowIndex, Rows, Singleton, Write, kernel, number

from .geometry.blocks import first_row
from .geometry.rays import NO_HIT, raycast_entity

MOST_CELLS = 32  # on each side: they take a kilobyte for each agent
HALF, ONE, ZERO = np.float32(0.5), np.float32(1), np.float32(0)


@dataclass(frozen=True)
class Behaviour(Module):
    """Statistics of each agent's behaviour; nothing else in the game changes.

    They cover the ticks at the end of which the agent is alive, and the world at that time, as observations show it.
    Statistics of a mechanic that the scenario lacks stay 0. cells: an agent visits the cell that contains its centre.
    need: an agent needs a heal if it had fewer hit points at the end of the previous tick.
    """

    cells: int = number(
        8, low=1, high=MOST_CELLS, about="cells on a side of the grid that counts where agents have been"
    )
    need: float = number(
        0.5, low=0, high=1, unit="of the hit points at the start", about="an agent with less than this needs a heal"
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Track(), Condition(), Travelled(), Encounters(), Exposure(), Aggression(), Care(), Cover()]

    def dims(self) -> dict[str, int | str]:
        return {"behaviour cells": self.cells**2}


@kernel
def average(means: Array, i: int, value: Any, count: int) -> None:
    """Update the mean of agent `i` with a value, which is its number `count`."""
    means[i] += (value - means[i]) / count


@kernel
def arrive(track: Array, i: int, body: Array, floor: Array, e: int, cells: int) -> None:
    """Record the position of agent `i`, in row `e`, and the cell that it visits, if it is in the room."""
    track.here[i], track.x[i], track.y[i] = 1, body.x[e], body.y[e]
    x, y = body.x[e] / floor.size[0] + HALF, body.y[e] / floor.size[floor.size.size - 1] + HALF
    if ZERO <= x < ONE and ZERO <= y < ONE:
        cell = int(y * cells) * cells + int(x * cells)
        track.cells[i] += not track.visited[i, cell]
        track.visited[i, cell] = 1


@kernel
def nearest(body: Array, side: Array, entities: Array, agents: Array, me: int) -> tuple[int, Any, int, Any]:
    """Return the nearest living enemy and its squared distance, then the same of the own side; row -1: none."""
    enemy, to_enemy, mate, to_mate = -1, np.float32(np.inf), -1, np.float32(np.inf)
    for e in agents:
        if e == me or not entities.alive[e]:
            continue
        x, y = body.x[e] - body.x[me], body.y[e] - body.y[me]
        square = x * x + y * y
        if side.side[e] == side.side[me]:
            if square < to_mate:
                mate, to_mate = int(e), square
        elif square < to_enemy:
            enemy, to_enemy = int(e), square
    return enemy, to_enemy, mate, to_mate


@kernel
def sees_enemy(mask: Array, side: Array, peers: Array, i: int, me: int) -> bool:
    """Return whether the observations of agent `me`, number `i`, show a living agent of another side."""
    for b in range(peers.size):
        pending = mask[i, b] & peers[b]
        while pending:
            if side.side[first_row(b, pending)] != side.side[me]:
                return True
            pending &= pending - 1
    return False


@Behaviour.system(Phase.SPAWN, after=(Body, Entity))
def begin(
    track: Write[Track], body: Read[Body], floor: Read[Floor], entities: Read[Entity], agents: Rows[Side], cells: int
) -> None:
    """Record the start positions of agents."""
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e]:
            arrive(track, i, body, floor, e, cells)


@Behaviour.system(Phase.RECORD)
def follow(
    track: Write[Track],
    travelled: Write[Travelled],
    body: Read[Body],
    floor: Read[Floor],
    entities: Read[Entity],
    agents: Rows[Side],
    cells: int,
) -> None:
    """Measure the distances moved by living agents. The distance to the place of a respawn does not count."""
    for i in range(agents.size):
        e = agents[i]
        if not entities.alive[e]:
            track.here[i] = 0
            continue
        travelled.ticks_alive[i] += 1
        x, y = body.x[e] - track.x[i], body.y[e] - track.y[i]
        if track.here[i]:
            travelled.distance_travelled[i] += np.sqrt(x * x + y * y)
        arrive(track, i, body, floor, e, cells)
        travelled.cells_visited[i] = track.cells[i] / cells**2


@Behaviour.system(Phase.RECORD, after="behaviour.follow")
def meet(
    encounters: Write[Encounters],
    track: Write[Track],
    travelled: Read[Travelled],
    masks: Read[ObservationMasks],
    body: Read[Body],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Side],
    peers: Bitset[Side],
) -> None:
    """Measure the distances of living agents to others, and whether they see enemies."""
    for i in range(agents.size):
        me = agents[i]
        if not entities.alive[me]:
            continue
        enemy, to_enemy, mate, to_mate = nearest(body, side, entities, agents, me)
        if enemy >= 0:
            track.enemies[i] += 1
            average(encounters.enemy_distance, i, np.sqrt(to_enemy), track.enemies[i])
        if mate >= 0:
            track.mates[i] += 1
            average(encounters.mate_distance, i, np.sqrt(to_mate), track.mates[i])
        seen = sees_enemy(masks.mask, side, peers, i, me)
        average(encounters.enemy_in_view, i, seen, travelled.ticks_alive[i])


@Behaviour.system(Phase.RECORD, after="behaviour.follow", needs=Zone)
def expose(
    exposure: Write[Exposure],
    travelled: Read[Travelled],
    zone: Read[Zone],
    body: Read[Body],
    entities: Read[Entity],
    agents: Rows[Side],
) -> None:
    """Average whether the living are outside of the safe zone; if it is void, all are."""
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e]:
            average(exposure.outside_zone, i, outside(zone, body, e), travelled.ticks_alive[i])


@Behaviour.system(Phase.RECORD, needs=Strike)
def strike(
    aggression: Write[Aggression], strikes: Read[Strike], hits: Read[Hit], side: Read[Side], index: RowIndex[Side]
) -> None:
    """Count the strikes of this tick, and the damage by agents. Boxes, walls and the own side are not enemies."""
    for k in range(strikes.count[0]):
        me, target = strikes.agent[k], strikes.target[k]
        i = index[me]
        if i >= 0:
            landed = target >= 0 and index[target] >= 0 and side.side[target] != side.side[me]
            aggression.strikes[i] += 1
            average(aggression.strikes_landed, i, landed, aggression.strikes[i])
    for k in range(hits.count[0]):
        me, target = hits.agent[k], hits.target[k]
        if me >= 0 and index[me] >= 0 and index[target] >= 0 and side.side[target] != side.side[me]:
            aggression.damage_dealt[index[me]] += hits.amount[k]


@Behaviour.system(Phase.SPAWN, after=Health, needs=(ItemUsed, Heal))
def examine(condition: Write[Condition], health: Read[Health], agents: Rows[Side, Health]) -> None:
    """Record the hit points with which the agents start."""
    for i in range(agents.size):
        condition.start[i] = condition.last[i] = health.points[agents[i]]


@Behaviour.system(Phase.RECORD, needs=ItemUsed)
def heal(
    care: Write[Care],
    condition: Write[Condition],
    uses: Read[ItemUsed],
    health: Read[Health],
    entities: Read[Entity],
    agents: Rows[Side, Health],
    index: RowIndex[Side],
    heals: RowIndex[Heal],
    need: float,
) -> None:
    """Count the heals used in this tick by agents that needed them."""
    for k in range(uses.count[0]):
        i = index[uses.agent[k]]
        if i >= 0 and heals[uses.item[k]] >= 0:
            care.heals_in_need[i] += condition.last[i] < need * condition.start[i]
    for i in range(agents.size):
        if entities.alive[agents[i]]:
            condition.last[i] = health.points[agents[i]]


@Behaviour.system(Phase.RECORD, needs=ItemGiven, after="behaviour.heal")
def give(care: Write[Care], gifts: Read[ItemGiven], index: RowIndex[Side], heals: RowIndex[Heal]) -> None:
    """Count the heals given away in this tick."""
    for k in range(gifts.count[0]):
        i = index[gifts.giver[k]]
        if i >= 0 and heals[gifts.item[k]] >= 0:
            care.heals_given[i] += 1


@Behaviour.system(Phase.RECORD, needs=BoxPlaced)
def take_cover(
    cover: Write[Cover],
    boxes: Read[BoxPlaced],
    body: Read[Body],
    shape: Read[Shape],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Side],
    index: RowIndex[Side],
) -> None:
    """Count the boxes set up in this tick that stand between their user and its nearest living enemy."""
    for k in range(boxes.count[0]):
        me, box = boxes.agent[k], boxes.box[k]
        enemy = nearest(body, side, entities, agents, me)[0]
        if enemy >= 0 and index[me] >= 0 and entities.alive[box]:
            x, y = body.x[enemy], body.y[enemy]
            at = raycast_entity(body, shape, x, y, body.x[me] - x, body.y[me] - y, box)
            cover.boxes_between[index[me]] += at < NO_HIT
