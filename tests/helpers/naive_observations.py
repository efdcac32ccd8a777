"""Naive plain-Python forms of cameras, observations, rewards, ends and statistics."""

from typing import Any

from tests.helpers.ambiguity import ambiguous, unambiguous
from tests.helpers.naive_geometry import in_kite, in_sector
from tests.helpers.naive_mechanics import distance, entry
from tests.helpers.naive_world import NaiveEntity, World

STRETCH = 1 + 1e-6  # rules, section 3: the ray to a centre is this much longer


def see(world: World) -> list[set[int]]:
    """For each agent, the rows that its camera sees. Dead agents see nothing."""
    here = [entity for entity in world.entities if entity.here]
    eyes = [me if me.here else None for me in world.of("agent")]
    return [
        {entity.row for entity in here if entity is not me and sees(world, me, entity)} if me else set() for me in eyes
    ]


def sees(world: World, me: NaiveEntity, entity: NaiveEntity) -> bool:
    """Whether the entity's centre is in the cone, and nothing is nearer on the ray to it."""
    fov, depth = world.own(me)["cameras_fov"], world.own(me)["cameras_depth"]
    cone = in_kite if world.numbers["cameras_cone"] == "kite" else in_sector
    place, eye = (entity.x, entity.y), (me.x, me.y)
    if place == eye:
        return False
    if distance(me, entity) < 1e-3:
        ambiguous("two at nearly the same place")
    if not unambiguous(lambda offset: cone(place, eye, me.angle, depth + offset, fov / 2 + offset)):
        return False
    kinds = ("agent", "box", "wall", "inner_wall") + (
        ("box_item", "heal") if world.numbers["cameras_items_occlude"] else ()
    )
    others = [other for other in world.live(*kinds) if other is not me and other is not entity]
    ray = (entity.x - me.x) * STRETCH, (entity.y - me.y) * STRETCH

    def first(offset: float) -> bool:
        own = entry(eye, ray, entity, offset)
        return own <= 1 and not any(entry(eye, ray, other, -offset) < own for other in others)

    return unambiguous(first)


def agent_row(world: World, agent: NaiveEntity) -> list[float]:
    """id, [team], health, x, y, angle, vx, vy, omega; zeros after id and team once dead."""
    state = [agent.health, agent.x, agent.y, agent.angle, agent.vx, agent.vy, agent.omega]
    return [agent.index, *([agent.side] if world.teams else []), *(state if agent.here else [0] * 7)]


def corners(world: World, index: int, copied: bool) -> list[float]:
    """Vertices of box `index` as if centred at the origin, counter-clockwise from the lower left.

    copied: Whether it is not the box that stood there at reset; in the paper's runs, the first corner then comes last.
    """
    x, y = world.of("box")[index].half_width, world.of("box")[index].half_height
    vertices = [(-x, -y), (x, -y), (x, y), (-x, y)]
    if copied and world.numbers["boxes_corners"] == "rolled":
        vertices.append(vertices.pop(0))
    return [number for vertex in vertices for number in vertex]


def entity_row(world: World, entity: NaiveEntity) -> list[float]:
    """The row of an entity in observations, whether it is seen or not."""
    if entity.kind == "agent":
        return agent_row(world, entity)
    if entity.kind == "heal":
        return [entity.x, entity.y] if entity.here else [0] * 2
    outline = corners(world, entity.index, entity.kind == "box_item" or entity.placed)
    if entity.kind == "box":
        return [*outline, entity.x, entity.y, entity.angle] if entity.here else [0] * 11
    return [*outline, entity.x, entity.y] if entity.here else [0] * 10


def observe(world: World, i: int) -> dict[str, Any]:
    """What agent `i` observes, by key."""
    me = world.of("agent")[i]
    seen: dict[str, Any] = {"own": agent_row(world, me), "zone": world.zone}
    for key, kind in (("others", "agent"), ("heals", "heal"), ("boxes", "box"), ("box_items", "box_item")):
        entities = [entity for entity in world.of(kind) if entity is not me]
        if entities or kind == "agent":
            seen[f"{key}_mask"] = [int(is_masked_in(world, me, entity)) for entity in entities]
            secret = world.numbers["cameras_mode"] == "masked"
            rows = [(entity_row(world, entity), is_masked_in(world, me, entity) or not secret) for entity in entities]
            seen[key] = [row if shown else [0] * len(row) for row, shown in rows]
    last = world.entities[me.bag[-1]] if me.bag and me.here else None
    if world.of("heal"):
        heal = last is not None and last.kind == "heal"
        seen["heal_slot"], seen["heal_slot_mask"] = [[world.numbers["heals_amount"] if heal else 0]], [int(heal)]
    if world.of("box"):
        box = last is not None and last.kind == "box_item"
        seen["box_slot"], seen["box_slot_mask"] = [corners(world, last.index, True) if box else [0] * 8], [int(box)]
    return seen


def is_masked_in(world: World, me: NaiveEntity, entity: NaiveEntity) -> bool:
    """The mask: a living agent observes all that exists if it is omniscient, else only what its camera sees."""
    if not me.here or not entity.here:
        return False
    return world.numbers["cameras_mode"] == "omniscient" or entity.row in world.seen[me.index]


def alive(world: World, side: int) -> int:
    """Members of a side that live."""
    return sum(agent.side == side for agent in world.live("agent"))


def killed(world: World, side: int) -> int:
    """Enemies that a side killed in this tick."""
    agents = world.of("agent")
    return sum(source == side != agents[victim].side for victim, _, source in world.deaths)


def reward(world: World, i: int) -> float:
    """The reward of agent `i` for this tick, which is that of its side (paper, section 3.5)."""
    side, own = world.of("agent")[i].side, world.own(world.of("agent")[i])
    pay = {name.removeprefix("rewards_"): value for name, value in own.items() if name.startswith("rewards_")}
    total = pay["alive"] if alive(world, side) else pay["dead"]
    if pay["basis"] == "members":
        mates = [agent for agent in world.of("agent") if agent.side == side]
        total = sum(pay["alive"] if agent.here else pay["dead"] for agent in mates) / len(mates)
    if alive(world, side):
        fallen = {world.of("agent")[victim].side for victim, _, _ in world.deaths}
        total += pay["outlive"] * sum(not alive(world, other) for other in fallen)
    if alive(world, side) or pay["posthumous"]:
        total += pay["kill"] * killed(world, side)
    return total + pay["death"] * sum(world.of("agent")[victim].side == side for victim, _, _ in world.deaths)


def end(world: World) -> tuple[bool, bool]:
    """Whether the episode is terminated, and whether it is truncated."""
    standing = sum(alive(world, side) > 0 for side in range(world.sides))
    done = standing <= {"all dead": 0, "last alive": 1}[world.numbers["ending_rule"]]
    return done, not done and 0 < world.numbers["ending_limit"] <= world.tick


def statistics(world: World, before: dict[str, Any]) -> dict[str, Any]:
    """The statistics of the episode so far. before: Those of the tick before; the use of items is counted in `use`."""
    damage_types = [damage_type for _, damage_type, _ in world.deaths]
    return {
        "length": world.tick,
        "returns": [old + reward(world, i) for i, old in enumerate(before["returns"])],
        "kills": [old + killed(world, side) for side, old in enumerate(before["kills"])],
        "deaths": [old + damage_types.count(damage_type) for damage_type, old in enumerate(before["deaths"])],
        "first_death": before["first_death"] or (world.tick if world.deaths else 0),
        **{key: world.statistics[key] for key in ("heals_used", "boxes_placed") if key in before},
    }
