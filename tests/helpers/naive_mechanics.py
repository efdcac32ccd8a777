"""Naive plain-Python forms of the mechanics, from the reference rules: one entity at a time, float64, unoptimized.

Each takes a World and changes it as the tick should. Where the rounding of float32 might decide otherwise, they raise
Ambiguous, or list it: see ambiguity. How bodies move, and where items of dead agents fall, is up to two functions that
`tick` is given.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from tests.helpers.ambiguity import ambiguous, unambiguous, within
from tests.helpers.naive_geometry import NO_HIT, ray_box, ray_circle
from tests.helpers.naive_world import TOLERANCE, Loss, NaiveEntity, World

Actions = Sequence[dict[str, int]]
Move = Callable[[World, Actions], None]  # moves all bodies
Fall = Callable[[World, NaiveEntity, NaiveEntity], tuple[float, float]]  # where an item falls from an agent that dies


def distance(a: Any, b: Any) -> float:
    return math.dist((a.x, a.y), (b.x, b.y))


def ahead(entity: NaiveEntity, far: float) -> tuple[float, float]:
    """The vector straight ahead; a right angle is exact, though float32 cannot hold one."""
    return far * _whole(math.cos(entity.angle)), far * _whole(math.sin(entity.angle))


def _whole(number: float) -> float:
    return round(number) if abs(number - round(number)) < 1e-7 else number


def entry(origin: tuple[float, float], ray: tuple[float, float], entity: NaiveEntity, offset: float = 0.0) -> float:
    """Fraction at which the ray enters the entity, enlarged by `offset`; NO_HIT if it does not, or starts inside."""
    if 0 < math.hypot(*ray) < 1e-3:
        ambiguous("a short ray")
    if entity.radius > 0:
        return ray_circle(origin, ray, (entity.x, entity.y), entity.radius + offset)
    half = entity.half_width + offset, entity.half_height + offset
    return ray_box(origin, ray, (entity.x, entity.y), entity.angle, *half)


def first_on_ray(
    origin: tuple[float, float], ray: tuple[float, float], entities: Sequence[NaiveEntity]
) -> NaiveEntity | None:
    """The entity that the ray meets first; of several that it meets at the same place, the first in order."""

    def ask(offset: float) -> int:
        entries = [entry(origin, ray, entity, offset) for entity in entities]
        return entries.index(min(entries)) if min(entries, default=NO_HIT) < NO_HIT else -1

    met = unambiguous(ask)
    return None if met < 0 else entities[met]


def hurt(world: World, entity: NaiveEntity, amount: int, damage_type: str, side: int) -> None:
    """Take hit points. To blame is the last loss of the tick in which they fell to 0 or below; else the last of all."""
    if not amount:
        return
    before, entity.health = entity.health, entity.health - amount
    entity.losses.append(Loss(world.tick, world.damage_types.index(damage_type), side, before, entity.health))
    blame = entity.losses[-1]
    if entity.health <= 0:
        fatal = [loss.tick for loss in entity.losses if loss.before > 0 >= loss.after][-1]
        blame = [loss for loss in entity.losses if loss.tick == fatal][-1]
    entity.damage_type, entity.source = blame.damage_type, blame.side


def is_immune(world: World, entity: NaiveEntity, side: int) -> bool:
    """Team mates do not hurt each other; only its owner hurts an owned box."""
    return (world.teams and entity.side == side) or (entity.owner >= 0 and entity.owner != side)


def respawn_items(world: World) -> None:
    """Turn boxes that broke in the tick before into items, where they stood."""
    for box in world.of("box"):
        if box.broken:
            item = world.of("box_item")[box.index]
            item.here, item.x, item.y = True, box.x, box.y
            box.broken = False


def use(world: World, actions: Actions) -> None:
    """Let agents use the last item of their bags: a heal heals, a box item sets up its box ahead of the user."""
    for agent in world.live("agent"):
        if not actions[agent.index]["use"] or not agent.bag:
            continue
        item = world.entities[agent.bag.pop()]
        item.holder = -1
        world.used.append(item.row)
        if item.kind == "heal":
            agent.health += world.numbers["heals_amount"]
            world.statistics["heals_used"] += 1
        else:
            x, y = ahead(agent, world.own(agent)["boxes_offset"])
            box = world.of("box")[item.index]
            box.here, box.x, box.y, box.angle = True, agent.x + x, agent.y + y, 0.0
            box.vx = box.vy = box.omega = 0.0
            box.placed = True
            box.health, box.losses = world.numbers["boxes_toughness"], []
            world.statistics["boxes_placed"] += 1
    for agent in world.of("agent"):
        agent.health = min(agent.health, world.own(agent)["mortality_limit"] or math.inf)


def give(world: World, actions: Actions) -> None:
    """Let all agents choose takers; then the last items change hands, in order. A full taker takes nothing."""
    givers = [
        a for a in world.live("agent") if actions[a.index]["give"] and (a.bag or world.numbers["give_last_passes_on"])
    ]
    for giver, taker in [(giver, choose_taker(world, giver)) for giver in givers]:
        if taker and giver.bag and len(taker.bag) < slots(world, taker):
            taker.bag.append(giver.bag.pop())
            world.entities[taker.bag[-1]].holder = taker.row


def slots(world: World, agent: NaiveEntity) -> int:
    """How many items fit into an agent's bag."""
    numbers = world.own(agent)
    found: int = numbers["inventory_capacity"] or numbers["inventory_slots"]
    return found


def choose_taker(world: World, giver: NaiveEntity) -> NaiveEntity | None:
    """The nearest suitable agent; or, by the other rule, the nearest body of any kind if that is a suitable agent."""

    def suits(entity: NaiveEntity) -> bool:
        return entity.kind == "agent" and (not world.teams or entity.side == giver.side)

    others = [entity for entity in world.entities if entity.here and entity is not giver]
    if world.numbers["give_last_nearest"] == "suitable":
        others = [entity for entity in others if suits(entity)]
    near = [entity for entity in others if within(distance(giver, entity), world.own(giver)["give_last_reach"])]
    if not near:
        return None
    nearest = min(near, key=lambda entity: distance(giver, entity))
    for entity in near:
        if entity is not nearest and 0 < distance(giver, entity) - distance(giver, nearest) < TOLERANCE:
            ambiguous("two are equally near")
    return nearest if suits(nearest) else None


def melee(world: World, actions: Actions) -> None:
    """Let all agents look first, and then all strike, in order. After a strike that met something, the weapon rests."""
    blows = []
    for agent in world.of("agent"):
        if agent.wait > 0:
            agent.wait -= 1
        elif agent.here and actions[agent.index]["attack"]:
            strike = ahead(agent, world.own(agent)["melee_reach"])
            target = first_on_ray((agent.x, agent.y), strike, in_the_way(world, agent))
            if target:  # a wall inside of the room may be in the way
                target = first_on_ray((agent.x, agent.y), strike, [target, *world.live("inner_wall")])
                agent.wait = world.own(agent)["melee_cooldown"]
                blows.append((agent, target))
    for agent, target in blows:
        if target.health is not None and not is_immune(world, target, agent.side):
            hurt(world, target, world.own(agent)["melee_damage"], "melee", agent.side)


def in_the_way(world: World, agent: NaiveEntity) -> list[NaiveEntity]:
    """What can stop the melee of `agent`: everything or, if melee is not blocked, only what it can hurt."""
    others = [entity for entity in world.entities if entity.here and entity is not agent]
    if world.numbers["melee_blocked"]:
        return others
    return [entity for entity in others if entity.health is not None and not is_immune(world, entity, agent.side)]


def break_boxes(world: World) -> None:
    """Break boxes without health; the side that first breaks a box owns it.

    A box that was set up in this tick is not harmed yet, if boxes settle.
    """
    used = [world.entities[row] for row in world.used]
    new = [item.index for item in used if item.kind == "box_item"]
    for box in world.live("box"):
        if world.numbers["boxes_settles"] and box.index in new:
            box.health, box.losses = world.numbers["boxes_toughness"], []
        if box.health <= 0:
            box.here, box.broken = False, True
            if world.numbers["boxes_owned"] and box.owner < 0:
                box.owner = box.source


def die(world: World, fall: Fall) -> None:
    """Remove agents without health. Their items fall, the last one first."""
    for agent in world.live("agent"):
        if agent.health > 0:
            continue
        agent.here = False
        world.deaths.append((agent.index, agent.damage_type, agent.source))
        while agent.bag:
            item = world.entities[agent.bag.pop()]
            item.holder, item.here = -1, True
            item.x, item.y = fall(world, item, agent)
            world.fallen.append((item.row, agent.row))


def pick_up(world: World) -> None:
    """Let all agents take what is in reach, while their bags have room."""
    fallen = [row for row, _ in world.fallen]
    for agent in world.live("agent"):
        for item in world.live("box_item", "heal"):
            reach = world.own(agent)["pickup_reach"] + (item.radius if world.numbers["pickup_touch"] else 0)
            if item.row in fallen and abs(distance(agent, item) - reach) < TOLERANCE:
                ambiguous("an item fell to where reach ends")
            if within(distance(agent, item), reach) and len(agent.bag) < slots(world, agent):
                agent.bag.append(item.row)
                item.here, item.holder = False, agent.row


def zone_at(world: World, tick: int) -> list[float]:
    """x, y, radius and next x, y, radius at the end of step `tick`, from the calendar."""
    radii = [*world.numbers["safe_zone_radii"], 0.0]
    stand, shrink = world.numbers["safe_zone_stand"], world.numbers["safe_zone_shrink"]
    circles = [(*centre, radius) for centre, radius in zip(world.centres, radii, strict=True)]
    phase = tick // (stand + shrink)
    if phase >= len(radii) - 1:
        return [*circles[-1], 0.0, 0.0, 0.0]
    late = tick % (stand + shrink) - stand
    share = late / shrink if late > 0 else 0.0
    old, new = circles[phase : phase + 2]
    return [*((1 - share) * a + share * b for a, b in zip(old, new, strict=True)), *new]


def zone_damage(world: World) -> None:
    """Hurt agents outside of the zone as it was a tick ago; in the void phase, all are outside."""
    x, y, radius = zone_at(world, world.tick - 1)[:3]
    for agent in world.live("agent"):
        if radius == 0 or not within(math.dist((agent.x, agent.y), (x, y)), radius):
            hurt(world, agent, world.own(agent)["safe_zone_damage"], "zone", -1)


def tick(world: World, actions: Actions, move: Move, fall: Fall, see: Callable[[World], list[set[int]]]) -> World:
    """The world that comes out of `world` by one step, in the order of section 2 of the rules."""
    world = world.copy()
    world.tick += 1
    world.deaths, world.used, world.fallen = [], [], []
    respawn_items(world)
    use(world, actions)
    give(world, actions)
    melee(world, actions)
    move(world, actions)
    break_boxes(world)
    world.seen = see(world)
    die(world, fall)
    pick_up(world)
    zone_damage(world)
    world.zone = zone_at(world, world.tick)
    return world
