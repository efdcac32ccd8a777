"""Behaviour: its statistics are those of a naive form in plain Python, by positions, observations and events."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import Scenario, make_vec, variant
from outlast.components import Body, Health, Shape, Zone
from outlast.distributions import integers, uniform
from outlast.ecs import Entity
from outlast.envs.core.spaces import alive, side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems import Behaviour, Preparation, Respawn, Rooms
from tests.conftest import draw_actions, few_by_day, scaled
from tests.helpers.execution_modes import assert_played_alike
from tests.helpers.naive_geometry import NO_HIT, ray_box

WORLDS, LIMIT = scaled(60, least=12), scaled(140, least=40)
CELLS, NEED = 5, 0.75
KEYS = (
    "ticks_alive", "distance_travelled", "cells_visited", "enemy_distance", "mate_distance", "enemy_in_view",
    "outside_zone", "strikes", "strikes_landed", "damage_dealt", "heals_in_need",
    "heals_given", "boxes_between",
)  # fmt: skip
DENSE: dict[str, Any] = {  # much happens, and nobody dies of the zone at once
    "room_size": 11.0, "safe_zone_radii": (5.0, 3.0), "safe_zone_stand": 20, "safe_zone_shrink": 20, "n_agents": 4,
    "n_heals": 15, "n_boxes": 8, "boxes_toughness": 1, "boxes_width": 0.6, "boxes_height": 0.6,
    "boxes_width_deviation": 0.3, "boxes_height_deviation": 0.3, "spawn_grid_cells": 8, "agents_health": 40,
    "heals_amount": 10, "ending_limit": LIMIT, "pickup_reach": 1.5, "melee_reach": 3.0, "give_last_reach": 6.0,
    "give_last_nearest": "suitable",
}  # fmt: skip
ROLES = {"hunter": outlast.role(1, agents_health=80, cameras_fov=2.5), "prey": outlast.role(motors_ahead=0.5)}
FFA, TEAMS = (variant(name).replace(**DENSE) for name in ("ffa_4", "teams_4"))
SCENARIOS: dict[str, Scenario] = {
    "ffa": FFA,
    "teams": TEAMS,
    "counts, roles and walls": TEAMS.replace(room_size=13.0, room_height=12.0, pickup_reach=1.0, room_walls=False)
    .with_(Rooms(columns=2, rows=2, thickness=0.2))
    .roles(**ROLES)
    .vary(n_agents=integers(2, 4), melee_damage=integers(1, 9), cameras_depth=uniform(3, 9)),
    "respawn": TEAMS.replace(ending_rule="never", melee_damage=9).with_(Respawn(ticks=7)),
    "all is seen": FFA.replace(cameras_mode="omniscient"),
    "blind at first": TEAMS.with_(Preparation(ticks=20, blind=True)),
    "no cameras, no zone": FFA.without("safe_zone", "cameras"),
    "no items": FFA.without("heals", "boxes", "inventory", "pickup", "give_last", "death_drop"),
    "no boxes": TEAMS.without("boxes"),
    "no melee": FFA.without("melee"),
}
MATES, BOXES = {"mate_distance"}, {"boxes_between"}
STRIKES = {"strikes", "strikes_landed", "damage_dealt"}
ZERO = {  # what does not occur there
    "ffa": MATES,
    "all is seen": MATES,
    "no cameras, no zone": MATES | {"outside_zone"},
    "no items": MATES | BOXES | {"heals_in_need", "heals_given"},
    "no boxes": BOXES,
    "no melee": MATES | STRIKES,
}


def make(scenario: Scenario, worlds: int = WORLDS, **options: Any) -> SurvivalVectorEnv:
    return make_vec(scenario.with_(Behaviour(cells=CELLS, need=NEED)), worlds, seed=4, **options)


@dataclass
class NaiveAgent:
    """An agent's trace, with what counts of it."""

    number: int
    row: int
    place: tuple[float, float] | None = None  # at the end of the last tick; None: dead
    points: int = 0  # likewise
    start: int = 0
    visited: set[tuple[int, int]] = field(default_factory=set)
    ways: list[float] = field(default_factory=list)
    enemies: list[float] = field(default_factory=list)
    mates: list[float] = field(default_factory=list)
    seen: list[bool] = field(default_factory=list)
    outside: list[bool] = field(default_factory=list)
    landed: list[bool] = field(default_factory=list)
    ticks: int = 0
    damage: int = 0
    in_need: int = 0
    given: int = 0
    between: int = 0

    def statistics(self) -> dict[str, float]:
        def mean(values: list[Any]) -> float:
            return math.fsum(values) / len(values) if values else 0.0

        shares = [*map(mean, (self.enemies, self.mates, self.seen, self.outside))]
        cells = len(self.visited) / CELLS**2 if self.ticks else 0.0
        counts = [self.damage, self.in_need, self.given, self.between]
        found = [self.ticks, math.fsum(self.ways), cells, *shares, len(self.landed), mean(self.landed), *counts]
        return dict(zip(KEYS, found, strict=True))


class NaiveBehaviour:
    """The descriptors of one world, from what anybody can read after each step."""

    def __init__(self, env: SurvivalVectorEnv, w: int) -> None:
        self.env, self.w = env, w
        span = env.worlds.span("agent")
        self.agents = {row: NaiveAgent(number, row) for number, row in enumerate(range(span.start, span.stop))}
        for agent in self.living():
            agent.start = agent.points = int(env.worlds[Health].points[w, agent.row])
            agent.place = self.place(agent.row)
            self.visit(agent)

    def place(self, row: int) -> tuple[float, float]:
        body = self.env.worlds[Body]
        return float(body.x[self.w, row]), float(body.y[self.w, row])

    def living(self) -> list[NaiveAgent]:
        there = alive(self.env.worlds, self.w)
        return [agent for agent in self.agents.values() if there[agent.number]]

    def visit(self, agent: NaiveAgent) -> None:
        numbers = self.env.numbers()
        sides = [numbers["room_width"] or numbers["room_size"], numbers["room_height"] or numbers["room_size"]]
        at = self.place(agent.row)
        x, y = (math.floor((x / side + 0.5) * CELLS) for x, side in zip(at, sides, strict=True))
        agent.visited |= {(x, y)} if 0 <= min(x, y) <= max(x, y) < CELLS else set()

    def others(self, row: int, mates: bool) -> list[tuple[float, int]]:
        """(metres, row) of living agents of one's own side, or of other sides."""
        sides = side(self.env.worlds, self.w)
        mine = sides[self.agents[row].number]
        found = [each for each in self.living() if each.row != row and (sides[each.number] == mine) == mates]
        return sorted((math.dist(self.place(row), self.place(each.row)), each.row) for each in found)

    def tick(self, observations: dict[str, Any], events: dict[str, Any]) -> None:
        mine = {name: rows[rows["world"] == self.w] for name, rows in events.items()}
        sides = side(self.env.worlds, self.w)
        for strike in mine.get("strike", ()):
            agent, target = self.agents[strike["agent"]], self.agents.get(strike["target"])
            agent.landed.append(target is not None and sides[target.number] != sides[agent.number])
        for hit in mine.get("hit", ()):
            agent, target = self.agents.get(hit["agent"]), self.agents.get(hit["target"])
            if agent is not None and target is not None and sides[target.number] != sides[agent.number]:
                agent.damage += hit["amount"]
        heals = self.env.worlds.span("heal") if "heal" in self.env.worlds.layout.spans else range(0)
        for use in mine.get("item_used", ()):
            agent = self.agents[use["agent"]]
            agent.in_need += use["item"] in range(heals.start, heals.stop) and agent.points < NEED * agent.start
        for gift in mine.get("item_given", ()):
            self.agents[gift["giver"]].given += gift["item"] in range(heals.start, heals.stop)
        for placed in mine.get("box_placed", ()):
            self.agents[placed["agent"]].between += self.covers(placed["agent"], placed["box"])
        for agent in self.agents.values():
            self.follow(agent, observations)

    def covers(self, row: int, box: int) -> bool:
        worlds, nearest = self.env.worlds, self.others(row, mates=False)
        if not nearest or not worlds[Entity].alive[self.w, box]:
            return False
        eye, mine = self.place(nearest[0][1]), self.place(row)
        shape = worlds[Shape]
        sizes = float(shape.half_width[self.w, box]), float(shape.half_height[self.w, box])
        ray = mine[0] - eye[0], mine[1] - eye[1]
        return ray_box(eye, ray, self.place(box), float(worlds[Body].angle[self.w, box]), *sizes) < NO_HIT

    def follow(self, agent: NaiveAgent, observations: dict[str, Any]) -> None:
        before, agent.place = agent.place, None
        if not alive(self.env.worlds, self.w)[agent.number]:
            return
        agent.place = self.place(agent.row)
        agent.ticks += 1
        agent.ways += [math.dist(before, agent.place)] if before else []
        self.visit(agent)
        for found, mates in ((agent.enemies, False), (agent.mates, True)):
            found += [metres for metres, _ in self.others(agent.row, mates)[:1]]
        sides, worlds = side(self.env.worlds, self.w), self.env.worlds
        peers = np.delete(sides, agent.number)
        agent.seen.append(bool((observations["others_mask"][self.w, agent.number, peers != sides[agent.number]]).any()))
        if Zone in worlds:
            x, y, radius = (float(getattr(worlds[Zone], name)[self.w, 0]) for name in ("x", "y", "radius"))
            agent.outside.append(math.dist(agent.place, (x, y)) > radius or radius == 0)
        agent.points = int(worlds[Health].points[self.w, agent.row])


def mix(env: SurvivalVectorEnv, rng: np.random.Generator) -> None:
    """Put all agents a metre from another one, a box or an item, and let them face it, whatever is in between."""
    body, agents, w = env.worlds[Body], env.worlds.span("agent"), np.arange(env.num_worlds)[:, None]
    shape = env.num_worlds, env.num_agents
    rows, angle = rng.integers(rng.choice([env.num_agents, body.x.shape[1]], shape)), rng.uniform(-3, 3, shape)
    x, y, cosine, sine = body.x[w, rows], body.y[w, rows], np.cos(angle), np.sin(angle)
    for column, values in zip(body[:5], (x - cosine, y - sine, angle, cosine, sine), strict=True):
        column[:, agents] = values


def compare(env: SurvivalVectorEnv, steps: int = LIMIT) -> dict[str, Any]:
    """Play an episode of every world at random, and compare. Returns the statistics, (worlds, agents) by key."""
    env.reset()
    naive, rng = [NaiveBehaviour(env, w) for w in range(env.num_worlds)], np.random.default_rng(5)
    found: dict[str, Any] = {key: np.zeros((env.num_worlds, env.num_agents)) for key in KEYS}
    ended = np.zeros(env.num_worlds, bool)
    if "box" in env.worlds.layout.spans:
        env.worlds[Health].points[:, env.worlds.span("box")] = 0  # to be picked up and set up again
    for tick in range(steps):
        if tick % 5 == 2:
            mix(env, rng)
        actions, columns = draw_actions(env, rng), [name for name, _ in env.action_columns]
        if "use" in columns:  # seldom, so that bags are not empty
            actions[..., columns.index("use")] *= rng.random(actions.shape[:2]) < 0.1
        observations, _, terminated, truncated, info = env.step(actions)
        events = env.events()
        for w in np.flatnonzero(~ended):
            naive[w].tick(observations, events)
        for w in np.flatnonzero((terminated | truncated) & ~ended):
            for agent in naive[w].agents.values():
                for key, expected in agent.statistics().items():
                    value = found[key][w, agent.number] = info["statistics"][key][w, agent.number]
                    assert value == pytest.approx(expected, rel=2e-5, abs=1e-6), (key, w, agent)
        ended |= terminated | truncated
    assert ended.all()
    env.close()
    return found


@pytest.mark.parametrize("name", few_by_day(SCENARIOS, ("counts, roles and walls",)))
def test_statistics_are_those_of_the_naive_form(name: str) -> None:
    found = compare(make(SCENARIOS[name]))
    zero = {key for key, values in found.items() if not values.any()}
    assert zero == ZERO.get(name, set())


@pytest.mark.parametrize("name", few_by_day(outlast.VARIANTS, ("ffa_3", "teams_4")))
def test_the_game_stays_as_it_is(name: str) -> None:
    assert_played_alike(variant(name), variant(name).with_(Behaviour()), scaled(300, least=3))
