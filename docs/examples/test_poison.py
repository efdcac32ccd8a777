"""Tests of poison.py. Run it: python -m pytest docs/examples/test_poison.py."""

import numpy as np
import pytest
from poison import Poison, Vial

import outlast
from outlast.components import Bag, Body, Health, Item, Shape, Spawned
from outlast.ecs import Archetype, Entity, Module, NumberError

IDLE, USE = (1, 1, 1, 0, 0, 0), (1, 1, 1, 0, 1, 0)
SCENARIO = outlast.variant("teams_2").with_(Poison(reach=3.0, strength=30, damage=2))


def armed(far, **numbers):
    """One world: agent 0 holds vial 0, its teammate 1 stands close by, enemy 2 stands `far` metres away."""
    env = outlast.make_vec(SCENARIO.replace(**numbers), 1, seed=0)
    env.reset()
    body, alive, vial = env.worlds[Body], env.worlds[Entity].alive, env.worlds.span("vial").start
    body.x[0, :4], body.y[0, :4] = (0, 0, far, -7), (0, 2, 0, -7)
    env.worlds[Bag].items[0, 0, 0], env.worlds[Bag].count[0, 0] = vial, 1
    env.worlds[Item].holder[0, vial], alive[0, vial] = 0, 0
    return env


def step(env, first=IDLE):
    """A tick in which agent 0 does `first`, and all others nothing."""
    return env.step(np.array([[first, IDLE, IDLE, IDLE]]))


def points(env):
    return env.worlds[Health].points[0, :4].tolist()


def test_enemies_lose_points_for_a_while():
    env = armed(far=2.9)
    step(env, USE)
    assert points(env) == [100, 100, 98, 100]
    for _ in range(29):
        step(env)
    assert points(env) == [100, 100, 40, 100]
    step(env)
    assert points(env) == [100, 100, 40, 100]  # agent 2 is well again


def test_it_reaches_no_farther():
    env = armed(far=3.1)
    step(env, USE)
    assert points(env) == [100, 100, 100, 100]


def test_a_death_by_poison_is_counted_and_is_the_poisoners():
    env = armed(far=2.0, poison_damage=50, rewards_kill=10.0, ending_limit=2)
    step(env, USE)
    _, reward, _, _, info = step(env)
    statistics = info["statistics"]
    assert (statistics["deaths_poison"][0], statistics["deaths_melee"][0]) == (1, 0)
    assert statistics["kills"][0].tolist() == [1, 0]
    assert statistics["vials_used"][0] == 1
    assert reward[0].tolist() == [11, 11, 1, 1]


def test_what_is_observed():
    env = armed(far=2.0)
    assert env.single_observation_space["vials"].shape == (4, 4, 2)
    assert step(env)[0]["vial_slot_mask"][0].tolist() == [[1], [0], [0], [0]]
    seen = step(env, USE)[0]
    assert seen["vial_slot_mask"][0].tolist() == [[0], [0], [0], [0]]
    assert seen["own"][0, :, env.fields["own"]["illness"].start].tolist() == [0, 0, 29, 0]


def test_a_vial_is_observed_while_it_is_visible():
    env = armed(far=8.0)
    vial = env.worlds.span("vial").start + 1
    env.worlds[Body].x[0, vial], env.worlds[Body].y[0, vial] = 1.5, 0  # ahead of agent 0, nothing in between
    seen = step(env)[0]
    assert seen["vials_mask"][0, 0, 1] == 1
    assert seen["vials"][0, 0, 1].tolist() == [1.5, 0]
    hidden = seen["vials_mask"][0] == 0
    assert not seen["vials"][0][hidden].any()


class Flasks(Module):
    """Another kind that has Vial, and a kind between the two that has none."""

    def archetypes(self):
        item = (Body(), Shape(radius=0.2), Spawned(), Item())
        flask = Archetype("flask", (*item, Vial(strength=5)), 2, order=300)
        return [Archetype("amulet", item, 3, order=350), flask]

    def dims(self):
        return {"vials": 2}


@pytest.mark.parametrize(("kind", "held"), [("vial", 1), ("amulet", 0), ("flask", 1)])
def test_the_last_slot_shows_all_kinds_of_vials_and_no_other(kind, held):
    env = outlast.make_vec(SCENARIO.with_(Flasks()), 1, seed=0)
    env.reset()
    worlds, item = env.worlds, env.worlds.span(kind).start
    assert worlds.span("flask").start < worlds.span("amulet").start < worlds.span("vial").start
    worlds[Bag].items[0, 0, 0], worlds[Bag].count[0, 0] = item, 1
    worlds[Item].holder[0, item], worlds[Entity].alive[0, item] = 0, 0
    assert step(env)[0]["vial_slot_mask"][0].tolist() == [[held], [0], [0], [0]]


def test_vials_can_be_picked_up():
    env = armed(far=8.0)
    vial = env.worlds.span("vial").start + 1
    env.worlds[Body].x[0, vial], env.worlds[Body].y[0, vial] = 0.2, 2
    step(env)
    assert env.worlds[Item].holder[0, vial] == 1


def test_numbers_out_of_range_are_refused():
    with pytest.raises(NumberError, match=r"poison\.reach = -1"):
        Poison(reach=-1.0)
