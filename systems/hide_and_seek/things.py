"""Things: crates, planks and ramps; agents push them, hold and carry them, and lock them for their own side."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Look, Material, Phase, SelfView, Shape, Side, Sight, Solid, Spawned, Weld
from outlast.components.contact import fix, free
from outlast.components.hide_and_seek import NOBODY, Aloft, Crate, Handle, Locked, Movable, OutOfReach, Ramp
from outlast.components.joint import hold, let_go
from outlast.components.limits import FAR, HEAVY, LIGHT, MANY
from outlast.components.sight import OMNISCIENT, is_set
from outlast.ecs import (
    Archetype,
    Array,
    Bitset,
    Entity,
    Field,
    Layout,
    Module,
    Read,
    Rows,
    Singleton,
    Write,
    emit,
    kernel,
    number,
    ref,
)
from outlast.systems.geometry.bodies import Bodies
from outlast.systems.geometry.bounds import check_fits, ends, farthest_body
from outlast.systems.geometry.queries import distance, within
from outlast.systems.observation_rows import MOTION, more_fields, rows

KINDS = ("crate", "plank", "ramp")
LONG, THIN, SLOPE = 3.3, 0.3, 1.5  # sides of planks, and the length of ramps, in sides of a crate
GRABS = -2  # instead of a lock: any thing that can be held


@dataclass(frozen=True)
class Things(Module):
    """Crates, planks and ramps. Each counts from 0, and may vary.

    Sizes are those of the published environments (objects.py), where crates and planks are "boxes" and "elongated
    boxes". A ramp is as wide as a crate, and half as long again; theirs is a mesh.
    """

    crates: int = number(2, low=0, high=MANY, about="number of crates: squares")
    planks: int = number(0, low=0, high=MANY, about="number of planks: 3.3 times as long as a crate, 0.3 times as wide")
    ramps: int = number(1, low=0, high=MANY, about="number of ramps")
    size: float = number(0.5, low=0.1, high=FAR, unit="metres", about="side of a crate")
    density: float = number(
        1.0, low=LIGHT, high=HEAVY, unit="kilograms per square metre", about="density of crates, planks and ramps"
    )
    damping: float = number(
        6.0, low=0, high=FAR, unit="per second", about="share of its speed that a thing loses, by friction on the floor"
    )
    lockable_ramps: bool = number(False, about="ramps can be locked, too")

    def archetypes(self) -> Iterable[Archetype]:
        floor = Material(linear_damping=ref("damping"), angular_damping=ref("damping"))
        solid, half = Solid(dynamic=1, density=ref("density")), self.size / 2
        shapes = (half, half), (LONG * half, THIN * half), (SLOPE * half, half)
        marks = (Movable(), Crate()), (Movable(), Crate()), (Movable(lockable=ref("lockable_ramps")), Ramp())
        for kind, (width, height), parts in zip(KINDS, shapes, marks, strict=True):
            shape = Shape(half_width=width, half_height=height)
            yield Archetype(kind, (Body(), shape, solid, floor, Spawned(), *parts), ref(f"{kind}s"), order=20)

    def singletons(self) -> Iterable[Singleton]:
        return [CratesView(), RampsView()]

    def dims(self) -> dict[str, int | str]:
        squares, long = ref("crates"), ref("planks")
        return {"squares": squares, "planks": long, "crates": "squares + planks", "ramps": ref("ramps")}

    def looks(self) -> Mapping[str, Look]:
        """Return looks: a thing has the colour of the side that has locked it."""
        return {kind: Look(tint=Movable.locked_by) for kind in KINDS}

    def check(self, layout: Layout) -> None:
        check_fits(layout, "things.size", self.size, LONG * self.size if self.planks else SLOPE * self.size)

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return dict.fromkeys(("crates", "ramps"), ends(farthest_body(layout)))


@Things.system(Phase.SPAWN, after=Body)
def remember_start(movable: Write[Movable], body: Read[Body], things: Rows[Movable]) -> None:
    """Record the start positions of all things."""
    for e in things:
        movable.start_x[e], movable.start_y[e] = body.x[e], body.y[e]


CratesView = rows(Things, "crates", Crate, **MOTION, half_width=Shape.half_width, half_height=Shape.half_height)
RampsView = rows(Things, "ramps", Ramp, **MOTION)


@dataclass(frozen=True)
class Handling(Module):
    """Agents hold and lock the nearest thing that they see and reach (manipulation.py of the published environments).

    Several may hold one thing. A locked thing stands still until an agent of the side that has locked it unlocks it;
    holders let go of it. Agents aloft do not handle things.
    """

    reach: float = number(
        0.25, low=0, high=FAR, unit="metres", about="greatest distance between an agent and a thing to hold or lock"
    )

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Weld(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [Handle(), OutOfReach(), Locked()]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": HOLDS, "crates": CRATES, "ramps": RAMPS}

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        things = {"held": (0, 1), "locked": (-1, 1)}
        return {"own": {"holds": (0, 1)}, "crates": things, "ramps": things}

    def looks(self) -> Mapping[str, Look]:
        """Return looks: a line from an agent to the thing that it holds."""
        return {"agent": Look(line_to=Weld.other)}


@kernel
def pick(bodies: Any, things: Array, sight: Array, movable: Array, i: int, e: int, reach: Any, lock: int) -> int:
    """Return the nearest thing that agent `e`, number `i`, sees, reaches, and can handle; NOBODY without one.

    lock: the side by which it must be locked; NOBODY: a thing to lock; GRABS: a thing to hold.
    """
    found, least = NOBODY, np.float32(reach)
    for k in range(within(bodies, things, e, reach)):
        thing = bodies.rows[k]
        if sight.mode[0] != OMNISCIENT and not is_set(sight.visible, i, thing):
            continue
        owner = movable.locked_by[thing]
        if owner == NOBODY if lock == GRABS else owner == lock and (lock != NOBODY or movable.lockable[thing]):
            way = distance(bodies, e, thing)
            if found < 0 or way < least:
                found, least = thing, way
    return found


@kernel
def is_able(entities: Any, aloft: Any, e: int) -> bool:
    """Return whether an agent is alive and stands on the ground. aloft: the table of Aloft, or None."""
    if aloft is None:
        return bool(entities.alive[e])
    return bool(entities.alive[e] and aloft.ticks[e] == 0)


@Handling.system(Phase.DRIVE, after=(Body, "preparation"))
def handle(
    welds: Write[Weld],
    movable: Write[Movable],
    body: Write[Body],
    solid: Write[Solid],
    events: Write[Locked],
    action: Read[Handle],
    sight: Read[Sight],
    side: Read[Side],
    entities: Read[Entity],
    aloft: Read[Aloft] | None,
    agents: Rows[Weld],
    things: Bitset[Movable],
    bodies: Bodies,
    reach: float,
) -> None:
    """Lock and unlock, in order of agents; then let go and take hold. Physics moves held things."""
    for i in range(agents.size):
        e, wants = agents[i], action.lock[i]
        if wants == 0 or not is_able(entities, aloft, e):
            continue
        thing = pick(bodies, things, sight, movable, i, e, reach, NOBODY if wants > 0 else side.side[e])
        if thing < 0:
            continue
        if wants > 0:
            movable.locked_by[thing] = side.side[e]
            fix(solid, body, thing)
            for other in agents:
                if welds.other[other] == thing:
                    let_go(welds, other)
        else:
            movable.locked_by[thing] = NOBODY
            free(solid, thing)
        k = emit(events)
        events.agent[k], events.thing[k], events.locked[k] = e, thing, wants > 0
    for i in range(agents.size):
        e = agents[i]
        if action.grab[i] == 0 or not is_able(entities, aloft, e):
            let_go(welds, e)
        elif welds.other[e] < 0:
            thing = pick(bodies, things, sight, movable, i, e, reach, GRABS)
            if thing >= 0:
                hold(welds, body, e, thing)


@Handling.system(Phase.END)
def mask(
    idle: Write[OutOfReach],
    welds: Read[Weld],
    movable: Read[Movable],
    sight: Read[Sight],
    side: Read[Side],
    entities: Read[Entity],
    aloft: Read[Aloft] | None,
    agents: Rows[Weld],
    things: Bitset[Movable],
    bodies: Bodies,
    reach: float,
) -> None:
    """Mark agents that cannot hold a thing, or cannot lock or unlock one, by the rule of `handle`."""
    for i in range(agents.size):
        e = agents[i]
        near = is_able(entities, aloft, e) and within(bodies, things, e, reach) > 0
        grabs = welds.other[e] >= 0 or (near and pick(bodies, things, sight, movable, i, e, reach, GRABS) >= 0)
        locks = near and pick(bodies, things, sight, movable, i, e, reach, NOBODY) >= 0
        locks = locks or (near and pick(bodies, things, sight, movable, i, e, reach, side.side[e]) >= 0)
        idle.grab[i], idle.lock[i] = not grabs, not locks


@kernel
def holds(i: int, e: int, welds: Read[Weld]) -> int:
    """Return whether agent `e` holds a thing."""
    return 1 if welds.other[e] >= 0 else 0


@kernel
def held(i: int, thing: int, welds: Read[Weld], agents: Rows[Weld]) -> int:
    """Return whether any agent holds a thing."""
    for e in agents:
        if welds.other[e] == thing:
            return 1
    return 0


@kernel
def locked(i: int, thing: int, movable: Read[Movable], side: Read[Side], agents: Rows[Weld]) -> int:
    """Return 1 if the side of agent number `i` has locked a thing, -1 if another one has, otherwise 0."""
    owner = movable.locked_by[thing]
    return 0 if owner < 0 else 1 if owner == side.side[agents[i]] else -1


HOLDS = more_fields(Handling, SelfView, "own", Side, holds=holds)
CRATES = more_fields(Handling, CratesView, "crates", Crate, held=held, locked=locked)
RAMPS = more_fields(Handling, RampsView, "ramps", Ramp, held=held, locked=locked)
