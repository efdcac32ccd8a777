"""A person's game is the same simulation that learners get, at the pace and by the keys that it says."""

import itertools
import json

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock, MemoryLayout
from outlast.envs.adapters.gymnasium_single import SurvivalEnv
from outlast.envs.errors import MessageError
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.web.game import Game, GamePhase, parse
from outlast.envs.web.observation_text import observation_text
from tests.conftest import digest
from tests.helpers.remembering import Remembering

KEYS = [  # held, tapped, and the environment's action: ahead, left, turn, attack, use, give
    ({"ahead": 1}, {}, (2, 1, 1, 0, 0, 0)),
    ({"ahead": 1, "turn": 1, "attack": 1}, {}, (2, 1, 2, 1, 0, 0)),
    ({"ahead": -1, "left": -1}, {"use": 1}, (0, 0, 1, 0, 1, 0)),
    ({"left": 1}, {"give": 1, "turn": -1}, (1, 2, 0, 0, 0, 1)),
    ({}, {}, (1, 1, 1, 0, 0, 0)),
]
FIELDS = {name: MemoryLayout(outlast.variant(name).modules).fields for name in ("ffa_3", "teams_3")}


def play(game: Game, ticks: int) -> None:
    for _ in range(ticks):
        assert game.tick()


@pytest.fixture
def game():
    game = Game(outlast.variant("ffa_3"), seed=3)
    yield game
    game.close()


@pytest.mark.parametrize(("variant", "agent", "others"), [("ffa_3", 0, "scripted"), ("teams_3", 2, "noop")])
def test_keys_are_the_actions_of_the_batched_environment_bit_for_bit(variant, agent, others):
    game = Game(outlast.variant(variant), agent=agent, others=others, seed=7)
    env = outlast.make_vec(variant, 1, seed=7, autoreset_mode="Disabled")
    policy = POLICIES[others](env)
    observations, _ = env.reset()
    assert digest(game.worlds) == digest(env.worlds)
    for held, tapped, expected in itertools.islice(itertools.cycle(KEYS), 60):
        game.hold(held, tapped)
        play(game, 1)
        actions = policy(observations).copy()
        actions[0, agent] = expected
        observations, *_ = env.step(actions)
        assert digest(game.worlds) == digest(env.worlds)


def test_random_others_play_as_they_do_against_a_learner():
    game = Game(outlast.variant("ffa_3"), others="random", seed=5)
    env = SurvivalEnv("ffa_3", others="random", dead="keep")
    env.reset(seed=5)
    game.hold({"turn": 1}, {})
    for _ in range(50):
        play(game, 1)
        env.step([1, 1, 2, 0, 0, 0])
    assert digest(game.worlds) == digest(env.base_env.worlds)


def test_others_are_drawn_for_each_episode():
    """A mixture plays a game as the policy that was drawn; one with a memory is told of every restart."""
    policy = Remembering()
    game = Game(outlast.variant("teams_3"), others={"noop": 1, policy: 1}, seed=5)
    names = []
    for restart in range(1, 9):
        game.hold({"turn": 1}, {})
        play(game, 3)
        assert len(policy.told) == restart
        names.append("noop" if policy.calls is None or policy.calls[0] != 2 else "policy")
        game.restart()
    assert set(names) == {"noop", "policy"}


def test_a_tap_counts_for_one_tick_even_if_it_ends_before_it(game):
    game.hold({}, {"ahead": 1, "use": 1})
    game.hold({}, {})
    assert game.action() == [2, 1, 1, 0, 1, 0]
    play(game, 1)
    assert game.action() == [1, 1, 1, 0, 0, 0]


def test_a_pause_stops_everything_and_drops_taps(game):
    game.hold({"ahead": 1}, {})
    play(game, 5)
    game.hold({"ahead": 1}, {"give": 1})
    game.pause()
    before = digest(game.worlds)
    game.hold({"turn": 1}, {"use": 1})
    assert not game.tick()
    assert digest(game.worlds) == before
    game.resume()
    assert game.action() == [1, 1, 2, 0, 0, 0]  # what is down now, but nothing that was tapped meanwhile
    play(game, 1)
    assert digest(game.worlds) != before


def test_restart_is_the_next_episode_of_the_seed(game):
    env = outlast.make_vec("ffa_3", 1, seed=3)
    game.hold({"ahead": 1}, {})
    play(game, 10)
    game.restart()
    assert game.phase is GamePhase.READY
    env.reset()
    env.reset()
    assert game.worlds[Clock].tick[0, 0] == 0
    assert game.worlds[Clock].episode[0, 0] == env.worlds[Clock].episode[0, 0]
    np.testing.assert_array_equal(game.env.observe()["own"], env.observe()["own"])


def test_kills_are_counted_and_named():
    laser = outlast.variant("ffa_2").replace(melee_damage=200, melee_reach=40.0, melee_blocked=False)
    game = Game(laser, others="noop")
    while game.phase is not GamePhase.OVER:  # spin until the other one is struck
        game.hold({"turn": 1, "attack": 1}, {})
        game.tick()
    state = game.state()
    assert (state["result"]["verdict"], state["result"]["kills"], state["death"]) == ("won", 1, None)
    assert {"kind": "kill", "agent": 1, "by": 0, "cause": "melee"}.items() <= state["events"][-2].items()


def test_the_text_is_the_observation():
    """An agent at (1, 0) that faces +y, in a world that is made up."""
    f4, rest = np.float32, (0, 0, 0, 0)
    observation = {
        "own": np.array([0, 1, 63, 1, 0, np.pi / 2, 0, 0, 0], f4),
        "others": np.array([[1, 1, 80, 1, 5, *rest], [2, 0, 55, 4, 0, *rest], [3, 0, 1, 9, 9, *rest]], f4),
        "others_mask": np.array([1, 1, 0], f4),
        "zone": np.array([0, 0, 4, 1, 6, 2], f4),
        "heals": np.array([[0, 0], [1, 2], [0, 0]], f4),
        "heals_mask": np.array([0, 1, 1], f4),
        "heal_slot": np.array([[75]], f4),
        "heal_slot_mask": np.array([1], f4),
        "poison": np.array([2.5], f4),
    }
    assert observation_text(observation, FIELDS["teams_3"]) == {
        "Health": ["63"],
        "Next item": ["heal, +75"],
        "Zone": ["inside, 3.0 m to the edge", "next: 4.0 m away, ahead"],
        "Enemies": ["agent 2: 3.0 m 90° right, health 55"],
        "Friends": ["agent 1: 5.0 m ahead, health 80"],
        "Heals": ["2 in sight, nearest 1.0 m 90° left"],
        "Poison": ["2.5"],
    }


def test_the_text_outside_of_the_zone_and_after_death():
    row = np.array([0, 100, 0, -8, -np.pi / 2, 0, 0, 0], np.float32)
    observation = {"own": row, "others": np.zeros((0, 8), np.float32), "others_mask": np.zeros(0, np.float32)}
    fields = FIELDS["ffa_3"]
    text = observation_text(observation | {"zone": np.array([0, 0, 5, 0, 0, 0], np.float32)}, fields)
    assert text["Zone"] == ["outside by 3.0 m, behind", "it vanishes next, 8.0 m behind"]
    assert observation_text(observation | {"zone": np.zeros(6, np.float32)}, fields)["Zone"] == ["nowhere is safe"]
    assert observation_text(observation | {"own": np.zeros(8, np.float32)}, fields) == {"Health": ["dead"]}


RANGES = {"ahead": (-1, 1), "attack": (0, 1)}


MALFORMED: list[str | bytes] = r"""
x
[]
1
null
{}
{"command": ["pause"]}
{"command": {}}
{"speed": 3}
{"speed": true}
{"speed": NaN}
{"speed": [1]}
{"held": {}}
{"held": {}, "tapped": []}
{"held": {"ahead": 2}, "tapped": {}}
{"held": {"ahead": true}, "tapped": {}}
{"held": {"ahead": 1.0}, "tapped": {}}
{"held": {"ahead": 1e400}, "tapped": {}}
{"held": {"fly": 1}, "tapped": {}}
{"held": {}, "tapped": {"attack": -1}}
{"held": {}, "tapped": {}, "more": 1}""".splitlines()
MALFORMED += ["[" * 500, '{"a": ' * 80, '{"held": {"ahead": ' + "9" * 400 + '}, "tapped": {}}', b"{}"]


@pytest.mark.parametrize("text", ['{"held": {"ahead": -1}, "tapped": {"attack": 1}}', '{"speed": 0.5}'])
def test_messages_mean_what_they_say(text):
    assert parse(text, RANGES) == json.loads(text)


@pytest.mark.parametrize("text", MALFORMED, ids=range(len(MALFORMED)))
def test_other_messages_are_refused(text):
    with pytest.raises(MessageError) as refusal:
        parse(text, RANGES)
    assert 0 < len(str(refusal.value).encode()) <= 123  # it fits into the frame that closes a websocket


def test_an_episode_begins_without_a_key_of_the_game_and_slowly(game):
    game.hold({}, {})
    assert not game.tick()
    game.begin()
    assert game.state()["slow"]
    assert game.tick()
    assert game.action() == [1, 1, 1, 0, 0, 0]
    assert game.pace == 0.5
    while game.worlds[Clock].tick[0, 0] < 45:
        play(game, 1)
    assert (game.pace, game.state()["slow"]) == (1, False)
    game.restart()
    assert game.pace == 0.5
    game.begin()
    game.pause()
    game.begin()  # which does not go on
    assert game.phase is GamePhase.PAUSED
