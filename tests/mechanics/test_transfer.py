"""The transfer tests of hide and seek: their rules, and their rewards against naive forms over random play."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Shape
from outlast.components.hide_and_seek import Movable
from outlast.components.transfer import Passed
from outlast.ecs import NumberError
from outlast.envs.scenarios.hide_and_seek import HIDE_SMALL
from outlast.envs.scenarios.transfer import BLUEPRINT, LOCK_AND_RETURN, OBJECT_COUNTING, SCENARIOS, SEQUENTIAL_LOCK
from outlast.systems.hide_and_seek import Blueprint, Locking
from tests.conftest import COMPILED
from tests.helpers.naive_geometry import ray_box, ray_circle

IDLE, LOCK, UNLOCK = (3, 3, 3, 0, 1), (3, 3, 3, 0, 2), (3, 3, 3, 0, 0)


def begun(scenario, worlds=1):
    env = outlast.make_vec(scenario, worlds, seed=0, action_masks=True)
    env.reset()
    return env


def step(env, action=IDLE):
    return env.step(np.tile(action, (env.num_worlds, 1, 1)))


def places(env, kind, w=0):
    body, span = env.worlds[Body], env.worlds.span(kind)
    return [(float(x), float(y)) for x, y in zip(body.x[w, span], body.y[w, span], strict=True)]


def locked(env, w=0):
    return [int(owner) >= 0 for owner in env.worlds[Movable].locked_by[w, env.worlds.span("crate")]]


class NaiveLocking:
    """The rewards of Locking, one tick after the other, as the published wrapper describes them."""

    def __init__(self, env, w, back=0.0):
        self.start, self.back = places(env, "agent", w)[0], back
        self.before = self.look(env, w)

    def look(self, env, w):
        here, there, owned = places(env, "agent", w)[0], places(env, "crate", w), locked(env, w)
        crate = owned.index(False) if False in owned else None
        goal = there[crate] if crate is not None else self.start
        far = math.dist(here, goal) if crate is not None or self.back else 0.0
        return crate, sum(owned), far

    def pay(self, env, w):
        (crate, count, far), (now, locks, left) = self.before, self.look(env, w)
        self.before = now, locks, left
        found = 5.0 * (locks - count)
        if now == crate:
            found += 0.5 * (far - left)
        else:
            found += 0.5 * far if locks > count else -0.5 * left
        return found + (now is None and left <= self.back)


def naive_sites(env, w):
    sites = [(-1.0, 0.0), (1.0, 0.0)]
    ways = [min(math.dist(site, crate) for crate in places(env, "crate", w)) for site in sites]
    return (max(ways) <= 0.2) - 0.05 * sum(ways) / 2


def naive_rays(env, w):
    """Return the reward of Shelter."""
    body, shape, hits = env.worlds[Body], env.worlds[Shape], 0
    rows = [e for kind in ("crate", "plank") for e in range(*env.worlds.span(kind).indices(10**6))]
    columns = (body.angle, shape.half_width, shape.half_height)
    boxes = [((float(body.x[w, e]), float(body.y[w, e])), *(float(c[w, e]) for c in columns)) for e in rows]
    (agent,) = places(env, "agent", w)
    for side in range(4):
        for k in range(10):
            x, y = 2.8 * (k / 5 - 1), -2.8
            for _ in range(side):
                x, y = -y, x
            away = (-x, -y)
            found = [ray_box((x, y), away, *each) for each in boxes]
            found.append(ray_circle((x, y), away, agent, 0.2))
            hits += min(found) > ray_circle((x, y), away, (0.0, 0.0), 0.5)
    return -0.1 * hits / 40


@pytest.mark.parametrize("scenario", [*SCENARIOS.values()][:-1], ids=str)  # the last has none
def test_rewards_are_those_of_naive_forms(scenario):
    env, generator = begun(scenario, 6), np.random.default_rng(3)
    forms: dict[str, Any] = {"blueprint": naive_sites, "shelter": naive_rays}
    locks = [NaiveLocking(env, w, scenario.numbers().get("locking_back", 0.0)) for w in range(6)]
    total = np.zeros(6)
    for t in range(60):
        for w in range(6) if t % 5 == 0 else ():  # the agent turns up next to a crate, or where it has begun
            x, y = generator.choice([*places(env, "crate", w), (locks[w].start[0] + 0.5, locks[w].start[1])])
            env.place("agent", 0, x=x - 0.5, y=y, angle=0, where=[w])
            if form := forms.get(scenario.name):
                env.place("crate", 0, x=generator.uniform(-2, 2), y=generator.uniform(-1, 1), where=[w])
                env.place("crate", 1, x=-1.1 + 2.2 * (w % 2), y=0.0625, where=[w])  # no corner on a ray
        actions = np.stack([generator.integers(0, size, (6, 1)) for size in env.action_sizes], -1)
        _, rewards, *_ = env.step(actions)
        form = forms.get(scenario.name)
        expected = [form(env, w) if form else locks[w].pay(env, w) for w in range(6)]
        assert rewards[:, 0].tolist() == pytest.approx(expected, abs=1e-3)
        total += rewards[:, 0]
    assert len(np.unique(total)) == 6
    env.close()


def test_crates_are_locked_in_their_order_and_a_done_task_is_paid():
    env = begun(SEQUENTIAL_LOCK.without("rooms"))
    spots = [(-2.0, -2.0), (-2.0, 2.0), (2.0, -2.0), (2.0, 2.0)]
    for k, (x, y) in enumerate(spots):
        env.place("crate", k, x=x, y=y)
    for k in (2, 0, 1, 2, 3):  # the third one is not next at first
        env.place("agent", 0, x=spots[k][0] - 0.6, y=spots[k][1], angle=0)
        step(env)
        _, rewards, *_ = step(env, LOCK)
        assert locked(env)[k] == (k != 2 or locked(env)[1])
        assert rewards[0, 0] == pytest.approx(5 * locked(env)[k] + (k == 3), abs=0.4)  # and half a metre nearer
    assert step(env)[1][0, 0] == 1
    assert step(env, UNLOCK)[1][0, 0] < -5
    while not (done := step(env))[3].all():
        pass
    assert done[4]["statistics"]["solved"].tolist() == [2]


def test_the_agent_begins_in_its_corner_and_is_paid_when_it_is_back():
    env = begun(LOCK_AND_RETURN, 64)
    agents = np.array([places(env, "agent", w)[0] for w in range(64)])
    np.testing.assert_allclose(agents, [[-2.0, -1.5]] * 64)
    assert len({places(env, "crate", w)[0] for w in range(64)}) > 8
    env = begun(LOCK_AND_RETURN.without("rooms"))
    env.place("crate", 0, x=1, y=0)
    env.place("agent", 0, x=0.4, y=0, angle=0)
    step(env)
    assert 4.5 < step(env, LOCK)[1][0, 0] < 5.5
    assert abs(step(env)[1][0, 0]) < 0.1
    env.place("agent", 0, x=-2, y=-1.45)
    away = math.dist((0.4, 0), (-2, -1.5)) - 0.05
    assert step(env)[1][0, 0] == pytest.approx(1 + 0.5 * away, abs=0.1)


def test_crates_leave_the_sight_of_an_agent_that_stands_still():
    env, drive = begun(OBJECT_COUNTING, 64), np.random.default_rng(0)
    assert step(env)[0]["crates_mask"].mean() > 0.95  # few hide others
    for _ in range(150):
        seen, paid, *_ = env.step(drive.integers(0, env.action_sizes, (64, 1, len(env.action_sizes))))
    assert not seen["crates_mask"].any()
    assert not paid.any()
    left = [sum(y > 2 for _, y in places(env, "crate", w)) for w in range(64)]
    assert env.worlds[Passed].went_left[:, 0].tolist() == left
    assert {*left} >= {1, 2, 3, 4, 5}
    assert {places(env, "agent", w)[0] for w in range(64)} == {places(env, "agent")[0]}


def test_impossible_tasks_are_refused():
    for scenario, message in (
        (HIDE_SMALL.without("hiding").with_(Blueprint()), "blueprint is a task for one agent, and there are 2"),
        (BLUEPRINT.replace(blueprint_sites=(1.0, 2.0, 3.0)), "blueprint.sites = .*: pairs of x and y are needed"),
        (LOCK_AND_RETURN.replace(locking_start=(1.0,)), "locking.start = .*: two numbers are needed"),
    ):
        with pytest.raises(NumberError, match=message):
            outlast.make_vec(scenario, 1)
    assert "blueprint" not in BLUEPRINT.with_(Locking())  # there is one task at a time


@pytest.mark.parametrize("scenario", SCENARIOS.values(), ids=str)
def test_networks_of_hiders_fit(scenario):
    game, task = outlast.make_vec(HIDE_SMALL, 1), outlast.make_vec(scenario, 1)
    assert {key: list(own) for key, own in task.fields.items()} == {key: list(own) for key, own in game.fields.items()}
    assert task.action_sizes.tolist() == game.action_sizes.tolist()
    assert not COMPILED or outlast.check(scenario) == []  # uncompiled, it takes minutes
