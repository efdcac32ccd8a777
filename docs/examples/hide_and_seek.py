"""Hide and seek: hiders have some time to move boxes, and to lock them, before seekers may look.

After Baker et al., "Emergent tool use from multi-agent autocurricula" (ICLR 2020), in two dimensions and without ramps.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from outlast import FloorPlan, Scenario, systems
from outlast.components import (
    Body,
    BoxView,
    Look,
    ObservationMasks,
    Phase,
    Reward,
    SelfView,
    Side,
    Sight,
    Solid,
    Weld,
)
from outlast.components.contact import fix, free
from outlast.components.joint import hold, let_go
from outlast.components.respawn import inactive
from outlast.components.sight import OMNISCIENT, is_set
from outlast.ecs import (
    Action,
    Archetype,
    Array,
    Bitset,
    Clock,
    Component,
    Entity,
    Event,
    Module,
    NumberError,
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
from outlast.queries import Bodies, distance, within
from outlast.systems.observation_rows import more_fields

HIDERS, SEEKERS = 0, 1
NOBODY = -1

# --- boxes are held and locked


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

    They handle what they see and reach. A held box is welded to its holder.
    """

    reach: float = number(
        0.6, low=0, unit="metres", about="greatest distance from an agent's rim to a box to hold or lock"
    )

    def archetypes(self) -> Iterable[Archetype]:
        """What agents hold, and one more component for boxes."""
        return [Archetype("agent", (Weld(),)), Archetype("box", (Handled(),))]

    def singletons(self) -> Iterable[Singleton]:
        """What agents do, and what comes of it."""
        return [Handle(), BoxLocked()]

    def fields(self):
        """Numbers in the agents' own row, and in the rows of boxes."""
        return {"own": HOLDS, "boxes": LOCKS}

    def bounds(self, layout):
        """Of locked, 1 is by the agent's own side, -1 by another one."""
        return {"own": {"holds": (0, 1)}, "boxes": {"held": (0, 1), "locked": (-1, 1)}}

    def looks(self):
        """Locked boxes have the colour of the side that locked them, and lines show who holds what."""
        return {"agent": Look(line_to=Weld.other), "box": Look(tint=Handled.locked_by)}

    def idle_actions(self, worlds):
        """For action masks: the dead do nothing."""
        return dict.fromkeys(("grab", "lock"), inactive(worlds))

    def check(self, layout):
        """What would have no effect is refused."""
        if not layout.numbers("boxes")["dynamic"]:
            raise NumberError("handling: no box can be moved; set boxes_dynamic=True")


@kernel
def pick(bodies, members, sight, handled, i, e, reach, locked_by, free) -> int:
    """The nearest box that agent `e` sees and reaches, with that lock, or NOBODY. free: of those that nobody holds."""
    found, least = NOBODY, reach
    for k in range(within(bodies, members, e, reach)):
        box = bodies.rows[k]
        known = sight.mode[0] == OMNISCIENT or is_set(sight.visible, i, box)
        fits = handled.locked_by[box] == locked_by and not (free and handled.holder[box] >= 0)
        if known and fits and distance(bodies, e, box) <= least:
            found, least = box, distance(bodies, e, box)
    return found


@kernel
def release(welds, handled, e) -> None:
    """Agent `e` holds nothing from now on."""
    if welds.other[e] >= 0:
        handled.holder[welds.other[e]] = NOBODY
        let_go(welds, e)


@Handling.system(Phase.DRIVE, after=(Body, "preparation"))
def handle(
    welds: Write[Weld],
    handled: Write[Handled],
    body: Write[Body],
    solid: Write[Solid],
    events: Write[BoxLocked],
    action: Read[Handle],
    sight: Read[Sight],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Weld],
    boxes: Rows[Handled],
    members: Bitset[Handled],
    bodies: Bodies,
    reach: float,
) -> None:
    """Locks first: a locked box is as static as walls are. Then hands close and open; physics does the rest."""
    for box in boxes:
        if not entities.alive[box]:  # it is broken: if it is set up again, it is not locked
            handled.locked_by[box] = NOBODY
            free(solid, box)
    for i in range(agents.size):
        e, own, locks = agents[i], side.side[agents[i]], action.lock[i] > 0
        if entities.alive[e] and action.lock[i] != 0:
            box = pick(bodies, members, sight, handled, i, e, reach, NOBODY if locks else own, False)
            if box >= 0:
                if handled.holder[box] >= 0:
                    release(welds, handled, handled.holder[box])
                handled.locked_by[box] = own if locks else NOBODY
                fix(solid, body, box)
                if not locks:
                    free(solid, box)
                k = emit(events)
                events.agent[k], events.box[k], events.locked[k] = e, box, locks
    for i in range(agents.size):
        e = agents[i]
        if action.grab[i] == 0 or not entities.alive[e] or (welds.other[e] >= 0 and not entities.alive[welds.other[e]]):
            release(welds, handled, e)
        elif welds.other[e] < 0:
            box = pick(bodies, members, sight, handled, i, e, reach, NOBODY, True)
            if box >= 0:
                hold(welds, body, e, box)
                handled.holder[box] = e


@kernel
def holds(i, e, welds: Read[Weld]) -> int:
    """Whether agent `e` holds a box: in its own row, and in its copies that the others see."""
    return 1 if welds.other[e] >= 0 else 0


@kernel
def held(i, box, handled: Read[Handled]) -> int:
    """Whether somebody holds a box."""
    return 1 if handled.holder[box] >= 0 else 0


@kernel
def locked(i, box, handled: Read[Handled], side: Read[Side], agents: Rows[Side]) -> int:
    """1: locked by the side of agent number `i`, -1: by another one."""
    return 0 if handled.locked_by[box] < 0 else 1 if handled.locked_by[box] == side.side[agents[i]] else -1


HOLDS = more_fields(Handling, SelfView, "own", Side, holds=holds)
LOCKS = more_fields(Handling, BoxView, "boxes", Handled, held=held, locked=locked)


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
