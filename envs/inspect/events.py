"""Events of the last tick of a world, read from its state."""

from dataclasses import asdict, dataclass

from outlast import systems
from outlast.components import Box, BoxItem, Death, End, Heal, Health, Item, Score, Side, Weapon
from outlast.ecs import Clock, Worlds

from ..rendering.scene import Scene
from .trace import Bodies, Json, bodies_of


@dataclass(frozen=True)
class Event:
    """An event.

    kind: start (of an episode), kill (a death caused by another side), death (any other one), heal, place (a box), use
    (another item), break (a box), end. agent: who died, used or broke something; by: the agent that killed; side: the
    one that killed or broke, and at the end the only one that is left; object: the item or box. All are numbers, -1:
    nobody, none, or not known. cause: the damage type of a death; of an end "terminated" or "truncated".
    """

    kind: str
    agent: int = -1
    by: int = -1
    side: int = -1
    object: int = -1
    cause: str = ""


def events(worlds: Worlds, w: int) -> list[Json]:
    """What happened in the last tick of world `w`, as dicts, in the order of the tick: see Event."""
    scene, bodies = Scene(worlds, w), bodies_of(worlds.layout)
    if not scene[Clock].tick[0]:
        return [asdict(Event("start"))]
    found = [*_uses(scene, bodies), *_breaks(scene, bodies), *_deaths(scene, bodies), *_end(scene)]
    return [asdict(event) for event in found]


def _uses(scene: Scene, bodies: Bodies) -> list[Event]:
    if Item not in scene:
        return []
    user = scene[Item].user
    kinds = {**dict.fromkeys(scene.rows(Heal), "heal"), **dict.fromkeys(scene.rows(BoxItem), "place")}
    return [
        Event(kinds.get(e, "use"), agent=bodies.numbers[user[e]], object=bodies.object_number(e))
        for e in scene.rows(Item)
        if user[e] >= 0
    ]


def _breaks(scene: Scene, bodies: Bodies) -> list[Event]:
    if Box not in scene:
        return []
    broken = [e for e in scene.rows(Box) if scene[Box].broken[e]]
    sides = [scene[Health].source[e] for e in broken]
    return [
        Event("break", agent=_striker(scene, bodies, e, side), side=side, object=bodies.object_number(e))
        for e, side in zip(broken, sides, strict=True)
    ]


def _deaths(scene: Scene, bodies: Bodies) -> list[Event]:
    if Death not in scene:
        return []
    death, causes = scene[Death], scene.worlds.layout.damage_types
    found = []
    for i, e in enumerate(bodies.agents):
        if death.now[e]:
            side, cause = death.source[e], causes[death.damage_type[e]] if death.damage_type[e] >= 0 else ""
            struck = systems.Melee in scene and cause == systems.Melee.damage_type
            by = _striker(scene, bodies, e, side) if struck else _sole_member(scene, bodies, side)
            kind = "kill" if side >= 0 and side != scene[Side].side[e] else "death"
            found.append(Event(kind, agent=i, by=by, side=side, cause=cause))
    return found


def _striker(scene: Scene, bodies: Bodies, e: int, side: int) -> int:
    """The agent of `side` that struck row `e`; of several the last one, whose strike counts."""
    if Weapon not in scene:
        return -1
    target, sides = scene[Weapon].target, scene[Side].side
    return max((i for i, row in enumerate(bodies.agents) if target[row] == e and sides[row] == side), default=-1)


def _sole_member(scene: Scene, bodies: Bodies, side: int) -> int:
    """The agent that is all of its side, if it is."""
    members = [i for i, row in enumerate(bodies.agents) if scene[Side].side[row] == side]
    return members[0] if len(members) == 1 else -1


def _end(scene: Scene) -> list[Event]:
    if End not in scene or not (scene[End].terminated[0] or scene[End].truncated[0]):
        return []
    left = [s for s, alive in enumerate(scene[Score].alive) if alive] if Score in scene else []
    cause = "terminated" if scene[End].terminated[0] else "truncated"
    return [Event("end", side=left[0] if len(left) == 1 else -1, cause=cause)]
