"""A world as plain dictionaries that JSON can hold: all that a page needs to draw it and to list what agents have.

Objects are all bodies that are not agents: boxes, items, walls, marks on the floor. Agents are numbered from 0, and so
are objects. The number of a body is an agent's own, or an object's plus the number of agents.
"""

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from outlast import systems
from outlast.components import (
    Bag,
    Body,
    Box,
    BoxBroken,
    BoxItem,
    BoxPlaced,
    Death,
    End,
    Floor,
    Guard,
    Heal,
    Health,
    Hit,
    Item,
    ItemDropped,
    ItemGiven,
    ItemPicked,
    ItemUsed,
    Reward,
    Score,
    Shape,
    Side,
    Sides,
    Sight,
    Solid,
    Strike,
    Zone,
)
from outlast.components.health import can_hurt
from outlast.components.sight import OMNISCIENT
from outlast.ecs import Action, AgentRoles, Clock, Component, MemoryLayout, Worlds

from ..core.spaces import published
from ..rendering.bodies import POINT
from ..rendering.scene import Scene, has_size, of_kind, walls
from ..rendering.sight import blind_until, cone_corners, directions, distances, is_see_through, seen_rows
from ..rendering.style import css, ink_on, of_box, of_side
from ..rollout.table_file import event_table

Json = dict[str, Any]

ROLES: tuple[tuple[type[Component], str], ...] = (
    (Box, "box"),
    (BoxItem, "box_item"),
    (Heal, "heal"),
    (Item, "item"),
    (Solid, "wall"),
)
CIRCLES = ("x", "y", "radius", "next_x", "next_y", "next_radius")  # columns of Zone, in the order of snapshot's `zone`
DIGITS = 4  # decimals to which metres and radians are rounded
SECONDS = 1 / 30  # length of a tick in a game without physics
NONE = {"agent": -1, "by": -1, "side": -1, "object": -1, "cause": ""}  # of an event, what it does not have
# pages show these in ways of their own, so `_others` leaves them out
KNOWN = (BoxBroken, BoxPlaced, Death, Hit, ItemDropped, ItemGiven, ItemPicked, ItemUsed, Strike)


@dataclass(frozen=True)
class Bodies:
    """The rows of agents and of objects, the archetype of each object, and the body number of each row (-1: none)."""

    agents: tuple[int, ...]
    objects: tuple[int, ...]
    kinds: tuple[str, ...]
    numbers: tuple[int, ...]

    def object_number(self, row: int) -> int:
        """Return the number of the object in this row."""
        return self.numbers[row] - len(self.agents)

    def agent_number(self, row: int) -> int:
        """Return the number of the agent in this row; -1 if it is not an agent's, or -1."""
        return self.numbers[row] if row >= 0 and self.numbers[row] < len(self.agents) else -1


@functools.lru_cache(maxsize=256)
def bodies_of(layout: MemoryLayout) -> Bodies:
    """Return the agents and objects of a layout, in order of rows."""
    agents = layout.rows(Body, Shape, Side).tolist()
    all_ = [(row, kind) for kind, span in layout.spans.items() for row in span]
    bodies = {*layout.rows(Body).tolist(), *layout.rows(Item).tolist()}
    objects = [(row, kind) for row, kind in all_ if row in bodies and row not in agents]
    numbers = {row: k for k, row in enumerate([*agents, *(row for row, _ in objects)])}
    rows, kinds = tuple(row for row, _ in objects), tuple(kind for _, kind in objects)
    return Bodies(tuple(agents), rows, kinds, tuple(numbers.get(row, -1) for row, _ in all_))


def describe(worlds: Worlds, w: int) -> Json:
    """Return what stays the same until the next reset of world `w`.

    half: metres from the middle to the edge of what is shown. room: the floor's side (of a rectangle the longer one),
    metres, 0: no floor. floor: [width, height], or []. seconds: length of a tick. teams: whether sides are teams.
    health: hit points at the start, 0: nothing does damage. slots: the size of a bag. reach: that of the melee,
    metres, 0: none. zone: whether there is one. cone: [[x, y]], corners of a vision cone, metres ahead and to the
    left; None without cameras, or if agents observe everything. rays: number of rays of an agent's lidar.
    damage_types: names by number. actions: [{name, low, high}], what an agent chooses in a tick. rewards, looks:
    whether there are any. sides: [{color, ink, box, name}], colours as CSS.

    agents: [{side, role, radius, hides, health, reach, cone, blind, rays}]: health, reach and cone as above, but of
    this agent; side -1: absent; role: its name, "" without roles; blind: the tick before which it sees nothing; rays:
    [[x, y]], the point one metre along each ray, ahead and to the left.

    objects: [{kind, role, radius, width, height, corners, hides, of, amount, health, color}]: role is box, box_item,
    heal, item, wall or other; radius 0: a rectangle (items and others without a size have the radius with which
    pictures draw them), or a polygon, which has corners, [[x, y]], metres ahead and to the left, counter-clockwise, and
    the width and height of the rectangle around it; hides: whether it blocks the view of cameras; of: the box that a
    box item was, -1: none; amount: hit points that a heal gives; health: hit points at the start, 0: cannot be damaged;
    color: as CSS, for items and others; else empty.
    """
    scene, bodies = Scene(worlds, w), bodies_of(worlds.layout)
    sides = scene[Side].side
    hurts, lidar = Health in scene and can_hurt(worlds.layout), systems.Lidar in scene
    points = scene.prefab(Health).points if hurts else [0] * worlds.dims["rows"]
    count = max([worlds.dims.get("sides", 0), *(sides[e] + 1 for e in bodies.agents)])
    floor = [_number(2 * side) for side in scene.sides] if Floor in scene else []
    roles = worlds.layout.roles
    physics = scene.mechanic(systems.Physics) if systems.Physics in scene else None

    def reach(e: int | None) -> float:
        return _number(scene.mechanic(systems.Melee, e).reach) if systems.Melee in scene else 0

    return {
        "half": _number(scene.half),
        "room": max(floor, default=0),
        "floor": floor,
        "seconds": physics.substeps / physics.rate if physics else SECONDS,
        "teams": bool(Sides in scene and scene[Sides].teams[0]),
        "health": points[bodies.agents[0]] if bodies.agents else 0,
        "slots": worlds.dims.get("slots", 0) if Bag in scene else 0,
        "reach": reach(None),
        "zone": Zone in scene,
        "cone": _cone(scene, None),
        "rays": worlds.dims["rays"] if lidar else 0,
        "damage_types": list(worlds.layout.labels["damage_type"]),
        "actions": [
            {"name": key, "low": int(column.low), "high": int(column.high)}
            for key, _, _, column in published(worlds, Action)
        ],
        "rewards": Reward in scene,
        "looks": bool(scene.looks),
        "sides": [
            {"color": css(color), "ink": css(ink_on(color)), "box": css(of_box(s)), "name": scene.side_name(s)}
            for s, color in enumerate(map(of_side, range(count)))
        ],
        "agents": [
            {
                "side": sides[e],
                "role": roles.names[number] if roles and (number := scene[AgentRoles].role[i]) >= 0 else "",
                "radius": _number(scene.shape.radius[e]),
                "hides": _hides(scene, e),
                "health": points[e],
                "reach": reach(e),
                "cone": _cone(scene, e),
                "blind": blind_until(scene, e),
                "rays": _points(directions(scene, e)) if lidar else [],
            }
            for i, e in enumerate(bodies.agents)
        ],
        "objects": [_object(scene, e, kind) for e, kind in zip(bodies.objects, bodies.kinds, strict=True)],
    }


def snapshot(worlds: Worlds, w: int) -> Json:
    """Return world `w` as it is now.

    episode, tick: from its clock. zone: [x, y, radius, next x, next y, next radius] or None.

    agents: [{x, y, angle, alive, health, bag, strike, target, sees, rays, action, reward}]: bag: numbers of objects,
    of which the last is the next to be used; strike: 1 if a strike of this tick met nothing, 2 if it met something, 0
    without a strike; target: the body that was met, -1: none; sees: numbers of bodies other than walls, None: all;
    rays: metres, as its lidar reads them; action: its action in this tick, without a meaning in tick 0 of an episode;
    reward: that of this tick, None: not finite.

    rings, lines: by number of the body, if some kind has a look (components.look): whether it has a ring, and the body
    to which a line goes, -1: none. Else both are empty.

    objects: [{x, y, angle, here, owner, wound}]: here: whether it is in the world, so neither in a bag nor broken;
    owner: a side, or that of its tint, -1: none; wound: hit points that it has lost.
    """
    scene, bodies = Scene(worlds, w), bodies_of(worlds.layout)
    zone = [_number(getattr(scene[Zone], name)[0]) for name in CIRCLES] if Zone in scene else None
    alive = set(scene.living(Body))
    targets = {strike.agent: strike.target for strike in scene.events(Strike)}
    actions = worlds.actions[:, w].T.tolist()
    rewards = scene[Reward].reward if Reward in scene else [0.0] * len(bodies.agents)
    looking = (*bodies.agents, *bodies.objects) if scene.looks else ()
    lines = [int(scene.looked_up(e, "line_to")) for e in looking]
    return {
        "episode": scene[Clock].episode[0],
        "tick": scene[Clock].tick[0],
        "zone": zone,
        "agents": [
            _agent(scene, bodies, i, e, e in alive, targets)
            | {"action": actions[i], "reward": rewards[i] if math.isfinite(rewards[i]) else None}
            for i, e in enumerate(bodies.agents)
        ],
        "objects": [
            _place(scene, e) | {"here": e in alive, "owner": _owner(scene, e), "wound": _wound(scene, e)}
            for e in bodies.objects
        ],
        "rings": [scene.looked_up(e, "ring") > 0 for e in looking],
        "lines": [bodies.numbers[row] if row >= 0 else -1 for row in lines],
    }


def _object(scene: Scene, e: int, kind: str) -> Json:
    role = next((role for component, role in ROLES if e in scene.rows(component)), "other")
    role = "other" if role == "wall" and e not in walls(scene, living=False) else role
    bodies, shape, own = bodies_of(scene.worlds.layout), scene.shape, role in ("item", "other")
    return {
        "kind": kind,
        "role": role,
        "radius": _number(POINT if own and not has_size(scene, e) else shape.radius[e]),
        "width": _number(2 * shape.half_width[e]),
        "height": _number(2 * shape.half_height[e]),
        "corners": _points(scene.corners(e)),
        "hides": _hides(scene, e),
        "of": bodies.object_number(scene.rows(Box)[scene[BoxItem].index[e]]) if role == "box_item" else -1,
        "amount": scene[Heal].amount[e] if role == "heal" else 0,
        "health": scene.prefab(Health).points[e] if _has_health(scene, e) else 0,
        "color": css(of_kind(scene, e)) if own else "",
    }


def _agent(scene: Scene, bodies: Bodies, i: int, e: int, alive: bool, targets: dict[int, int]) -> Json:
    """Return an agent's entry of `snapshot`. targets: the row that each strike met (-1: none), by the agent's row."""
    bag = scene[Bag].items[e][: scene[Bag].count[e]] if Bag in scene else []
    return _place(scene, e) | {
        "alive": alive,
        "health": scene[Health].points[e] if Health in scene and can_hurt(scene.worlds.layout) else 0,
        "bag": [bodies.object_number(row) for row in bag],
        "strike": (1 + (targets[e] >= 0) if e in targets else 0) if alive else 0,
        "target": bodies.numbers[targets[e]] if alive and targets.get(e, -1) >= 0 else -1,
        "sees": _seen(scene, bodies, i) if alive else [],
        "rays": [_number(far) for far in distances(scene, i)] if systems.Lidar in scene else [],
    }


def _wound(scene: Scene, e: int) -> int:
    return max(0, scene.prefab(Health).points[e] - scene[Health].points[e]) if _has_health(scene, e) else 0


def _has_health(scene: Scene, e: int) -> bool:
    return Health in scene and e in scene.rows(Health) and bool(scene.prefab(Health).has_health[e])


def _owner(scene: Scene, e: int) -> int:
    """Return the side that owns a box, or the item that a box became; -1: none."""
    if (tint := int(scene.looked_up(e, "tint"))) >= 0:
        return tint
    if e in scene.rows(BoxItem):
        e = scene.rows(Box)[scene[BoxItem].index[e]]
    return int(scene[Guard].vulnerable_only_to[e]) if e in scene.rows(Box, Guard) else -1


def _seen(scene: Scene, bodies: Bodies, i: int) -> list[int] | None:
    if Sight not in scene or scene[Sight].mode[0] == OMNISCIENT:
        return None
    return [bodies.numbers[row] for row in seen_rows(scene, i)]


def _hides(scene: Scene, e: int) -> bool:
    """Return whether a body blocks the view of cameras, see systems.cameras.see."""
    if systems.Cameras not in scene or not has_size(scene, e) or is_see_through(scene, e):
        return False
    return e in scene.rows(Shape, Solid) or bool(scene.mechanic(systems.Cameras).items_occlude)


def _cone(scene: Scene, e: int | None) -> list[list[float]] | None:
    """Return the corners of the vision cone of the agent in row `e`, or for None those of the scenario's numbers."""
    if systems.Cameras not in scene or scene[Sight].mode[0] == OMNISCIENT:
        return None
    return _points(cone_corners(scene.mechanic(systems.Cameras, e)))


def _place(scene: Scene, e: int) -> Json:
    body = scene.body
    return {"x": _number(body.x[e]), "y": _number(body.y[e]), "angle": _number(body.angle[e])}


def _points(points: Iterable[tuple[float, float]]) -> list[list[float]]:
    return [[_number(x), _number(y)] for x, y in points]


def _number(value: float) -> float:
    """Round a number; infinities and NaN, which JSON cannot express, become 0."""
    return round(value, DIGITS) if math.isfinite(value) else 0.0


def events(worlds: Worlds, w: int) -> list[Json]:
    """Return what happened in the last tick of world `w`: {kind, agent, by, side, object, cause}, in order.

    kind: start (of an episode), kill (a death caused by another side), death (any other death), heal, place (a box),
    use (any other item), break (a box), other (an event of a user's mechanic), end. agent: the agent that died, used an
    item, broke a box or did something else; by: the agent that killed; side: the side that killed or broke, for an end
    the only remaining side; object: the item or box. These are numbers; -1 means none or unknown. cause: for
    a death the damage type; for an end "terminated", "truncated" or "rule"; for `other` the event in words.
    """
    scene, bodies = Scene(worlds, w), bodies_of(worlds.layout)
    found: list[Json] = [] if scene[Clock].tick[0] else [{"kind": "start"}]
    for event in scene.events(ItemUsed):
        kind = "heal" if event.item in scene.rows(Heal) else "place" if event.item in scene.rows(BoxItem) else "use"
        used = {"agent": bodies.agent_number(event.agent), "object": bodies.object_number(event.item)}
        found.append({"kind": kind, **used})
    for event in scene.events(BoxBroken):
        by, box = bodies.agent_number(event.by), bodies.object_number(event.box)
        found.append({"kind": "break", "agent": by, "side": event.side, "object": box})
    for event in scene.events(Death):
        if (agent := bodies.agent_number(event.agent)) >= 0:
            cause = worlds.layout.labels["damage_type"][event.damage_type] if event.damage_type >= 0 else ""
            kind = "kill" if event.side >= 0 and event.side != scene[Side].side[event.agent] else "death"
            by = bodies.agent_number(event.by)
            found.append({"kind": kind, "agent": agent, "by": by, "side": event.side, "cause": cause})
    found += [*_others(scene, bodies), *_end(scene)]
    return [NONE | event for event in found]


def _others(scene: Scene, bodies: Bodies) -> list[Json]:
    """Return the events of a user's mechanics, in words; if an agent did something, it is `agent` and not in words."""
    found = []
    for kind in scene.worlds.layout.events:
        if kind in KNOWN and kind is not Death:
            continue
        entries = [*enumerate(scene.events(kind))]
        if kind is Death:  # those of agents have entries of their own, but other things die, too
            entries = [(k, entry) for k, entry in entries if bodies.agent_number(entry.agent) < 0]
        if not entries:
            continue
        rows = scene.worlds.entries(kind)
        table = event_table(scene.worlds.layout, {kind.name: rows[rows["world"] == scene.w]})
        for k, entry in entries:
            agent = bodies.agent_number(getattr(entry, kind.who)) if kind.who else -1
            who = "" if agent >= 0 else table["who"][k]
            words = [who, kind.name.replace("_", " "), *(table[name][k] for name in ("whom", "amount", "why", "more"))]
            cause = " ".join(str(word) for word in words if word not in ("", None))
            found.append({"kind": "other", "agent": agent, "cause": cause})
    return found


def _end(scene: Scene) -> list[Json]:
    if not scene[Clock].tick[0] or End not in scene or not (scene[End].terminated[0] or scene[End].truncated[0]):
        return []
    left = [s for s, alive in enumerate(scene[Score].alive) if alive] if Score in scene else [-1, -1]
    cause = "truncated" if not scene[End].terminated[0] else "rule" if len(left) > 1 else "terminated"
    return [{"kind": "end", "side": left[0] if len(left) == 1 else -1, "cause": cause}]
