"""Hide and seek: hiders have some time to move boxes, and to lock them, before seekers may look.

After Baker et al., "Emergent tool use from multi-agent autocurricula" (ICLR 2020), in two dimensions and without ramps.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from outlast import FloorPlan, Scenario, systems
from outlast.components import Body, BoxView, ObservationMasks, Phase, Reward, SelfView, Shape, Side, Sight, Solid
from outlast.components.respawn import inactive
from outlast.components.sight import OMNISCIENT, is_set
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


class BoxLocked(Event, capacity="agents", who="agent", whom="box"):
    """A box that was locked, or unlocked."""

    agent: Array = column("i4", unit="entity")
    box: Array = column("i4", unit="entity")
    locked: Array = column("u1")  # 1: locked, 0: unlocked


@dataclass(frozen=True)
class Handling(Module):
    """Agents drag boxes around, and lock them: then nobody moves them, until one of the same side unlocks them.

    They handle what they see and reach. A held box and its holder move as one body, as heavy as both.
    """

    reach: float = number(
        0.6, low=0, unit="metres", about="greatest distance from an agent's rim to a box to hold or lock"
    )
    stiffness: float = number(
        8.0, above=0, unit="per second", about="how fast a held box gets back to where it was held"
    )
    slack: float = number(0.5, above=0, unit="metres", about="a held box slips away when it is farther off than this")

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

    def idle_actions(self, worlds):
        """For action masks: the dead do nothing."""
        return dict.fromkeys(("grab", "lock"), inactive(worlds))

    def check(self, layout):
        """What would have no effect, or would not come to rest, is refused."""
        if not layout.numbers("boxes")["dynamic"]:
            raise NumberError("handling: no box can be moved; set boxes_dynamic=True")
        physics = layout.numbers("physics")
        if self.stiffness * physics["substeps"] > physics["rate"]:
            raise NumberError("handling.stiffness: a box would overshoot in a tick; take less than a tick's inverse")


@kernel
def distance(body, shape, e, box) -> float:
    """Metres from the rim of agent `e` to the rectangle `box`; 0 where it touches."""
    x, y = body.x[e] - body.x[box], body.y[e] - body.y[box]
    along = abs(x * body.cosine[box] + y * body.sine[box]) - shape.half_width[box]
    across = abs(y * body.cosine[box] - x * body.sine[box]) - shape.half_height[box]
    return max(math.hypot(max(along, 0.0), max(across, 0.0)) - shape.radius[e], 0.0)


@kernel
def nearest(tables, i, e, boxes, reach, locked_by, free) -> int:
    """The nearest box that agent `e` sees and reaches, with that lock, or NOBODY. free: of those that nobody holds."""
    body, shape, entities, sight, handled = tables
    found, least = NOBODY, reach
    for box in boxes:
        known = sight.mode[0] == OMNISCIENT or is_set(sight.visible, i, box)
        fits = handled.locked_by[box] == locked_by and not (free and handled.holder[box] >= 0)
        if entities.alive[box] and known and fits:
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


@kernel
def join(body, solid, e, box, off_x, off_y, turn) -> None:
    """Give two bodies the motion of one: nothing is gained or lost but the energy of what moved apart.

    off_x, off_y, turn: velocities by which the box comes back to its place, and its holder, by weight, to meet it.
    """
    share = solid.mass[box] / (solid.mass[e] + solid.mass[box])
    x, y = body.x[box] - body.x[e], body.y[box] - body.y[e]
    apart_x, apart_y = body.vx[box] - body.vx[e], body.vy[box] - body.vy[e]
    vx, vy, mass = body.vx[e] + share * apart_x, body.vy[e] + share * apart_y, share * solid.mass[e]
    inertia = solid.inertia[e] + solid.inertia[box]
    spin = solid.inertia[e] * body.omega[e] + solid.inertia[box] * body.omega[box] + mass * (x * apart_y - y * apart_x)
    spin /= inertia + mass * (x * x + y * y)
    other, twist = 1 - share, solid.inertia[box] / inertia
    body.vx[e], body.vy[e] = vx + share * (spin * y - off_x), vy - share * (spin * x + off_y)
    body.vx[box], body.vy[box] = vx - other * (spin * y - off_x), vy + other * (spin * x + off_y)
    body.omega[e], body.omega[box] = spin - twist * turn, spin + (1 - twist) * turn


@Handling.system(Phase.DRIVE, after=(Body, "preparation"))
def handle(
    grip: Write[Grip],
    handled: Write[Handled],
    body: Write[Body],
    solid: Write[Solid],
    events: Write[BoxLocked],
    action: Read[Handle],
    sight: Read[Sight],
    shape: Read[Shape],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Grip],
    boxes: Rows[Handled],
    reach: float,
    stiffness: float,
    slack: float,
) -> None:
    """Locks first: a locked box is as static as walls are. Then what is held moves with its holder."""
    tables = (body, shape, entities, sight, handled)
    for box in boxes:
        if not entities.alive[box]:  # it is broken: if it is set up again, it is not locked
            handled.locked_by[box], solid.dynamic[box] = NOBODY, 1
    for i in range(agents.size):
        e, own, locks = agents[i], side.side[agents[i]], action.lock[i] > 0
        if entities.alive[e] and action.lock[i] != 0:
            box = nearest(tables, i, e, boxes, reach, NOBODY if locks else own, False)
            if box >= 0:
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
            box = nearest(tables, i, e, boxes, reach, NOBODY, True)
            if box < 0:
                continue
            x, y = body.x[box] - body.x[e], body.y[box] - body.y[e]
            grip.box[e], handled.holder[box] = box, e
            grip.ahead[e] = x * body.cosine[e] + y * body.sine[e]
            grip.left[e] = y * body.cosine[e] - x * body.sine[e]
            grip.turn[e] = body.angle[box] - body.angle[e]
        x = body.x[e] + grip.ahead[e] * body.cosine[e] - grip.left[e] * body.sine[e] - body.x[box]
        y = body.y[e] + grip.ahead[e] * body.sine[e] + grip.left[e] * body.cosine[e] - body.y[box]
        if math.hypot(x, y) > slack:
            let_go(grip, handled, e)
            continue
        turn = body.angle[e] + grip.turn[e] - body.angle[box]
        join(body, solid, e, box, stiffness * x, stiffness * y, stiffness * turn)


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
    """Once seekers may look, hiders are paid while no seeker sees any of them, and seekers while one does."""

    reward: float = number(
        0.1, unit="reward per tick", about="what each agent of one side gets, and each of the other pays"
    )

    def singletons(self) -> Iterable[Singleton]:
        """What is paid, and counted."""
        return [Reward(), Seen()]

    def check(self, layout):
        """There are hiders and seekers."""
        if layout.dims.get("sides") != 2:
            raise NumberError("hide_and_seek: two sides are needed, hiders first; add Teams(sizes=(2, 2))")


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
    seen: Write[Seen],
    masks: Read[ObservationMasks],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side],
    preparation_ticks: int,
    reward: float,
) -> None:
    """Nothing before seekers may look: preparation_ticks is a number of Preparation."""
    pays = 0.0
    if clock.tick[0] > preparation_ticks:
        exposed = found(masks, side, agents)
        seen.ticks_seen[0] += exposed
        pays = -reward if exposed else reward
    for i in range(agents.size):
        reward_table.reward[i] = pays if side.side[agents[i]] == HIDERS else -pays


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
        systems.Physics(linear_damping=3.0, angular_damping=3.0),  # a box that is let go slides for a metre or so
        systems.Preparation(ticks=PREPARATION, sides=(SEEKERS,), blind=True),
        systems.Cameras(fov=0.75 * math.pi, depth=15.0),
        systems.Lidar(rays=15),
        systems.Boxes(
            count=4, width=2.2, width_deviation=0.0, height=0.8, height_deviation=0.0, dynamic=True, density=0.3
        ),
        systems.Ending(rule="never", limit=300),
        systems.Record(),
        Handling(),
        HideAndSeek(),
    ),
)
