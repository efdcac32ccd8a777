"""Hide and seek: its rules one by one, and against their naive forms over hostile play."""

import math
from contextlib import nullcontext

import numpy as np
import pytest

import outlast
from outlast.components import Body, ObservationMasks, Solid, Weld
from outlast.components.hide_and_seek import Aloft, Doors, Movable, Tracked
from outlast.ecs import RESET, STEP, Clock, NumberError, Worlds
from outlast.envs.scenarios.hide_and_seek import HIDE_2V2, HIDE_DOOR, HIDE_OPEN, SCENARIOS
from outlast.systems import Preparation
from outlast.systems.hide_and_seek import Hiding, Things
from tests.conftest import COMPILED, digest
from tests.helpers.naive_hiding import naive
from tests.helpers.sines import sines_of_c

AHEAD, IDLE, GRAB, LOCK, UNLOCK, PULL = (
    (6, 3, 3, 0, 1), (3, 3, 3, 0, 1), (3, 3, 3, 1, 1), (3, 3, 3, 0, 2), (3, 3, 3, 0, 0), (0, 3, 3, 1, 1),
)  # fmt: skip
FREE = HIDE_2V2.without("quadrant", "lidar").replace(preparation_ticks=0, ending_limit=0, ending_rule="all dead")
FAR = ((-2, 2.5), (2, 2.5), (-2, -2.5), (2, -2.5))  # where agents are in nobody's way


def placed(*agents, crates=((2.6, 0), (2.6, 1)), ramp=(-2.5, 0), scenario=FREE, angle=0.0):
    """Return an environment with one world, whose first agents and things stand there, after a tick."""
    env = outlast.make_vec(scenario, 1, seed=0)
    env.reset()
    for i in range(env.num_agents):
        x, y, turned = (*(agents[i] if i < len(agents) else (*FAR[i], 0)), 0)[:3]
        env.place("agent", i, x=x, y=y, angle=turned)
    for k, (x, y) in enumerate(crates[: env.worlds.layout.dims["squares"]]):
        env.place("crate", k, x=x, y=y)
    if env.worlds.layout.dims["ramps"]:
        env.place("ramp", x=ramp[0], y=ramp[1], angle=angle)
    step(env)
    return env


def step(env, *actions):
    return env.step(np.array([[*actions, *[IDLE] * (env.num_agents - len(actions))]]))


def row(env, kind, number=0):
    return env.worlds.span(kind).start + number


def test_a_held_crate_follows_its_holders_until_they_let_go():
    env = placed((0, 0), (1.2, 0, math.pi), crates=[(0.6, 0), (2.6, 2.6)])
    welds, body, crate = env.worlds[Weld], env.worlds[Body], row(env, "crate")
    step(env, GRAB, GRAB)
    assert welds.other[0, :2].tolist() == [crate, crate]
    for _ in range(30):
        step(env, PULL, (6, 3, 3, 1, 1))  # both to the left
    assert body.x[0, crate] < 0
    assert body.x[0, crate] - body.x[0, 0] == pytest.approx(0.6, abs=0.01)
    step(env, IDLE, GRAB)
    assert welds.other[0, :2].tolist() == [-1, crate]


def test_only_the_side_that_has_locked_a_thing_unlocks_it():
    env = placed((0, 0), (-2, 2), (1.2, 0, math.pi), crates=[(0.6, 0), (2.6, 2.6)])
    movable, crate = env.worlds[Movable], row(env, "crate")
    step(env, GRAB)
    step(env, GRAB, IDLE, LOCK)  # a seeker locks what a hider holds
    assert movable.locked_by[0, crate] == 1
    assert env.worlds[Weld].other[0, 0] == -1
    assert env.worlds[Solid].dynamic[0, crate] == 0
    for action in (AHEAD, LOCK, UNLOCK, GRAB):
        for _ in range(10):
            step(env, action)
        assert movable.locked_by[0, crate] == 1
        assert env.worlds[Body].x[0, crate] == pytest.approx(0.6, abs=0.001)
    step(env, IDLE, IDLE, UNLOCK)
    assert movable.locked_by[0, crate] == -1
    assert env.worlds[Solid].dynamic[0, crate] == 1


def test_who_runs_up_a_ramp_passes_over_a_crate_and_comes_down():
    env = placed((-1.4, 0), crates=[(0.9, 0), (0.9, 0.6)], ramp=(-0.6, 0))
    heights, xs = [], []
    for _ in range(60):
        step(env, AHEAD)
        heights.append(int(env.worlds[Aloft].ticks[0, 0]))
        xs.append(float(env.worlds[Body].x[0, 0]))
    assert max(heights) == env.worlds.layout.numbers("climbing")["ticks"]
    assert heights[-1] == 0
    assert xs[-1] > 2.0  # behind the crates
    assert env.worlds[Body].x[0, row(env, "crate")] == pytest.approx(0.9)
    assert env.worlds[Tracked].climbs[0].tolist() == [1, 0]


def test_who_is_aloft_sees_and_is_seen_over_crates_and_handles_nothing():
    env = placed((0, 0), (0, 2.5), (1.2, 0, math.pi), crates=[(0.6, 0), (2.6, 2.6)])
    masks = env.worlds[ObservationMasks].mask
    sees = lambda: [bool(masks[0, i, 0] >> other & 1) for i, other in ((0, 2), (2, 0))]  # noqa: E731
    assert sees() == [False, False]
    env.worlds[Aloft].ticks[0, 0] = 5
    step(env, GRAB)
    assert sees() == [True, True]
    assert env.worlds[Weld].other[0, 0] == -1


def test_hiders_start_and_crates_lie_where_the_quadrant_says():
    env = outlast.make_vec(HIDE_2V2, 256, seed=1)
    env.reset()
    x, y = env.worlds[Body].x, env.worlds[Body].y
    inside = (x > 0) & (y < 0)
    assert inside[:, env.worlds.span("crate")].all()
    assert not inside[:, 2:4].any()
    assert 0.1 < inside[:, :2].mean() < 0.4  # a quarter of the floor, less what crates take
    doors = env.worlds[Doors].x[:, 1][env.worlds[Doors].open[:, 1] == 1]
    assert len(np.unique(doors)) == len(doors) > 150  # each is drawn
    assert outlast.check(HIDE_2V2.replace(things_crates=0)) == []
    assert 0.35 < (env.worlds[Doors].open.sum(1) == 1).mean() < 0.65
    env = outlast.make_vec(HIDE_DOOR, 64, seed=1)
    env.reset()
    assert (env.worlds[Doors].open.sum(1) == 1).all()
    assert (env.worlds[Body].x[:, :2] > 0).all()
    assert (env.worlds[Body].y[:, :2] < 0).all()


def test_a_crate_in_a_door_closes_it():
    env = outlast.make_vec(HIDE_DOOR, 4, seed=1)
    env.reset()
    doors = env.worlds[Doors]
    k = doors.open.argmax(1)
    x, y = (np.take_along_axis(table, k[:, None], 1)[:, 0] for table in (doors.x, doors.y))
    env.place("crate", 0, x=x, y=y)
    env.step(np.tile(IDLE, (4, 4, 1)))
    assert env.worlds[Tracked].doors_closed.tolist() == [[1, 1]] * 4
    env.worlds[Clock].tick[:] = 150  # the preparation is over
    env.place("crate", 0, x=x + 1, y=y - 1)
    env.step(np.tile(IDLE, (4, 4, 1)))
    assert env.worlds[Tracked].doors_closed.tolist() == [[1, 0]] * 4


def test_beyond_the_floor_there_is_a_penalty():
    env = placed((2.9, 0), scenario=HIDE_OPEN.replace(preparation_ticks=0), crates=())
    before = step(env)[1][0]
    for _ in range(20):
        reward = step(env, AHEAD)[1][0]
    assert abs(before[0]) == 1
    assert reward[0] in (-9, -11)
    assert env.worlds[Body].x[0, 0] > 3


@pytest.mark.parametrize("rule", ["joint", "mean", "selfish"])
@pytest.mark.parametrize("name", ["hide_2v2", "hide_full", "hide_small"])
def test_a_game_follows_its_rules(name, rule):
    """Everything that happens over hostile play is what the naive forms say, tick by tick."""
    scenario = SCENARIOS[name].replace(hiding_rule=rule, preparation_ticks=6)
    env, generator, compared = outlast.make_vec(scenario, 4, seed=3, action_masks=True), np.random.default_rng(5), 0
    env.reset()
    numbers = scenario.numbers()
    things = [
        (kind, k)
        for kind in ("crate", "plank", "ramp")
        for k in range(env.worlds.layout.dims["squares" if kind == "crate" else f"{kind}s"])
    ]
    for t in range(120):
        if t % 6 == 5:  # agents turn up next to things
            for i in range(env.num_agents):
                kind, k = things[generator.integers(len(things))]
                e, angle = row(env, kind, k), generator.uniform(0, 2 * math.pi)
                x, y = (
                    np.clip(getattr(env.worlds[Body], a)[:, e] + 0.7 * f(angle), -2.6, 2.6)
                    for a, f in (("x", math.cos), ("y", math.sin))
                )
                env.place("agent", i, x=x, y=y, angle=angle + math.pi)
        before = [naive(env, w) for w in range(4)]
        actions = np.stack([generator.integers(0, size, (4, env.num_agents)) for size in env.action_sizes], -1)
        _, rewards, *_, info = env.step(actions)
        tick, now = int(env.worlds[Clock].tick[0, 0]), [naive(env, w) for w in range(4)]
        for w in range(4):
            wanted = actions[w] + env.noop * 0 + [low for _, low in env.action_columns]
            before[w].steer(wanted[:, :2], numbers["steering_speed"], tick <= 6)
            before[w].climb(numbers["climbing_ticks"])
            before[w].handle(wanted[:, 3:], numbers["handling_reach"])
            idle = now[w].idle(numbers["handling_reach"])
            pays = now[w].pays(numbers["hiding_reward"], rule) if tick > 6 else [0.0] * env.num_agents
            assert rewards[w].tolist() == pytest.approx(pays)
            if before[w].close or now[w].close:
                continue
            compared += 1
            assert [a.aloft for a in now[w].agents] == [a.aloft for a in before[w].agents]
            assert [each.locked_by for each in now[w].things] == [each.locked_by for each in before[w].things]
            assert [a.holds for a in now[w].agents] == [a.holds for a in before[w].agents]
            first = np.cumsum([0, *env.action_sizes])
            mask = info["action_mask"][w]
            got = [
                (int(mask[i, first[3] : first[4]].sum() == 1), int(mask[i, first[4] : first[5]].sum() == 1))
                for i in range(env.num_agents)
            ]
            assert got == idle
    assert compared > 300
    env.close()


def test_impossible_numbers_are_refused():
    three = outlast.variant("ffa_1").replace(n_agents=3)
    for scenario, message in (
        (HIDE_2V2.replace(quadrant_door=0.3), "quadrant: a door would be 0.3 m wide"),
        (HIDE_2V2.replace(quadrant_share=0.2, quadrant_door=1.2), "quadrant.door = 1.2: a wall would be 1.2 m long"),
        (FREE.replace(things_size=7), "things.size = 7 does not fit"),
        (HIDE_2V2.replace(preparation_sides=(0,)), "seekers wait, which are side 1"),
        (three.without("rewards").with_(Hiding(), Things(), Preparation(ticks=3)), "hiding: two sides are needed"),
    ):
        with pytest.raises(NumberError, match=message):
            outlast.make_vec(scenario, 1)


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=str)
def test_episodes_end_and_say_what_was_done(scenario):
    env = outlast.make_vec(scenario.replace(ending_limit=20, preparation_ticks=8), 16, seed=0)
    env.reset()
    env.action_space.seed(0)
    for _ in range(20):
        *_, truncated, info = env.step(env.action_space.sample())
    assert truncated.all()
    found = info["statistics"]
    assert (found["outcome"].sum(1) == 12).all()
    assert (found["ticks_seen"] == found["outcome"][:, 1]).all()
    assert found["return"][:, 0].sum() == -found["return"][:, -1].sum() or scenario is HIDE_OPEN


@pytest.mark.skipif(not COMPILED, reason="compares with machine code")
def test_machine_code_and_python_give_the_same_bytes():
    scenario, found = SCENARIOS["hide_2v2"].without("lidar").replace(preparation_ticks=5), []
    for labels in ((), [system.label for system in Worlds(scenario.modules, 1).schedule.systems]):
        portable = scenario.replace(physics_backend="portable") if labels else scenario
        worlds, generator = Worlds(portable.modules, 2, interpret=labels), np.random.default_rng(5)
        worlds.seed(3, np.arange(2))
        with sines_of_c() if labels else nullcontext():
            for tick in range(16):
                worlds.actions[:] = generator.integers(0, 2, worlds.actions.shape)
                worlds.run(np.full(2, STEP if tick else RESET, np.int8))
                found.append(digest(worlds))
    assert found[:16] == found[16:]


def test_scripted_agents_play_the_game():
    found = {}
    for name in ("noop", "scripted"):
        env = outlast.make_vec(HIDE_DOOR, 64, seed=0)
        observations, _ = env.reset()
        policies = [
            outlast.policies.scripted_policy(env),
            outlast.policies.scripted_policy(env) if name == "scripted" else outlast.policies.noop_policy(env),
        ]
        for _ in range(240):
            hiders, seekers = (np.array(policy(observations)) for policy in policies)
            observations, *_, info = env.step(np.concatenate([hiders[:, :2], seekers[:, 2:]], 1))
        found[name] = info["statistics"]
    assert found["scripted"]["ticks_seen"].mean() > 2 * found["noop"]["ticks_seen"].mean()
    assert found["scripted"]["locks"][:, 0].mean() > 1.5
