"""Tests of tag.py. Run it: python -m pytest docs/examples/test_tag.py."""

import numpy as np
import pytest
from tag import TAG, Breath, Player, Shields, Stamina, Tag
from tag_policy import chase
from tag_view import TAG_LAYERS

import outlast
from outlast.components import Bag, Body, Health, Item
from outlast.ecs import NumberError

IDLE, RUN, STRIKE, USE = (3, 3, 3, 0, 0), (6, 3, 3, 0, 0), (3, 3, 3, 1, 0), (3, 3, 3, 0, 1)


def placed(*places, it=0, scenario=TAG, **numbers):
    """One world: agents stand at these places, facing +x, and one of them is it."""
    env = outlast.make_vec(scenario.replace(n_agents=len(places), **numbers), 1, seed=0)
    env.reset()
    count = len(places)
    env.worlds[Body].x[0, :count], env.worlds[Body].y[0, :count] = np.transpose(places)
    env.worlds[Player].it[0, :count] = np.arange(count) == it
    return env


def step(env, *actions):
    """A tick in which the first agents do this, and all others nothing."""
    idle = [IDLE] * (env.num_agents - len(actions))
    return env.step(np.array([[*actions, *idle]]))


def its(env):
    return env.worlds[Player].it[0, : env.num_agents].tolist()


def seen(env, observations, name):
    """A field of every agent's own row."""
    return observations["own"][0, :, env.fields["own"][name].start].tolist()


def test_a_touch_passes_it_on_and_is_an_event():
    env = placed((2, 2), (3.4, 2), (-4, -4))
    observations, reward, *_ = step(env, STRIKE)
    assert its(env) == seen(env, observations, "it") == [0, 1, 0]
    assert reward[0].tolist() == pytest.approx([0.1, -1, 0.1])
    (tagged,) = env.events()["tagged"]
    assert (tagged["by"], tagged["agent"], tagged["tick"]) == (0, 1, 1)
    assert len(env.events()["hit"]) == 0


def test_nobody_is_touched_out_of_reach_or_by_one_that_is_not_it():
    env = placed((2, 2), (3.6, 2))
    step(env, STRIKE)
    assert its(env) == [1, 0]
    env = placed((2, 2), (3.4, 2), it=1)
    step(env, STRIKE)
    assert its(env) == [0, 1]


def test_only_agents_are_tagged():
    env = placed((2, 2), (5, 2), scenario=TAG.with_(outlast.systems.Boxes(count=1)))
    box = env.worlds.span("box").start
    env.worlds[Body].x[0, box], env.worlds[Body].y[0, box] = 3, 2
    step(env, STRIKE)
    assert env.events()["strike"]["target"].tolist() == [box]
    assert its(env) == [1, 0]


def test_who_has_become_it_waits_before_it_strikes():
    env = placed((2, 2), (3.4, 2), tag_cooldown=3)
    env.worlds[Body].angle[0, 1], env.worlds[Body].cosine[0, 1] = np.pi, -1
    step(env, STRIKE, STRIKE)  # both strike in the same tick, but being it is passed on once only
    for _ in range(3):
        assert its(env) == [0, 1]
        step(env, IDLE, STRIKE)
    step(env, IDLE, STRIKE)
    assert its(env) == [1, 0]


@pytest.mark.parametrize(("y", "safe"), [(1.4, True), (1.6, False)])
def test_the_base_is_safe(y, safe):
    env = placed((-1.3, y), (0, y), tag_base=1.5)
    reward = step(env, STRIKE)[1]
    assert its(env) == ([1, 0] if safe else [0, 1])
    assert reward[0, 1] == (0 if safe else -1)


def test_a_shield_protects_for_a_while():
    env = placed((2, 2), (3.4, 2), shields_ticks=2, tag_cooldown=0)
    shield = env.worlds.span("shield").start
    env.worlds[Bag].items[0, 1, 0], env.worlds[Bag].count[0, 1] = shield, 1
    env.worlds[Item].holder[0, shield] = 1
    assert seen(env, step(env)[0], "has_shield") == [0, 1]
    observations, *_ = step(env, STRIKE, USE)
    assert its(env) == [1, 0]
    assert seen(env, observations, "safe") == [0, 1]
    assert seen(env, observations, "has_shield") == [0, 0]
    assert env.events()["item_used"]["agent"].tolist() == [1]
    step(env, STRIKE)
    assert its(env) == [1, 0]
    step(env, STRIKE)
    assert its(env) == [0, 1]


def test_who_runs_gets_tired():
    env = placed((-5, 2), (-5, -2), stamina_most=3, stamina_rest=2)
    left, moved = [], []
    for _ in range(7):
        x = env.worlds[Body].x[0, 0]
        left.append(seen(env, step(env, RUN)[0], "stamina")[0])
        moved.append(bool(env.worlds[Body].x[0, 0] > x))
    assert left == [2, 1, 0, 2, 1, 0, 2]
    assert moved == [True, True, True, False, True, True, False]


def test_the_dead_have_no_stamina():
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Stamina()), 1, seed=0)
    env.reset()
    env.worlds[Health].points[0, 1] = 0
    observations, *_ = env.step(np.broadcast_to(env.noop, (1, 2, 6)))
    assert seen(env, observations, "stamina") == [90, 0]


def test_everybody_sees_everything():
    env = placed((2, 2), (4, 4), (-4, -4), it=2)
    env.worlds[Breath].left[0, :3] = 10, 20, 30
    observations, *_ = step(env)
    rows = observations["others"][0, 0]  # agent 0's rows of agents 1 and 2
    assert rows[:, env.fields["others"]["it"].start].tolist() == [0, 1]
    assert rows[:, env.fields["others"]["stamina"].start].tolist() == [22, 32]
    shields = env.worlds.span("shield")
    places = np.stack([env.worlds[Body].x[0, shields], env.worlds[Body].y[0, shields]], -1)
    assert (observations["shields"][0] == places).all()


def test_whole_games_follow_the_rules_in_plain_python():
    worlds, agents, ticks = 4, 5, 150
    numbers = {"n_agents": agents, "room_size": 7.0, "stamina_most": 20, "shields_ticks": 9, "n_shields": 8}
    env = outlast.make_vec(TAG.replace(**numbers), worlds, seed=1)
    observations, _ = env.reset()
    tag, policy, generator = env.scenario[Tag], chase(env), np.random.default_rng(0)
    it = env.worlds[Player].it[:, :agents].copy()
    assert it.sum(1).tolist() == [1] * worlds
    breath, safe = np.full((worlds, agents), 20), np.zeros((worlds, agents), int)
    tags = shields = 0
    for _ in range(ticks):
        before = env.worlds[Body].x[:, :agents].copy(), env.worlds[Body].y[:, :agents].copy()
        actions = np.where(
            generator.random((worlds, agents, 1)) < 0.8,
            policy(observations),
            generator.integers(0, env.action_sizes, (worlds, agents, 5)),
        )
        observations, reward, *_ = env.step(actions)
        events, place = env.events(), (env.worlds[Body].x, env.worlds[Body].y)
        for w, e in np.ndindex(worlds, agents):
            runs = breath[w, e] > 0 and (actions[w, e, :2] != 3).any()
            breath[w, e] = breath[w, e] - 1 if runs else min(breath[w, e] + 2, 20)
        for used in events["item_used"]:
            safe[used["world"], used["agent"]] = 9
        touches = {}
        for struck in events["strike"]:
            w, me, e = struck["world"], struck["agent"], struck["target"]
            if it[w, me] and e >= 0 and safe[w, e] == 0 and np.hypot(before[0][w, e], before[1][w, e]) > tag.base:
                touches[w] = me, e
        for w, (me, e) in touches.items():
            it[w, me], it[w, e] = 0, 1
        safe = np.maximum(safe - 1, 0)
        assert [(t["world"], t["by"], t["agent"]) for t in events["tagged"]] == [(w, *touches[w]) for w in touches]
        free = np.where(np.hypot(place[0][:, :agents], place[1][:, :agents]) <= tag.base, 0, tag.free_reward)
        assert reward == pytest.approx(np.where(it, tag.it_reward, free))
        for name, expected in (("it", it), ("safe", safe), ("stamina", breath)):
            assert (observations["own"][..., env.fields["own"][name].start] == expected).all(), name
        tags, shields = tags + len(touches), shields + len(events["item_used"])
    assert tags > 5
    assert shields > 5


def test_an_episode_ends_at_its_limit_with_statistics():
    env = placed((2, 2), (3.4, 2), ending_limit=4)
    step(env, STRIKE)
    for _ in range(3):
        _, _, terminated, truncated, info = step(env)
    assert (terminated[0], truncated[0]) == (False, True)
    assert info["statistics"]["tags"].tolist() == [1]
    assert info["statistics"]["ticks_it"].tolist() == [[0, 4]]


def test_mechanics_can_be_left_out():
    names = list(outlast.make_vec(TAG.without(Shields, Stamina), 1, seed=0).fields["own"])
    assert "it" in names
    assert "has_shield" not in names
    assert "stamina" not in names
    with pytest.raises(NumberError, match=r"stamina\.most = 0"):
        TAG.replace(stamina_most=0)


def test_the_base_and_the_players_are_drawn():
    env = placed((3, 3), (-3, -3))
    picture = outlast.draw(env.worlds, 0, 240, layers=TAG_LAYERS)
    assert picture[120, 120].tolist() == [150, 200, 150]
    assert (picture == [220, 50, 40]).all(-1).any()


def test_what_no_step_looks_for():
    assert outlast.check(TAG, worlds=4, steps=60) == []
