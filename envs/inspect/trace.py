"""Traces: what there is to show of a world, as plain dicts that JSON takes.

describe(worlds, w) is what stays the same during an episode, snapshot(worlds, w) is the state after a tick. Together
they are all that the page needs to draw the world and to list what agents have.

Things are all bodies that are not agents: boxes, items, walls. Agents and things are counted from 0, each for itself. A
body's number is that of the agent, or that of the thing plus the number of agents.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from outlast import systems
from outlast.components import (
    Attack,
    Bag,
    Body,
    Box,
    BoxItem,
    Floor,
    Guard,
    Heal,
    Health,
    Item,
    Shape,
    Side,
    Sides,
    Sight,
    Solid,
    Weapon,
    Zone,
)
from outlast.components.sight import OMNISCIENT
from outlast.ecs import Clock, Component, Layout, Worlds
from outlast.ecs.simd import SIMD_WIDTH

from ..rendering.css import css
from ..rendering.layers import Scene
from ..rendering.layers.palette import ink_on, of_box, of_side

Json = dict[str, Any]

ROLES: tuple[tuple[type[Component], str], ...] = (
    (Box, "box"),
    (BoxItem, "box_item"),
    (Heal, "heal"),
    (Item, "item"),
    (Solid, "wall"),
)
MARGIN = 1.04  # of what is shown over the room: bars of agents at a wall fit in
DIGITS = 4  # of metres and radians
SECONDS = 1 / 30  # a tick, where no bodies move


@dataclass(frozen=True)
class Cast:
    """Rows of everybody: agents, things, the kinds of things, and the body number of each row (-1: none)."""

    agents: tuple[int, ...]
    things: tuple[int, ...]
    kinds: tuple[str, ...]
    bodies: tuple[int, ...]

    def thing(self, row: int) -> int:
        """The number of the thing in this row."""
        return self.bodies[row] - len(self.agents)


@functools.lru_cache(maxsize=256)
def cast(layout: Layout) -> Cast:
    """Who takes part, in order of rows."""
    agents = layout.rows(Body, Shape, Side).tolist()
    all_ = [(row, kind) for kind, span in layout.spans.items() for row in span]
    bodies = {*layout.rows(Body, Shape).tolist(), *layout.rows(Item).tolist()}
    things = [(row, kind) for row, kind in all_ if row in bodies and row not in agents]
    numbers = {row: k for k, row in enumerate([*agents, *(row for row, _ in things)])}
    rows, kinds = tuple(row for row, _ in things), tuple(kind for _, kind in things)
    return Cast(tuple(agents), rows, kinds, tuple(numbers.get(row, -1) for row, _ in all_))


def describe(worlds: Worlds, w: int) -> Json:
    """What stays the same until the next reset of world `w`.

    half: metres from the middle to the edge of what is shown. room: side of the floor, metres, 0: none. seconds: of a
    tick. teams: whether sides are teams. health: hit points at birth. slots: of a bag. reach: of the melee, metres, 0:
    none. zone: whether there is one. cone: {kind, fov (radians), depth (metres)} or None. causes: of deaths, by number.
    sides: [{color, ink, box}] as CSS. agents: [{side, radius}]. things: [{kind, role, radius, width, height, of,
    amount, health}]: role is box, box_item, heal, item, wall or other; radius 0: a rectangle; of: the box that a box
    item was, -1: none; amount: hit points that a heal gives; health: hit points at birth, 0: cannot be damaged.
    """
    scene, who = Scene(worlds, w), cast(worlds.layout)
    sides = scene[Side].side
    count = max([worlds.dims.get("sides", 0), *(sides[e] + 1 for e in who.agents)])
    return {
        "half": _number(MARGIN * scene.room),
        "room": _number(2 * scene.room) if Floor in scene else 0,
        "seconds": _seconds(scene),
        "teams": bool(Sides in scene and scene[Sides].teams[0]),
        "health": scene.birth(Health).points[who.agents[0]] if Health in scene and who.agents else 0,
        "slots": worlds.dims.get("slots", 0) if Bag in scene else 0,
        "reach": _number(scene.mechanic(systems.Melee).reach) if systems.Melee in scene else 0,
        "zone": Zone in scene,
        "cone": _cone(scene),
        "causes": list(worlds.layout.causes),
        "sides": [
            {"color": css(of_side(s)), "ink": css(ink_on(of_side(s))), "box": css(of_box(s))} for s in range(count)
        ],
        "agents": [{"side": sides[e], "radius": _number(scene.shape.radius[e])} for e in who.agents],
        "things": [_thing(scene, e, kind) for e, kind in zip(who.things, who.kinds, strict=True)],
    }


def snapshot(worlds: Worlds, w: int) -> Json:
    """World `w` as it is now.

    episode, tick: of its clock. zone: [x, y, radius, next x, next y, next radius] or None. agents: [{x, y, angle,
    alive, health, bag, strike, target, sees}]: bag holds things, the last one is the one in use; strike is 0, or 1 for
    one that met nothing in this tick, 2 for one that met something; target: the body that it met, -1: none; sees holds
    numbers of bodies other than walls, None: all. things: [{x, y, angle, here, owner, wound}]: here: in the world, so
    not in a bag and not broken; owner: a side, -1: nobody; wound: hit points that it lacks.
    """
    scene, who = Scene(worlds, w), cast(worlds.layout)
    zone = [_number(column[0]) for column in scene[Zone][:6]] if Zone in scene else None
    alive = set(scene.living(Body, Shape))
    return {
        "episode": scene[Clock].episode[0],
        "tick": scene[Clock].tick[0],
        "zone": zone,
        "agents": [_agent(scene, who, i, e, e in alive) for i, e in enumerate(who.agents)],
        "things": [_place(scene, e) | _rest(scene, e, e in alive) for e in who.things],
    }


def _thing(scene: Scene, e: int, kind: str) -> Json:
    role = next((role for component, role in ROLES if e in scene.rows(component)), "other")
    who, shape = cast(scene.worlds.layout), scene.shape
    return {
        "kind": kind,
        "role": role,
        "radius": _number(shape.radius[e]),
        "width": _number(2 * shape.half_width[e]),
        "height": _number(2 * shape.half_height[e]),
        "of": who.thing(scene.rows(Box)[scene[BoxItem].index[e]]) if role == "box_item" else -1,
        "amount": scene[Heal].amount[e] if role == "heal" else 0,
        "health": scene.birth(Health).points[e] if _mortal(scene, e) else 0,
    }


def _agent(scene: Scene, who: Cast, i: int, e: int, alive: bool) -> Json:
    bag = scene[Bag].items[e][: scene[Bag].count[e]] if Bag in scene else []
    return _place(scene, e) | {
        "alive": alive,
        "health": scene[Health].points[e] if Health in scene else 0,
        "bag": [who.thing(row) for row in bag],
        "strike": _strike(scene, i, e) if alive else 0,
        "target": _target(scene, who, e) if alive else -1,
        "sees": _seen(scene, who, i) if alive else [],
    }


def _rest(scene: Scene, e: int, here: bool) -> Json:
    lost = scene.birth(Health).points[e] - scene[Health].points[e] if _mortal(scene, e) else 0
    return {"here": here, "owner": _owner(scene, e), "wound": max(0, lost)}


def _mortal(scene: Scene, e: int) -> bool:
    return Health in scene and e in scene.rows(Health) and bool(scene.birth(Health).mortal[e])


def _owner(scene: Scene, e: int) -> int:
    """The side that owns a box, or the item that a box became."""
    if e in scene.rows(BoxItem):
        e = scene.rows(Box)[scene[BoxItem].index[e]]
    return int(scene[Guard].heeds[e]) if e in scene.rows(Box, Guard) else -1


def _strike(scene: Scene, i: int, e: int) -> int:
    if not (Weapon in scene and Attack in scene and scene[Clock].tick[0]):
        return 0  # in the tick of a reset the actions are those of the episode before
    weapon = scene[Weapon]
    return 2 if weapon.target[e] >= 0 else int(scene[Attack].attack[i] != 0 and not weapon.wait[e])


def _target(scene: Scene, who: Cast, e: int) -> int:
    row = scene[Weapon].target[e] if Weapon in scene and scene[Clock].tick[0] else -1
    return who.bodies[row] if row >= 0 else -1


def _seen(scene: Scene, who: Cast, i: int) -> list[int] | None:
    if Sight not in scene or scene[Sight].mode[0] == OMNISCIENT:
        return None
    alive = _present(scene)
    rows = (SIMD_WIDTH * g + j for g, word in enumerate(scene[Sight].seen[i]) for j in _ones(word))
    return [who.bodies[row] for row in rows if row in alive]


def _present(scene: Scene) -> set[int]:
    """Rows of what is in the world and worth a look: not walls, which are seen too."""
    return {e for kind in (Side, Box, Item) for e in scene.living(Body, kind)}


def _ones(word: int) -> Iterator[int]:
    return (j for j in range(SIMD_WIDTH) if word >> j & 1)


def _cone(scene: Scene) -> Json | None:
    if systems.Cameras not in scene:
        return None
    cameras = scene.mechanic(systems.Cameras)
    return {"kind": cameras.cone, "fov": _number(cameras.fov), "depth": _number(cameras.depth)}


def _seconds(scene: Scene) -> float:
    if systems.Contacts not in scene:
        return SECONDS
    contacts = scene.mechanic(systems.Contacts)
    return contacts.substeps / contacts.rate


def _place(scene: Scene, e: int) -> Json:
    body = scene.body
    return {"x": _number(body.x[e]), "y": _number(body.y[e]), "angle": _number(body.angle[e])}


def _number(value: float) -> float:
    """Rounded; JSON knows no infinities, and nothing is drawn at them."""
    return round(value, DIGITS) if math.isfinite(value) else 0.0
