"""Hiding: visible hiders, rewards, the winner, and the statistics of the published environments."""

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

JOINT, SELFISH = 0, 2  # indices into the choices of Hiding.rule
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
        own, other = side.side[agents[i]], side.side[agents[j]]
        if own == HIDERS and other == SEEKERS and is_set(masks.mask, j, agents[i]):
            return True
        if own == SEEKERS and other == HIDERS and is_set(masks.mask, i, agents[j]):
            return True
    return False


@kernel
def met_share(masks: Any, side: Any, agents: Array, i: int, rule: int) -> Any:
    """Return the share of a tick in which agent number `i` meets the other side, by the rule: 0 to 1, float32."""
    if rule == SELFISH:
        return np.float32(meets(masks, side, agents, i))
    met, members = np.float32(0), np.float32(0)
    for j in range(agents.size):
        if side.side[agents[j]] == side.side[agents[i]]:
            met, members = met + np.float32(meets(masks, side, agents, j)), members + np.float32(1)
    return np.float32(met > 0) if rule == JOINT else met / members


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
    counts, some = clock.tick[0] > preparation_ticks, False
    for i in range(agents.size):
        e, s = agents[i], side.side[agents[i]]
        reward_table.reward[i] = 0
        some |= meets(masks, side, agents, i)
        if counts and s >= 0:
            share = np.float32(2) * met_share(masks, side, agents, i, rule) - np.float32(1)
            reward_table.reward[i] = reward * (share if s == SEEKERS else -share)
        if s >= 0 and entities.alive[e] and is_outside(body, floor, e):
            reward_table.reward[i] -= outside
    if counts:
        tracked.ticks_seen[0] += some
        outcome.outcome[SEEKERS if some else HIDERS] += 1


@kernel
def is_outside(body: Any, floor: Any, e: int) -> bool:
    """Return whether the centre of a body is beyond the floor."""
    width, height = floor.size[0], floor.size[floor.size.size - 1]
    return bool(abs(body.x[e]) > HALF * width or abs(body.y[e]) > HALF * height)


@Hiding.system(Phase.RECORD)
def track(
    tracked: Write[Tracked],
    body: Read[Body],
    shape: Read[Shape],
    movable: Read[Movable],
    welds: Read[Weld],
    side: Read[Side],
    clock: Read[Clock],
    locks: Read[Locked],
    climbs: Read[Climbed] | None,
    doors: Read[Doors] | None,
    agents: Rows[Side, Weld],
    things: Rows[Movable],
    members: Bitset[Movable],
    crate: RowIndex[Crate],
    bodies: Bodies,
    preparation_ticks: int,
) -> None:
    """Record the handling, the motion and the locks of things, and closed doors."""
    for e in agents:
        if welds.other[e] >= 0:
            tracked.held[side.side[e]] += 1
    for k in range(locks.count[0]):
        count = tracked.locks if locks.locked[k] else tracked.unlocks
        count[side.side[locks.agent[k]]] += 1
    if climbs is not None:
        for k in range(climbs.count[0]):
            tracked.climbs[side.side[climbs.agent[k]]] += 1
    moved, locked, closed = (np.float32(0), np.float32(0)), (0, 0), 0  # crates, ramps
    for e in things:
        far: Any = np.float32(math.hypot(body.x[e] - movable.start_x[e], body.y[e] - movable.start_y[e]))
        own = movable.locked_by[e] >= 0
        if crate[e] >= 0:
            moved, locked = (max(moved[0], far), moved[1]), (locked[0] + own, locked[1])
        else:
            moved, locked = (moved[0], max(moved[1], far)), (locked[0], locked[1] + own)
    if doors is not None:
        for k in range(doors.open.size):  # closed if an agent in the middle of the door would touch a thing
            if doors.open[k]:
                closed += around(bodies, members, doors.x[k], doors.y[k], shape.radius[agents[0]]) > 0
    for moment in range(int(clock.tick[0] > preparation_ticks), MOMENTS):
        tracked.crates_moved[moment], tracked.ramps_moved[moment] = moved
        tracked.crates_locked[moment], tracked.ramps_locked[moment] = locked
        tracked.doors_closed[moment] = closed
