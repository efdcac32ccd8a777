"""Line-ups: their texts, who is drawn, and the policy that they make up."""

import re
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock
from outlast.envs.errors import ActionError, UsageError
from outlast.envs.rollout.lineup import STREAM, Lineup, checked_entries, draw, parse_lineup
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import COMPILED, scaled
from tests.helpers.execution_modes import short
from tests.helpers.remembering import Remembering

WORLDS, STEPS = scaled(13, least=3), scaled(160, least=28)

# ---- texts

TEXTS: dict[str, dict[str, float]] = {
    "random": {"random": 1},
    "scripted:0.5,runs/a.zip:0.3,random:0.2": {"scripted": 0.5, "runs/a.zip": 0.3, "random": 0.2},
    " noop : 2 , random:1e-3": {"noop": 2, "random": 0.001},
    "C:\\runs\\a.zip,b:c.zip:3": {"C:\\runs\\a.zip": 1, "b:c.zip": 3},
}

NEEDED = "or a saved policy (a model's name, FILE.zip, FILE.safetensors or the folder of a run) is needed"


@pytest.mark.parametrize("text", TEXTS)
def test_texts_are_weights_in_their_order(text: str) -> None:
    assert list(parse_lineup(text).items()) == list(TEXTS[text].items())


def test_other_names_can_be_allowed() -> None:
    assert parse_lineup("self:2,past", ("self", "past")) == {"self": 2, "past": 1}
    with pytest.raises(UsageError, match=rf"pst: did you mean past\? self, past {re.escape(NEEDED)}"):
        parse_lineup("self,pst", ("self", "past"))
    with pytest.raises(UsageError, match="scripted: self, past or"):
        parse_lineup("scripted", ("self", "past"))


REFUSED = {
    "": f"nothing: {', '.join(POLICIES)} {NEEDED}",
    "random,": "nothing: random",
    "scriptd:2": "scriptd: did you mean scripted",
    ".zip": "zip: random, noop",
    "a.pt:1": "a.pt: random, noop",
    "random:2:3": "random:2: did you mean random",
    "random:0": "the weight of random is '0': a finite number above 0 is needed; leave out who has 0",
    "random:-1": "the weight of random is '-1'",
    "random:nan": "the weight of random is 'nan'",
    "random:inf": "the weight of random is 'inf'",
    "random:": "the weight of random is ''",
    "random:half": "the weight of random is 'half'",
    "random,noop,random:2": "random is there twice: give it once, with the sum of its weights",
    "a.zip,noop,./a.zip": "./a.zip is there twice",
}


@pytest.mark.parametrize("text", REFUSED)
def test_texts_that_are_no_lineup_are_refused(text: str) -> None:
    with pytest.raises(UsageError) as refused:
        parse_lineup(text)
    assert REFUSED[text] in str(refused.value)


@pytest.mark.parametrize(
    ("pairs", "words"),
    [
        ([], "a mixture of nothing"),
        ([(3, 1)], "3 is no policy: .*, or a function"),
        ([("noop", True)], "the weight of noop is True"),
        ([("noop", None)], "the weight of noop is None"),
    ],
)
def test_entries_that_cannot_be_are_refused(pairs: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        checked_entries(pairs)


# ---- draws


def naive_word(*parts: int) -> int:
    """SplitMix64's mixing function over the parts, in Python's integers."""
    word = 0
    for part in parts:
        word = ((word ^ part) + 0x9E3779B97F4A7C15) % 2**64
        word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        word = (word ^ (word >> 27)) * 0x94D049BB133111EB % 2**64
        word ^= word >> 31
    return word


def naive_draw(weights: Any, seed: int, world: int, episode: int) -> int:
    """The first entry at which the running sum of shares exceeds a uniform number."""
    chance = (naive_word(int(STREAM), seed, world, episode) >> 11) / 2**53
    shares = [float(weight) / max(map(float, weights)) for weight in weights]
    return next(k for k in range(len(shares)) if sum(shares[: k + 1]) > chance * sum(shares))


def test_draws_are_those_of_the_naive_form() -> None:
    """Weights of all worlds, and of each its own, some of them 0; seeds and worlds of 64 bits."""
    rng, count = np.random.default_rng(0), scaled(500, least=50)
    seeds, worlds, episodes = (rng.integers(0, 2**64 - 1, count, np.uint64, endpoint=True) for _ in range(3))
    own = rng.integers(0, 4, (count, 5)) / 4
    own[:, 2] += ~own.any(1)
    for weights in (own, own[0] + 0.1, [1e308, 1e308, 1e-308], [5e-324, 5e-324]):
        found = draw(weights, seeds, worlds, episodes)
        rows = np.broadcast_to(weights, (count, np.shape(weights)[-1]))
        assert found.tolist() == [
            naive_draw(*each) for each in zip(rows, *(keys.tolist() for keys in (seeds, worlds, episodes)), strict=True)
        ]
    assert (np.take_along_axis(own, draw(own, seeds, worlds, episodes)[:, None], 1) > 0).all()


def test_draws_have_their_frequencies_and_are_independent() -> None:
    weights, count = np.array([0.5, 0.3, 0.2]), 200
    world, episode = (keys.ravel() for keys in np.meshgrid(np.arange(count), np.arange(count), indexing="ij"))
    found = [draw(weights, np.full(count**2, seed), world, episode).reshape(count, count) for seed in (0, 1)]
    for drawn in found:
        assert deviation(np.bincount(drawn.ravel()), weights) < 5
        assert deviation(np.bincount(drawn.ravel()[(world + episode) % 2 == 0]), weights) < 5  # whichever the side
    pairs = [(found[0], found[1]), (found[0][1:], found[0][:-1]), (found[0][:, 1:], found[0][:, :-1])]
    for one, other in pairs:
        assert deviation(np.bincount((3 * one + other).ravel()), np.outer(weights, weights).ravel()) < 5


def deviation(counts: Any, weights: Any) -> float:
    """Standard deviations by which chi-squared is off its mean."""
    expected = counts.sum() * weights
    return abs(((counts - expected) ** 2 / expected).sum() - (len(counts) - 1)) / np.sqrt(2 * (len(counts) - 1))


def test_a_world_draws_the_same_alone() -> None:
    weights = np.random.default_rng(0).random((9, 4))
    whole = draw(weights, np.full(9, 3), np.arange(9), np.arange(9) % 2)
    assert whole.tolist() == [int(draw(weights[w], [3], [w], [w % 2])[0]) for w in range(9)]


@pytest.mark.parametrize("weights", [[], [0, 0], [1, -1], [1, np.nan], [np.inf, 1], [[1, 0], [0, 0]]])
def test_weights_that_cannot_be_are_refused(weights: Any) -> None:
    with pytest.raises(ValueError, match="finite numbers >= 0 are needed, in each row one above 0"):
        draw(weights, [0, 0], [0, 1], [0, 0])


# ---- line-ups as policies


def mixed(entries: Any, env: Any) -> Lineup:
    return Lineup(checked_entries(entries.items()), env)


def test_draws_change_where_episodes_begin_and_nowhere_else() -> None:
    """They are those of (seed, world, episode), whatever came between: another state, and back."""
    weights = {"random": 2.0, "noop": 1.0, "scripted": 1.0}
    env = outlast.make_vec(short("ffa_3"), WORLDS, seed=3, first_world=5)
    lineup = mixed(weights, env)
    act, clock, changes = told(lineup, env), env.worlds[Clock], 0
    observations, _ = env.reset()

    def expected() -> list[int]:
        return [
            naive_draw([*weights.values()], 3, 5 + w, int(episode)) for w, episode in enumerate(clock.episode[:, 0])
        ]

    for tick in range(STEPS):
        before = lineup.drawn.copy()
        actions = act(observations)
        assert lineup.drawn.tolist() == expected()
        changed = (before != lineup.drawn) & (tick > 0)
        assert not (changed & (clock.tick[:, 0] > 0)).any()
        changes += int(changed.sum())
        if tick == STEPS // 2:
            state, drawn = env.get_state(), lineup.drawn.copy()
            env.reset(seed=9)
            act(env.observe())
            observations = env.set_state(state)
            np.testing.assert_array_equal(act(observations), actions)
            assert lineup.drawn.tolist() == drawn.tolist()
        observations, *_ = env.step(actions)
    assert changes or not COMPILED


def test_each_world_is_played_by_the_policy_that_was_drawn() -> None:
    env = outlast.make_vec("teams_3", 9, seed=0)
    observations, _ = env.reset()
    asked = []

    def play(observations: Any) -> Any:
        asked.append(1)
        return np.full((9, 4, 6), 1)

    lineup = mixed({"scripted": 1, "noop": 1, play: 1e-9}, env)
    assert lineup.names == ("scripted", "noop", "play")
    actions = told(lineup, env)(observations)
    for k, name in enumerate(("scripted", "noop")):
        assert (lineup.drawn == k).any()
        expected = POLICIES[name](env, 0)(observations)
        np.testing.assert_array_equal(actions[lineup.drawn == k], expected[lineup.drawn == k])
    assert not asked  # it plays in no world


@pytest.mark.parametrize("parts", [[(0, 4), (4, 1), (5, 4)], [(0, 1), (1, 8)]])
def test_a_lineup_plays_a_world_the_same_in_every_batch(parts: list[tuple[int, int]]) -> None:
    whole = outlast.make_vec(short("teams_3"), 9, seed=5)
    envs = [whole, *(outlast.make_vec(short("teams_3"), n, seed=5, first_world=first) for first, n in parts)]
    acts = [told(mixed({"random": 1, "scripted": 1, "noop": 1}, env), env) for env in envs]
    seen = [env.reset()[0] for env in envs]
    for _ in range(STEPS):
        actions = [act(observations) for act, observations in zip(acts, seen, strict=True)]
        np.testing.assert_array_equal(actions[0], np.concatenate(actions[1:]))
        seen = [env.step(chosen)[0] for env, chosen in zip(envs, actions, strict=True)]


def test_policies_of_a_lineup_have_memories_and_are_checked() -> None:
    env = outlast.make_vec("teams_3", 9, seed=0)
    one, other = Remembering(), Remembering()
    act = told(mixed({one: 1, other: 1}, env), env)
    observations, _ = env.reset()
    for _ in range(3):
        observations, *_ = env.step(act(observations))
    assert [each.told[0].all() and len(each.told) == 1 for each in (one, other)] == [True, True]
    wrong = mixed({lambda observations: np.zeros((9, 3, 6), int): 1}, env)
    with pytest.raises(ActionError, match=r"the actions that <lambda> returned have shape \(9, 3, 6\).*\(9, 4, 6\)"):
        wrong(observations)

    class Picky(Remembering):
        def check(self, env: Any) -> None:
            raise ValueError(f"not in {env.scenario.name}")

    with pytest.raises(ValueError, match="not in teams_3"):
        mixed({"noop": 1, Picky(): 1}, env)
