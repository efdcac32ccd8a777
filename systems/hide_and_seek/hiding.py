"""Hiding: who is seen, what that pays, who has won, and what the published environments record of an episode."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Floor, ObservationMasks, Outcome, Phase, Reward, Shape, Side, Weld
from outlast.components.hide_and_seek import HIDERS, SEEKERS, Climbed, Crate, Doors, Locked, Movable, Tracked
from outlast.components.limits import MUCH
from outlast.components.sight import is_set
from outlast.ecs import (
    Array,
    Bitset,
    Clock,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    RowIndex,
    Rows,
    Singleton,
    Write,
    kernel,
    number,
)
from outlast.systems.geometry.bodies import Bodies
from outlast.systems.geometry.queries import around

JOINT, MEAN = 0, 1  # indices into the choices of Hiding.rule
MOMENTS = 2
HALF = np.float32(0.5)


@dataclass(frozen=True)
class Hiding(Module):
    """After the preparation, hiders are paid in each tick in which they are hidden, and seekers if they see some hider.

    A hider is seen if a seeker observes it (its mask is 1). rule (HideAndSeekRewardWrapper): "joint": a side is paid as
    one; hiders if none of them is seen, seekers if any of them sees one, so that both add up to 0. "mean": the mean
    over the side of what "selfish" pays. "selfish": each agent for itself. The side that is paid more often has won.
    """

    reward: float = number(1.0, low=0, high=MUCH, unit="reward per tick", about="what a side gets or loses in a tick")
    rule: str = number("joint", choices=("joint", "mean", "selfish"), about="who is paid for what")
    outside: float = number(
        10.0,
        low=0,
        high=MUCH,
        unit="reward per tick",
        about="penalty for an agent beyond the floor, where walls are off",
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Reward(), Outcome(), Tracked()]

    def dims(self) -> dict[str, int | str]:
        return {"moments": MOMENTS}

    def check(self, layout: Layout) -> None:
        if layout.dims.get("sides") != 2:
            raise NumberError("hiding: two sides are needed, hiders first; add Teams(sizes=(2, 2))")
        if layout.numbers("preparation").get("sides") not in (None, (), (float(SEEKERS),)):
            raise NumberError(f"preparation.sides: seekers wait, which are side {SEEKERS}; set ({SEEKERS},)")


@kernel
def meets(masks: Any, side: Any, agents: Array, i: int) -> bool:
    """Return whether agent number `i` is a hider that a seeker sees, or a seeker that sees a hider."""
    for j in range(agents.size):
        if side.side[agents[j]] == SEEKERS and side.side[agents[i]] == HIDERS and is_set(masks.mask, j, agents[i]):
            return True
        if side.side[agents[i]] == SEEKERS and side.side[agents[j]] == HIDERS and is_set(masks.mask, i, agents[j]):
            return True
    return False


@Hiding.system(Phase.REWARD)
def pay(
    reward_table: Write[Reward],
    outcome: Write[Outcome],
    tracked: Write[Tracked],
    masks: Read[ObservationMasks],
    body: Read[Body],
    side: Read[Side],
    entities: Read[Entity],
    floor: Read[Floor],
    clock: Read[Clock],
    agents: Rows[Side],
    preparation_ticks: int,
    reward: float,
    rule: int,
    outside: float,
) -> None:
    """Pay all agents."""
    counts = clock.tick[0] > preparation_ticks
    some, met, members = False, (0, 0), (0, 0)  # by side: how many see or are seen, and how many there are
    for i in range(agents.size):
        here = meets(masks, side, agents, i)
        hides, seeks = side.side[agents[i]] == HIDERS, side.side[agents[i]] == SEEKERS
        met, members = (met[0] + (here and hides), met[1] + (here and seeks)), (members[0] + hides, members[1] + seeks)
        some |= here
    if counts:
        tracked.ticks_seen[0] += some
        outcome.outcome[SEEKERS if some else HIDERS] += 1
    for i in range(agents.size):
        e, share = agents[i], np.float32(0)
        s = side.side[e]
        if counts and s >= 0:
            if rule == JOINT:
                share = np.float32(1 if some else 0)
            elif rule == MEAN:
                share = np.float32(met[1] if s == SEEKERS else met[0]) / np.float32(members[1] if s else members[0])
            else:
                share = np.float32(meets(masks, side, agents, i))
            share = share + share - np.float32(1)
            reward_table.reward[i] = reward * (share if s == SEEKERS else -share)
        else:
            reward_table.reward[i] = 0
        if s >= 0 and entities.alive[e] and is_outside(body, floor, e):
            reward_table.reward[i] -= outside


@kernel
def is_outside(body: Any, floor: Any, e: int) -> bool:
    """Return whether the centre of a body is beyond the floor."""
    width, height = floor.size[0], floor.size[floor.size.size - 1]
    return bool(abs(body.x[e]) > HALF * width or abs(body.y[e]) > HALF * height)


@Hiding.system(Phase.RECORD, before=Tracked)
def track_things(
    tracked: Write[Tracked],
    body: Read[Body],
    movable: Read[Movable],
    clock: Read[Clock],
    things: Rows[Movable],
    crate: RowIndex[Crate],
    preparation_ticks: int,
) -> None:
    """Record how far things are from where they began, and how many are locked."""
    for moment in range(int(clock.tick[0] > preparation_ticks), MOMENTS):
        tracked.crates_moved[moment] = tracked.ramps_moved[moment] = 0
        tracked.crates_locked[moment] = tracked.ramps_locked[moment] = 0
        for e in things:
            far: Any = np.float32(math.hypot(body.x[e] - movable.start_x[e], body.y[e] - movable.start_y[e]))
            if crate[e] >= 0:
                tracked.crates_moved[moment] = max(tracked.crates_moved[moment], far)
                tracked.crates_locked[moment] += movable.locked_by[e] >= 0
            else:
                tracked.ramps_moved[moment] = max(tracked.ramps_moved[moment], far)
                tracked.ramps_locked[moment] += movable.locked_by[e] >= 0


@Hiding.system(Phase.RECORD, after=("hiding.track_hands", "hiding.track_climbs"), needs=Doors)
def track_doors(
    tracked: Write[Tracked],
    doors: Read[Doors],
    shape: Read[Shape],
    clock: Read[Clock],
    agents: Rows[Side],
    things: Bitset[Movable],
    bodies: Bodies,
    preparation_ticks: int,
) -> None:
    """Record in how many doors a thing stands, so that an agent in the middle of the door would touch it."""
    closed = 0
    for k in range(doors.open.size):
        if doors.open[k]:
            closed += around(bodies, things, doors.x[k], doors.y[k], shape.radius[agents[0]]) > 0
    for moment in range(int(clock.tick[0] > preparation_ticks), MOMENTS):
        tracked.doors_closed[moment] = closed


@Hiding.system(Phase.RECORD)
def track_hands(
    tracked: Write[Tracked], welds: Read[Weld], locks: Read[Locked], side: Read[Side], agents: Rows[Side, Weld]
) -> None:
    """Record who holds, locks and unlocks."""
    for e in agents:
        if welds.other[e] >= 0:
            tracked.held[side.side[e]] += 1
    for k in range(locks.count[0]):
        count = tracked.locks if locks.locked[k] else tracked.unlocks
        count[side.side[locks.agent[k]]] += 1


@Hiding.system(Phase.RECORD, after="hiding.track_hands", needs=Climbed)
def track_climbs(tracked: Write[Tracked], climbs: Read[Climbed], side: Read[Side]) -> None:
    """Record who climbs."""
    for k in range(climbs.count[0]):
        tracked.climbs[side.side[climbs.agent[k]]] += 1
