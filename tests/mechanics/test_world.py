"""How episodes begin, how agents move in open space, and the actions that stand alone, against plain Python."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Drop, Item, Shape
from outlast.ecs import Component, Entity, Module
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.systems import DropLast, drop_last
from tests.conftest import COMPILED, draw_actions, scaled
from tests.helpers import naive_mechanics, naive_observations
from tests.helpers.naive_world import TOLERANCE, read
from tests.helpers.random_worlds import RUNS
from tests.helpers.scenario_builder import ScenarioBuilder

COUNT = scaled(2000, least=20)


@pytest.fixture(scope="module")
def fresh() -> Iterator[SurvivalVectorEnv]:
    """Worlds that have just been reset."""
    env = outlast.make_vec(outlast.variant("teams_4").replace(**RUNS), COUNT, seed=3)
    env.reset()
    yield env
    env.close()


def test_entities_start_on_the_centres_of_cells_of_their_own(fresh: SurvivalVectorEnv) -> None:
    side, cells = 25.0, 8
    centres = [side * ((i + 0.5) / cells) - side / 2 for i in range(cells)]
    assert centres[:4] == [-10.9375, -7.8125, -4.6875, -1.5625]
    for w in range(0, COUNT, 10):
        bodies = read(fresh, w).of("agent", "box", "heal")
        places = {(body.x, body.y) for body in bodies}
        assert len(places) == len(bodies)
        assert {coordinate for place in places for coordinate in place} <= set(centres)
        assert all(body.here for body in bodies)
        assert {(b.angle, b.vx, b.vy, b.omega) for b in bodies} == {(0, 0, 0, 0)}


@pytest.mark.parametrize("kind", ["agent", "box", "heal"])
def test_every_cell_is_as_likely_for_every_kind(fresh: SurvivalVectorEnv, kind: str) -> None:
    body, span = fresh.worlds[Body], fresh.worlds.span(kind)
    places = np.stack([body.x[:, span], body.y[:, span]], -1).reshape(-1, 2)
    counts = np.histogram2d(*places.T, bins=8, range=[[-12.5, 12.5]] * 2)[0]
    expected = len(places) / 64
    chi_square = ((counts - expected) ** 2 / expected).sum()
    assert chi_square < 63 + 5 * math.sqrt(2 * 63)


def test_sides_of_boxes_are_clipped_normal_draws(fresh: SurvivalVectorEnv) -> None:
    """Width from N(1, 1), height from N(1.5, 1.5), both at least 0.1."""
    shape, span = fresh.worlds[Shape], fresh.worlds.span("box")
    for halves, mean, deviation in ((shape.half_width, 1.0, 1.0), (shape.half_height, 1.5, 1.5)):
        sides = 2 * halves[:, span].ravel()
        assert sides.min() == pytest.approx(0.1)
        for quantile in (-0.5, 0.0, 1.0, 2.0):  # in deviations
            share = 0.5 * (1 + math.erf(quantile / math.sqrt(2)))
            error = math.sqrt(share * (1 - share) / sides.size)
            assert (sides < mean + quantile * deviation).mean() == pytest.approx(share, abs=4 * error)


def test_no_agent_is_hurt_or_carries_anything_at_the_start(fresh: SurvivalVectorEnv) -> None:
    for w in range(0, COUNT, 20):
        world = read(fresh, w)
        assert [agent.health for agent in world.of("agent")] == [100] * fresh.num_agents
        assert [agent.side for agent in world.of("agent")] == [0, 0, 1, 1, 1]
        assert all(box.health == 5 and box.owner == -1 and not box.broken for box in world.of("box"))
        assert not any(agent.bag for agent in world.of("agent"))
        assert not any(item.here for item in world.of("box_item"))
        assert world.statistics["returns"] == [0] * fresh.num_agents
        assert world.zone == pytest.approx(naive_mechanics.zone_at(world, 0), abs=TOLERANCE)
        assert world.zone[:3] == [0, 0, 12.5]  # the first zone fits into the room in one way only


@pytest.mark.parametrize("give", ["at once", "evenly"])
def test_motors_push_and_damping_slows_in_open_space(give: str) -> None:
    """Against the formulas of the rules, over 20 ticks of free flight from any state."""
    scenario = outlast.variant("ffa_1").replace(motors_give=give, n_heals=1)
    env = outlast.make_vec(scenario, scaled(100, least=3), seed=1)
    rng = np.random.default_rng(2)
    env.reset()
    body = env.worlds[Body]
    for column, spread in ((body.angle, 7), (body.vx, 2), (body.vy, 2), (body.omega, 5)):
        column[:, :2] = rng.uniform(-spread, spread, column[:, :2].shape)
    body.cosine[:, :2], body.sine[:, :2] = np.cos(body.angle[:, :2]), np.sin(body.angle[:, :2])
    body.x[:, :2], body.y[:, :2] = [-5, 5], 0
    for _ in range(20):
        before = [read(env, w) for w in range(env.num_worlds)]
        actions = draw_actions(env, rng)
        env.step(actions)
        for w, world in enumerate(before):
            for agent in world.of("agent"):
                push = dict(zip(("ahead", "left", "turn"), actions[w, agent.index, :3].tolist(), strict=True))
                push = {name: value - 1 for name, value in push.items()}
                assert [float(column[w, agent.row]) for column in (*body[:3], *body[5:])] == pytest.approx(
                    naive_observations.free_motion(agent, push, world.numbers), abs=TOLERANCE
                )
    env.close()


def call(kernel: Any, module: Module, env: SurvivalVectorEnv, w: int, extra: dict[type[Component], Any]) -> None:
    """Call one system of a module on one world by itself, with what its parameters ask for."""
    arguments = []
    for parameter in next(s for s in module.systems() if s.name == kernel.__name__).parameters:
        if parameter.kind == "rows":
            arguments.append(env.worlds.layout.rows(*parameter.components))
        elif parameter.kind == "number":
            arguments.append(np.float32(module.value(parameter.name)))
        else:
            (component,) = parameter.components
            own = extra.get(component)
            arguments.append(own or component.Table(*(column[w] for column in env.worlds[component])))
    kernel(*arguments)


def test_the_optional_drop_lays_the_last_item_ahead(fresh: SurvivalVectorEnv) -> None:
    """`DropLast` is in no variant: its kernel is called by itself."""
    tables, rng = fresh.worlds, np.random.default_rng(4)
    heals = tables.span("heal")
    for w in range(20):
        tables[Entity].alive[w, 0] = w % 5 > 0
        tables[Body].angle[w, :] = angle = rng.uniform(-4, 4)
        tables[Body].cosine[w, :], tables[Body].sine[w, :] = math.cos(angle), math.sin(angle)
        for agent in range(fresh.num_agents):
            held = min(agent, 2)
            items = range(heals.start + 2 * agent, heals.start + 2 * agent + held)
            tables[Bag].items[w, agent, :held], tables[Bag].count[w, agent] = items, held
            tables[Item].holder[w, list(items)], tables[Entity].alive[w, list(items)] = agent, 0
        before, drops = read(fresh, w), rng.integers(0, 2, fresh.num_agents).astype(np.int8)
        call(drop_last.drop_last, DropLast(offset=1.5), fresh, w, {Drop: Drop.Table(drops)})
        after = read(fresh, w)
        for agent in before.of("agent"):
            dropped = agent.here and drops[agent.index] and agent.bag
            assert after.of("agent")[agent.index].bag == (agent.bag[:-1] if dropped else agent.bag)
            if dropped:
                item, (x, y) = after.entities[agent.bag[-1]], naive_mechanics.ahead(agent, 1.5)
                assert (item.here, item.holder) == (True, -1)
                assert (item.x, item.y) == pytest.approx((agent.x + x, agent.y + y), abs=TOLERANCE)


@pytest.mark.skipif(not COMPILED, reason="a property of compiled kernels")
def test_other_numbers_compile_nothing_anew() -> None:
    paper = outlast.variant("teams_4")
    few, many = (
        outlast.make_vec(scenario, 1, seed=0) for scenario in (paper, paper.replace(**RUNS | {"heals_count": 3}))
    )
    assert few.worlds.source() == many.worlds.source()
    assert many.worlds.units.compiled == []


def test_a_limit_of_one_hit_point_is_a_limit() -> None:
    """0 is none, and nothing else."""
    game = ScenarioBuilder("ffa_1", agents_health=1, mortality_limit=1, safe_zone_damage=0)
    game.hand(0, "heal", 0)
    assert game.step({0: "use"}).health(0) == 1
    assert game.bag(0) == []
