"""Events of the last tick of a world, for pages."""

from dataclasses import asdict, dataclass
from typing import Any

from outlast.components import (
    BoxBroken,
    BoxItem,
    BoxPlaced,
    Death,
    End,
    Heal,
    Hit,
    ItemDropped,
    ItemGiven,
    ItemPicked,
    ItemUsed,
    Score,
    Side,
    Strike,
)
from outlast.ecs import Clock, Worlds

from ..rendering.scene import Scene
from .event_table import event_table
from .world_json import Bodies, Json, bodies_of

# pages show these in their own way, so `_others` leaves them out
KNOWN = (BoxBroken, BoxPlaced, Death, Hit, ItemDropped, ItemGiven, ItemPicked, ItemUsed, Strike)


@dataclass(frozen=True)
class PageEvent:
    """An event.

    kind: start (of an episode), kill (a death caused by another side), death (any other death), heal, place (a box),
    use (any other item), break (a box), other (an event of a user's mechanic), end. agent: the agent that died, used an
    item, broke a box or did something else; by: the agent that killed; side: the side that killed or broke, for an end
    the only remaining side; object: the item or box. These are numbers; -1 means none or unknown. cause: for
    a death the damage type; for an end "terminated", "truncated" or "rule"; for `other` the event in words.
    """

    kind: str
    agent: int = -1
    by: int = -1
    side: int = -1
    object: int = -1
    cause: str = ""


def events(worlds: Worlds, w: int) -> list[Json]:
    """Return the events of the last tick of world `w`, as dicts of PageEvent's fields, in the order of the tick."""
    scene, bodies = Scene(worlds, w), bodies_of(worlds.layout)
    found = [] if scene[Clock].tick[0] else [PageEvent("start")]
    found += [_use(scene, bodies, event) for event in scene.events(ItemUsed)]
    found += [_break(bodies, event) for event in scene.events(BoxBroken)]
    found += [_death(scene, bodies, event) for event in scene.events(Death) if bodies.agent_number(event.agent) >= 0]
    found += [*_others(scene, bodies), *_end(scene)]
    return [asdict(event) for event in found]


def _use(scene: Scene, bodies: Bodies, event: Any) -> PageEvent:
    kinds = {"heal": Heal, "place": BoxItem}
    kind = next((kind for kind, component in kinds.items() if event.item in scene.rows(component)), "use")
    return PageEvent(kind, agent=bodies.agent_number(event.agent), object=bodies.object_number(event.item))


def _break(bodies: Bodies, event: Any) -> PageEvent:
    by, box = bodies.agent_number(event.by), bodies.object_number(event.box)
    return PageEvent("break", agent=by, side=event.side, object=box)


def _death(scene: Scene, bodies: Bodies, event: Any) -> PageEvent:
    cause = scene.worlds.layout.labels["damage_type"][event.damage_type] if event.damage_type >= 0 else ""
    kind = "kill" if event.side >= 0 and event.side != scene[Side].side[event.agent] else "death"
    agent, by = bodies.agent_number(event.agent), bodies.agent_number(event.by)
    return PageEvent(kind, agent=agent, by=by, side=event.side, cause=cause)


def _others(scene: Scene, bodies: Bodies) -> list[PageEvent]:
    """Return the events of a user's mechanics, in words; an acting agent is given as `agent`, not in words."""
    found = []
    for kind in scene.worlds.layout.events:
        if kind in KNOWN and kind is not Death:
            continue
        entries = [*enumerate(scene.events(kind))]
        if kind is Death:  # `_death` shows deaths of agents, but other entities die, too
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
            found.append(PageEvent("other", agent=agent, cause=cause))
    return found


def _end(scene: Scene) -> list[PageEvent]:
    if not scene[Clock].tick[0] or End not in scene or not (scene[End].terminated[0] or scene[End].truncated[0]):
        return []
    left = [s for s, alive in enumerate(scene[Score].alive) if alive] if Score in scene else [-1, -1]
    cause = "truncated" if not scene[End].terminated[0] else "rule" if len(left) > 1 else "terminated"
    return [PageEvent("end", side=left[0] if len(left) == 1 else -1, cause=cause)]
