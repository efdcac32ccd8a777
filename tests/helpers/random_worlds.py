"""Random worlds for the naive forms, in states that play could reach, if only barely; and ticks played from them."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import outlast
from outlast import systems

from outlast.components import (  # isort: skip
    Bag, Body, Box, Episode, Guard, Health, Item, Kills, Reward, Shape, Solid, Wall, Weapon, Zone,
)  # fmt: skip
from outlast.components.inventory import CLOSED
from outlast.components.score import End
from outlast.distributions import choice, integers, uniform
from outlast.ecs import Clock, Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.conftest import draw_actions, scaled
from tests.helpers import naive_mechanics, naive_observations
from tests.helpers.ambiguity import Ambiguous
from tests.helpers.naive_walls import blocks, signed_distance
from tests.helpers.naive_world import World, differences, read
from tests.reference.random_numbers import scattered

COUNT = scaled(160, least=80)  # worlds of each kind
TICKS = 3  # played from each random state
KEYS = ("ahead", "left", "turn", "attack", "use", "give")

# Numbers as in the paper's runs, and as in its text, which are the mechanics' defaults. Neither compiles anything anew.
RUNS = {"agents_count": 5, "boxes_count": 6, "heals_count": 9, "rewards_kill": 100.0, "rewards_death": -100.0}
TEXT = RUNS | {
    "melee_blocked": False, "melee_damage": 20, "melee_cooldown": 2, "give_last_nearest": "suitable",
    "pickup_touch": True, "death_drop_scatter": "disc",
    "cameras_cone": "sector", "cameras_items_occlude": False, "cameras_mode": "revealed",
    "boxes_offset": 0.0, "boxes_owned": False, "boxes_dynamic": True, "motors_give": "evenly", "ending_limit": 700,
    "inventory_slots": 2, "safe_zone_damage": 3, "give_last_passes_on": False, "boxes_settles": False,
    "boxes_corners": "lower left",
}  # fmt: skip
PILLARS = systems.Pillars(count=30, least=0.4, most=0.9)
KINDS: dict[str, tuple[Any, ...]] = {  # a variant, numbers, and further mechanics
    "ffa as run": ("ffa_4", RUNS),
    "teams with ablations": (
        "teams_4", RUNS | {"agents_count": 6, "teams_count": 3, "rewards_basis": "members", "rewards_outlive": 7.0,
                           "mortality_limit": 110},
    ),
    "ffa as written": ("ffa_4", TEXT | {"rewards_posthumous": True}),
    "teams as run": ("teams_4", RUNS | {"agents_count": 6, "teams_count": 3, "ending_rule": "all dead"}),
    "teams as written": ("teams_4", TEXT | {"cameras_mode": "omniscient", "rewards_posthumous": False}),
    "teams among walls": ("teams_4", TEXT | {"agents_count": 6, "rewards_posthumous": False}, PILLARS),
    "ffa among walls": ("ffa_4", RUNS, PILLARS),
}  # fmt: skip
SIDED = RUNS | {"agents_count": 6, "teams_count": 3, "teams_sizes": (1, 2, 3), "boxes_dynamic": True}
KINDS["teams with roles"] = ("teams_4", SIDED)
DAILY = ("teams among walls", "teams with roles")
ROLES = {  # by kind of world
    "teams with roles": {
        "hunter": outlast.role(
            2, melee_damage=20, melee_reach=3.0, melee_cooldown=2, cameras_depth=14.0, cameras_fov=2.2,
            agents_radius=0.6, agents_density=1.5, motors_ahead=0.5, motors_turn=0.03, inventory_capacity=1,
            give_last_reach=4.0, boxes_offset=1.5, rewards_kill=30.0, rewards_alive=0.25, safe_zone_damage=0,
        ),
        "prey": outlast.role(
            cameras_depth=uniform(4.0, 8.0), pickup_reach=1.25, death_drop_radius=2.0, inventory_capacity=3,
            motors_left=choice(0.1, 0.3), mortality_limit=120, rewards_death=-7.0, rewards_outlive=3.0,
            safe_zone_damage=integers(2, 4), agents_health=60,
        ),
    },
}  # fmt: skip
TURNING_POINTS = (0, 98, 99, 100, 101, 199, 200, 399, 699, 1300, 1398, 1399, 1400, 1700)


@dataclass
class Played:
    """A tick: the world before it, the actions, the world after it, and what the naive forms say must come out."""

    before: World
    actions: list[dict[str, int]]
    after: World
    want: World
    observation: dict[str, Any]
    reward: list[float]
    end: tuple[bool, bool]


@functools.cache
def play(kind: str) -> tuple[Played, ...]:
    """Play ticks from random worlds of one of KINDS, and keep those in which rounding does not decide."""
    variant, numbers, *others = KINDS[kind]
    scenario = outlast.variant(variant).replace(**numbers).with_(*others)
    if roles := ROLES.get(kind):
        scenario = scenario.roles(**roles, drawn="anyone", observed=False)
    env = outlast.make_vec(scenario, COUNT, seed=5)
    rng = np.random.default_rng(6)
    env.reset()
    for w in range(COUNT):
        scramble(env, w, rng)
    played, ambiguous, running = [], 0, range(COUNT)
    for _ in range(TICKS):
        before = {w: read(env, w) for w in running}
        actions = draw_actions(env, rng)
        env.step(actions)
        for w, world in before.items():
            moves = [dict(zip(KEYS, row, strict=True)) for row in (actions[w] - [1, 1, 1, 0, 0, 0]).tolist()]
            try:
                played.append(_played(env, w, world, moves))
            except Ambiguous:
                ambiguous += 1
        running = [w for w in running if not _ended(env, w)[0] and not _ended(env, w)[1]]
    env.close()
    assert ambiguous < max(2, 0.05 * len(played))
    return tuple(played)


def disagreements(kind: str, kinds: Sequence[str], *columns: str) -> list[str]:
    """Where the tick and its naive forms differ, over all ticks of a kind; the first few, in words."""
    found = (differences(tick.after, tick.want, tuple(kinds), *columns) for tick in play(kind))
    return [f"tick {k}: {words}" for k, all_words in enumerate(found) for words in all_words][:5]


def moved_as_in(after: World) -> naive_mechanics.Move:
    """Box2D's part of a tick, taken from the world that came out of it."""

    def move(world: World, actions: naive_mechanics.Actions) -> None:
        for entity, moved in zip(world.entities, after.entities, strict=True):
            if entity.kind == "agent" or (entity.kind == "box" and entity.here and world.numbers["boxes_dynamic"]):
                entity.x, entity.y, entity.angle = moved.x, moved.y, moved.angle
                entity.vx, entity.vy, entity.omega = moved.vx, moved.vy, moved.omega

    return move


def _played(env: SurvivalVectorEnv, w: int, before: World, actions: list[dict[str, int]]) -> Played:
    after = read(env, w)
    want = naive_mechanics.tick(before, actions, moved_as_in(after), scattered, naive_observations.see)
    observation = {key: buffer[w].copy() for key, buffer in env._observe().items()}
    return Played(before, actions, after, want, observation, env.worlds[Reward].reward[w].tolist(), _ended(env, w))


def _ended(env: SurvivalVectorEnv, w: int) -> tuple[bool, bool]:
    end = env.worlds[End]
    return bool(end.terminated[w, 0]), bool(end.truncated[w, 0])


def scramble(env: SurvivalVectorEnv, w: int, rng: np.random.Generator) -> None:
    """Set any tick; crowd bodies somewhere, some at the very same place; give them any health; put items anywhere."""
    tables, agents = env.worlds, range(env.num_agents)
    alive = tables[Entity].alive[w]
    tables[Clock].tick[w] = time = rng.choice(TURNING_POINTS) if rng.random() < 0.5 else rng.integers(1700)
    alive[list(agents)] = rng.random(len(agents)) < rng.choice([0, 0.2, 0.8, 1], p=[0.02, 0.08, 0.5, 0.4])
    _scatter_bodies(env, w, rng)
    health = tables[Health]
    health.points[w, list(agents)] = points = rng.choice([-3, 0, 1, 5, 20, 100, 175], len(agents))
    health.points[w, list(agents)] = points = np.where(alive[list(agents)] & (rng.random(len(agents)) < 0.5), 5, points)
    health.damage_type[w, list(agents)] = 0
    health.source[w, list(agents)] = rng.integers(-1, 2, len(agents))
    health.fatal_tick[w, list(agents)] = np.where(points <= 0, time, -1)
    tables[Weapon].cooldown[w, list(agents)] = rng.integers(0, 3, len(agents))
    tables[Episode].returns[w] = rng.normal(0, 100, len(agents))
    tables[Kills].first_death[w] = rng.choice([0, min(time, 7)])
    _scatter_items(env, w, rng)
    zone = tables[Zone]
    for column, value in zip(zone[:6], naive_mechanics.zone_at(read(env, w), int(time)), strict=True):
        column[w] = value


def _scatter_bodies(env: SurvivalVectorEnv, w: int, rng: np.random.Generator) -> None:
    body, count = env.worlds[Body], env.worlds.span("wall").start
    middle = rng.choice([0.0, 11.0, -11.0, 6.0], 2)
    place = np.clip(middle + rng.normal(0, rng.choice([0.5, 1.5, 6]), (count, 2)), -11.8, 11.8)
    if rng.random() < 0.3:  # some at the very same place
        place[rng.integers(count, size=count // 3)] = place[rng.integers(count)]
    walls = blocks(env.worlds, w) if Wall in env.worlds else []
    for k in range(count):  # so that nothing is in a wall, or gets into one
        while any(signed_distance(wall, *place[k]) < 0.6 for wall in walls):
            place[k] = rng.uniform(-11.5, 11.5, 2)
    body.x[w, :count], body.y[w, :count] = place.T
    moving = slice(0, env.num_agents)
    body.angle[w, moving] = rng.uniform(-7, 7, env.num_agents) * (rng.random() < 0.9)
    body.cosine[w, moving], body.sine[w, moving] = np.cos(body.angle[w, moving]), np.sin(body.angle[w, moving])
    for column in (body.vx, body.vy, body.omega):
        column[w, moving] = rng.normal(0, 1, env.num_agents)


def _scatter_items(env: SurvivalVectorEnv, w: int, rng: np.random.Generator) -> None:
    """Put each item on the ground or into a bag, or remove it; let each box stand, be just broken, or be an item."""
    tables = env.worlds
    alive, bag, slots = tables[Entity].alive[w], tables[Bag], env.scenario.numbers()["inventory_slots"]
    living = [i for i in range(env.num_agents) if alive[i]]
    boxes, items = tables.span("box"), tables.span("box_item")
    tables[Shape].half_height[w, boxes.start] = 0.05  # a sliver in every world
    width, solid = float(tables[Shape].half_width[w, boxes.start]), tables[Solid]
    solid.mass[w, boxes.start] = mass = 4 * width * 0.05
    solid.inertia[w, boxes.start] = mass * (width**2 + 0.05**2) / 3
    loose = list(range(tables.span("heal").start, tables.span("heal").stop))
    for box, item in zip(range(boxes.start, boxes.stop), range(items.start, items.stop), strict=True):
        tables[Guard].vulnerable_only_to[w, box] = rng.integers(-1, 2) if env.scenario.numbers()["boxes_owned"] else -1
        state = rng.integers(4)
        alive[box], tables[Box].broken[w, box] = state == 0, state == 1
        if state > 1:
            loose.append(item)
    for item in rng.permutation(loose).tolist():
        holder = int(rng.choice(living)) if living and rng.random() < 0.6 else -1
        alive[item] = holder < 0 and rng.random() < 0.8
        if holder >= 0 and bag.count[w, holder] < slots and bag.items[w, holder, bag.count[w, holder]] != CLOSED:
            bag.items[w, holder, bag.count[w, holder]] = item
            bag.count[w, holder] += 1
            tables[Item].holder[w, item] = holder
