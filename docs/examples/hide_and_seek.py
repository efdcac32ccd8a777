"""Hide and seek: hiders have some time to move boxes, and to lock them, before seekers may look.

After Baker et al., "Emergent tool use from multi-agent autocurricula" (ICLR 2020), in two dimensions and without ramps.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from outlast import FloorPlan, Scenario, systems
from outlast.components import Body, Box, BoxView, ObservationMasks, Phase, Reward, SelfView, Shape, Side, Solid
from outlast.components.sight import is_set
from outlast.ecs import (
    Action,
    Archetype,
    Array,
    Clock,
    Component,
    Entity,
    Event,
    Field,
    Module,
    NumberError,
    Offset,
    Read,
    Rows,
    Singleton,
    Statistic,
    Write,
    column,
    emit,
    kernel,
    number,
)

HIDERS, SEEKERS = 0, 1
NOBODY = -1

# --- boxes are held and locked


class Grip(Component):
    """The box that an agent holds, and where that is in the agent's own frame. Written by handling."""

    box: Array = column("i4", fill=NOBODY, unit="entity")
    ahead: Array = column("f4")  # metres
    left: Array = column("f4")
    turn: Array = column("f4")  # radians


class Handled(Component):
    """Who holds a box, and which side has locked it. Written by handling."""

    holder: Array = column("i4", fill=NOBODY, unit="entity")
    locked_by: Array = column("i4", fill=NOBODY, unit="side")


class Handle(Action, order=2):
    """grab: 1 holds the nearest box in reach, for as long as it is 1. lock: 1 locks the nearest box, -1 unlocks it."""

    grab: Array = column("i1", "agents", low=0, high=1)
    lock: Array = column("i1", "agents", low=-1, high=1)


class BoxLocked(Event, capacity=Box, who="agent", whom="box"):
    """A box that was locked, or unlocked."""

    agent: Array = column("i4", unit="entity")
    box: Array = column("i4", unit="entity")
    locked: Array = column("u1")  # 1: it is now


@dataclass(frozen=True)
class Handling(Module):
    """Agents drag boxes around, and lock them: then nobody moves them, until one of the same side unlocks them."""

    reach: float = number(0.6, low=0, unit="metres", about="from an agent's rim to a box that it can hold or lock")
    stiffness: float = number(8.0, above=0, high=25, unit="per second", about="how fast a held box follows")
    slack: float = number(1.0, above=0, unit="metres", about="a box that falls behind by more slips away")

    def archetypes(self) -> Iterable[Archetype]:
        """One more component for agents, and one for boxes."""
        return [Archetype("agent", (Grip(),)), Archetype("box", (Handled(),))]

    def singletons(self) -> Iterable[Singleton]:
        """What agents do, and what comes of it."""
        return [Handle(), BoxLocked()]

    def fields(self):
        """Numbers in the agents' own row, and in the rows of boxes."""
        return {"own": (Field("holds"),), "boxes": (Field("held"), Field("locked"))}

    def bounds(self, layout):
        """Of locked, 1 is by the agent's own side, -1 by another one."""
        return {"own": {"holds": (0, 1)}, "boxes": {"held": (0, 1), "locked": (-1, 1)}}

    def check(self, layout):
        """What would have no effect is refused."""
        if not layout.numbers("boxes")["dynamic"]:
            raise NumberError("handling: no box can be moved; set boxes_dynamic=True")


@kernel
def distance(body, shape, e, box) -> float:
    """Metres from the rim of agent `e` to the rectangle `box`; 0 where it touches."""
    x, y = body.x[e] - body.x[box], body.y[e] - body.y[box]
    along = abs(x * body.cosine[box] + y * body.sine[box]) - shape.half_width[box]
    across = abs(y * body.cosine[box] - x * body.sine[box]) - shape.half_height[box]
    return max(math.hypot(max(along, 0.0), max(across, 0.0)) - shape.radius[e], 0.0)


@kernel
def nearest(body, shape, entities, boxes, e, reach) -> int:
    """The box in reach of agent `e` that is nearest, or NOBODY."""
    found, least = NOBODY, reach
    for box in boxes:
        if entities.alive[box]:
            far = distance(body, shape, e, box)
            if far <= least:
                found, least = box, far
    return found


@kernel
def let_go(grip, handled, e) -> None:
    """Agent `e` holds nothing from now on."""
    if grip.box[e] >= 0:
        handled.holder[grip.box[e]] = NOBODY
        grip.box[e] = NOBODY


@Handling.system(Phase.DRIVE, after=(Body, "preparation"))
def handle(
    grip: Write[Grip],
    handled: Write[Handled],
    body: Write[Body],
    solid: Write[Solid],
    events: Write[BoxLocked],
    action: Read[Handle],
    shape: Read[Shape],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Grip],
    boxes: Rows[Handled],
    reach: float,
    stiffness: float,
    slack: float,
) -> None:
    """Locks first: a locked box is as static as walls are. A held one moves as if it were a part of its holder."""
    for box in boxes:
        if not entities.alive[box]:  # broken, and later set up again
            handled.locked_by[box], solid.dynamic[box] = NOBODY, 1
    for i in range(agents.size):
        e, own = agents[i], side.side[agents[i]]
        if entities.alive[e] and action.lock[i] != 0:
            box = nearest(body, shape, entities, boxes, e, reach)
            locks = action.lock[i] > 0
            if box >= 0 and handled.locked_by[box] == (NOBODY if locks else own):
                if handled.holder[box] >= 0:
                    let_go(grip, handled, handled.holder[box])
                handled.locked_by[box] = own if locks else NOBODY
                solid.dynamic[box] = 0 if locks else 1
                body.vx[box], body.vy[box], body.omega[box] = 0, 0, 0
                k = emit(events)
                events.agent[k], events.box[k], events.locked[k] = e, box, locks
    for i in range(agents.size):
        e = agents[i]
        box = grip.box[e]
        if action.grab[i] == 0 or not entities.alive[e] or (box >= 0 and not entities.alive[box]):
            let_go(grip, handled, e)
            continue
        if box < 0:
            box = nearest(body, shape, entities, boxes, e, reach)
            if box < 0 or handled.holder[box] >= 0 or handled.locked_by[box] >= 0:
                continue
            x, y = body.x[box] - body.x[e], body.y[box] - body.y[e]
            grip.box[e], handled.holder[box] = box, e
            grip.ahead[e] = x * body.cosine[e] + y * body.sine[e]
            grip.left[e] = y * body.cosine[e] - x * body.sine[e]
            grip.turn[e] = body.angle[box] - body.angle[e]
        x = grip.ahead[e] * body.cosine[e] - grip.left[e] * body.sine[e]  # from the agent to where the box belongs
        y = grip.ahead[e] * body.sine[e] + grip.left[e] * body.cosine[e]
        off_x, off_y = body.x[e] + x - body.x[box], body.y[e] + y - body.y[box]
        if math.hypot(off_x, off_y) > slack:
            let_go(grip, handled, e)
            continue
        body.vx[box] = body.vx[e] - body.omega[e] * y + stiffness * off_x
        body.vy[box] = body.vy[e] + body.omega[e] * x + stiffness * off_y
        body.omega[box] = body.omega[e] + stiffness * (body.angle[e] + grip.turn[e] - body.angle[box])


@Handling.system(Phase.OBSERVE)
def see_grip(view: Write[SelfView], grip: Read[Grip], agents: Rows[Grip], own_holds: Offset) -> None:
    """Whether an agent holds a box is in its own row, and in its copies that the others see."""
    for i in range(agents.size):
        view.own[i, own_holds] = 1 if grip.box[agents[i]] >= 0 else 0


@Handling.system(Phase.OBSERVE, after=BoxView)
def see_handled(
    view: Write[BoxView],
    masks: Read[ObservationMasks],
    handled: Read[Handled],
    side: Read[Side],
    agents: Rows[Grip],
    boxes: Rows[Handled],
    boxes_held: Offset,
    boxes_locked: Offset,
) -> None:
    """Of the boxes that an agent sees, whether somebody holds them, and who has locked them."""
    for i in range(agents.size):
        for k in range(boxes.size):
            box, filled = boxes[k], is_set(masks.filled, i, boxes[k])
            locked = 0 if handled.locked_by[box] < 0 else 1 if handled.locked_by[box] == side.side[agents[i]] else -1
            view.boxes[i, k, boxes_held] = filled and handled.holder[box] >= 0
            view.boxes[i, k, boxes_locked] = locked if filled else 0


# --- who is seen, and what that pays


class Seen(Statistic):
    """For how many ticks a seeker saw some hider."""

    ticks_seen: Array = column("i4")


@dataclass(frozen=True)
class HideAndSeek(Module):
    """From tick `begin` on, hiders are paid while no seeker sees any of them, and seekers while one does."""

    begin: int = number(100, low=0, unit="ticks", about="from which on it counts who is seen")
    reward: float = number(0.1, unit="reward a tick", about="for one side; the other one pays it")

    def singletons(self) -> Iterable[Singleton]:
        """What is paid, and counted."""
        return [Reward(), Seen()]


@kernel
def found(masks, side, agents) -> bool:
    """Whether a seeker sees a hider."""
    for i in range(agents.size):
        for e in agents:
            if side.side[agents[i]] == SEEKERS and side.side[e] == HIDERS and is_set(masks.mask, i, e):
                return True
    return False


@HideAndSeek.system(Phase.REWARD)
def pay(
    reward_table: Write[Reward],
    masks: Read[ObservationMasks],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side],
    begin: int,
    reward: float,
) -> None:
    """The sides' rewards add up to nothing."""
    pays = 0 if clock.tick[0] <= begin else -reward if found(masks, side, agents) else reward
    for i in range(agents.size):
        reward_table.reward[i] = pays if side.side[agents[i]] == HIDERS else -pays


@HideAndSeek.system(Phase.RECORD)
def count(
    seen: Write[Seen],
    masks: Read[ObservationMasks],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side],
    begin: int,
) -> None:
    """As it was paid."""
    if clock.tick[0] > begin and found(masks, side, agents):
        seen.ticks_seen[0] += 1


# --- the game

PREPARATION = 100  # ticks
PLAN = FloorPlan.from_text(
    """
    .........#.......
    .........#.......
    ..AAAA...#.......
    ..AAAA...........
    ..AAAA...........
    ..****...#.......
    ..****...#..BBB..
    ####..####..BBB..
    ............BBB..
    ............BBB..
    ...****..........
    ...****..........
    """
)

HIDE_AND_SEEK = Scenario(
    "hide_and_seek",
    (
        systems.Agents(count=4),
        systems.Teams(sizes=(2, 2)),
        PLAN.room(),
        PLAN.mechanic(),
        systems.SpawnGrid(cells=8),
        systems.Steering(speed=4.0),
        systems.Physics(linear_damping=3.0, angular_damping=3.0),  # boxes slide for a metre or so
        systems.Preparation(ticks=PREPARATION, sides=(SEEKERS,), blind=True),
        systems.Cameras(fov=0.75 * math.pi, depth=15.0),
        systems.Lidar(rays=15),
        systems.Boxes(count=4, width=2.2, width_deviation=0.0, height=0.8, height_deviation=0.0, dynamic=True),
        systems.Ending(rule="never", limit=300),
        systems.Record(),
        Handling(),
        HideAndSeek(begin=PREPARATION),
    ),
)
