"""Line-ups: their texts, who is drawn, the policy that they make up, a policy against them, and who wins."""

import importlib.util
import re
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock
from outlast.envs.core.spaces import alive, side
from outlast.envs.errors import ActionError, UsageError
from outlast.envs.rendering.scene import Scene
from outlast.envs.rendering.words import winner
from outlast.envs.rollout import lineup
from outlast.envs.rollout.lineup import STREAM, Lineup, checked_entries, draw, own_side, parse_lineup, role_of
from outlast.envs.rollout.local import rollout
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.web.game import Game
from tests.conftest import run
from tests.helpers.execution_modes import short
from tests.helpers.goal import TICK, won_by_points
from tests.helpers.remembering import Remembering

WORLDS, STEPS = 13, 160


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
    "kamper:2": "kamper: did you mean camper",
    ".zip": "zip: random, noop",
    "a.pt:1": "a.pt: random, noop",
    "random:2:3": "random:2: did you mean random",
    "random:0": "the weight of random is '0': a finite number above 0 is needed; leave out who has 0",
    "random:nan": "the weight of random is 'nan'",
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
        ([(3, 1)], "3 is not a policy: .*, or a function"),
        ([("noop", True)], "the weight of noop is True"),
        ([("noop", None)], "the weight of noop is None"),
    ],
)
def test_entries_that_cannot_be_are_refused(pairs: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        checked_entries(pairs)


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
    rng, count = np.random.default_rng(0), 500
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


@pytest.mark.parametrize("weights", [[], [0, 0], [1, -1], [1, np.nan], [np.inf, 1], [[1, 0], [0, 0]]])
def test_weights_that_cannot_be_are_refused(weights: Any) -> None:
    with pytest.raises(ValueError, match="finite numbers >= 0 are needed, in each row one above 0"):
        draw(weights, [0, 0], [0, 1], [0, 0])


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
    assert changes


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


def test_sides_take_turns() -> None:
    """In neighbouring worlds and episodes; of two sides, role 0 has the one that a policy plays alone."""
    world, episode = np.arange(6, dtype=np.uint64)[:, None], np.arange(4, dtype=np.uint64)
    for sides in (2, 3):
        own = own_side(world, episode, sides)
        assert (own[1:] != own[:-1]).all()
        assert (own[:, 1:] != own[:, :-1]).all()
        assert np.bincount(own[:, :1].ravel().astype(int)).tolist() == [6 // sides] * sides
    assert (role_of(own_side(world, episode, 2), world, episode) == 0).all()


def test_the_longest_lived_side_wins() -> None:
    assert lineup.wins(np.array([[3, 2], [2, 2], [0, 9]])).tolist() == [[1, 0], [0.5, 0.5], [0, 1]]
    life = np.array([[5, 9, 5, 0, 7], [5, 9, 3, 0, 0]])  # in the second world, three sides are there
    of_each = [lineup.shares_beaten(life, np.full(2, own), np.array([5, 3])).tolist() for own in range(3)]
    assert of_each == [[1.5 / 4, 0.5], [1, 1], [1.5 / 4, 0]]
    many = np.random.default_rng(0).integers(0, 4, (50, 5))
    each = [lineup.shares_beaten(many, np.full(50, own), np.full(50, 5)) for own in range(5)]
    np.testing.assert_allclose(np.mean(each, 0), 0.5)
    two, own = many[:, :2], many[:, 2] % 2
    assert (lineup.shares_beaten(two, own, np.full(50, 2)) == lineup.own_wins(two, own)).all()


def counted(scenario: Any, names: list[str], worlds: int, each: int, seed: int) -> dict[str, list[int]]:
    """Episodes that scripted won, drew and lost against each, in a plain loop."""
    env = outlast.make_vec(scenario, worlds, seed=seed)
    policy, others = POLICIES["scripted"](env, seed), [POLICIES[name](env, seed) for name in names]
    results: dict[str, list[int]] = {name: [0, 0, 0] for name in names}
    observations, _ = env.reset()
    sides, clock = side(env.worlds, 0), env.worlds[Clock]
    count, last = [0] * worlds, np.zeros((worlds, env.num_agents), int)
    while min(count) < each:
        mine, all_others = policy(observations), [other(observations) for other in others]
        actions, drawn, own = mine.copy(), [0] * worlds, [0] * worlds
        for w in range(worlds):
            episode = int(clock.episode[w, 0])
            drawn[w] = naive_draw([1.0] * len(names), seed, w, episode)
            own[w] = (w + episode) % int(sides.max() + 1)
            for i in range(env.num_agents):
                if sides[i] != own[w]:
                    actions[w, i] = all_others[drawn[w]][w, i]
        observations, _, terminated, truncated, _ = env.step(actions)
        living = alive(env.worlds)
        for w in range(worlds):
            for i in range(env.num_agents):
                if living[w, i]:
                    last[w, i] = clock.tick[w, 0]
            if terminated[w] or truncated[w]:
                if count[w] < each:
                    life = [int(last[w][belongs].max()) for belongs in (sides == own[w], sides != own[w])]
                    results[names[drawn[w]]][0 if life[0] > life[1] else 1 if life[0] == life[1] else 2] += 1
                count[w] += 1
                last[w] = 0
    env.close()
    return results


@pytest.mark.parametrize(("variant", "numbers"), [("ffa_3", {}), ("teams_3", {}), ("ffa_1", {"n_agents": 3})])
def test_wins_are_as_counted_in_a_plain_loop(variant: str, numbers: dict[str, int]) -> None:
    scenario = short(variant).replace(safe_zone_stand=60, motors_ahead=1.0, **numbers)
    worlds, each, names = 24, 2, ["noop", "scripted"]
    expected = counted(scenario, names, worlds, each, 3)
    env = outlast.make_vec(scenario, worlds, seed=3)
    against = lineup.Against(env, POLICIES["scripted"](env, 3), mixed(dict.fromkeys(names, 1), env))
    assert rollout(env, against, episodes=each, watch=against.watch).episodes == worlds * each
    assert against.counts.tolist() == list(expected.values())
    assert against.counts.sum() == worlds * each
    assert (against.counts[:, [0, 2]].sum(0) > 0).all()


def test_one_side_has_nobody_to_play_against() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0, n_agents=1)
    with pytest.raises(UsageError, match="ffa_1-n_agents=1 has one side: there is nobody to play against"):
        lineup.Against(env, POLICIES["noop"](env, 0), mixed({"noop": 1}, env))


SMALL = ("rollout", "ffa_2", "--worlds", "20", "--set", "safe_zone_damage=100", "--quiet")


def test_the_command_reports_wins_against_each(capsys) -> None:
    arguments = (*SMALL, "--policy", "scripted", "--others", "noop:0.5,scripted:0.5", "--episodes", "2")
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "ffa_2-safe_zone_damage=100: scripted policy against noop, scripted, seed 0, 20 worlds x 2 episodes\n" in out
    assert "40 whole episodes, the first 2 of every world" in out
    assert "return 1" in out
    head, *rows = out.split("\n\n")[-1].splitlines()
    assert head.split() == ["against", "episodes", "won", "drawn", "lost"]
    table = {name: [float(cell) for cell in cells if cell != "±"] for name, *cells in map(str.split, rows)}
    assert table.keys() == {"noop", "scripted"}
    assert sum(episodes for episodes, *_ in table.values()) == 40
    for episodes, *shares in table.values():
        assert sum(shares[::2]) == pytest.approx(1, abs=2e-4)
        for share, error in zip(shares[::2], shares[1::2], strict=True):
            assert error == pytest.approx(np.sqrt(share * (1 - share) / (episodes - 1)), abs=1e-4)
    assert table["noop"][1] > table["scripted"][1]
    tables = [out.split("\n\n", 1)[1] for out in (out, run(capsys, *arguments, "--threads", "2")[1])]
    assert tables[0] == tables[1]
    out = run(capsys, "rollout", "ffa_2", "--worlds", "2", "--quiet", "--others", "noop", "--steps", "3")[1]
    assert out.splitlines()[-1].split() == ["noop", "0", "-", "-", "-"]


needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch: outlast[train]")


def test_rollouts_count_who_came_farthest() -> None:
    """Nobody dies: with the numbers that the game gives to sides the last one wins, without them all is drawn."""
    found = outlast.rollout(won_by_points(), "noop", worlds=4, episodes=2, others="noop", keep=True).arrays()
    assert found["result"].tolist() == ["won" if own else "lost" for own in found["own_side"]]
    assert (found["outcome"] == [-5, -4]).all()
    lived = outlast.rollout("ffa_2", "noop", worlds=4, others="noop", ending_limit=TICK)
    assert lived.outcomes["noop"].tolist() == [0, 4, 0]


@pytest.mark.parametrize("agents", [2, 3])
def test_pictures_and_pages_name_the_winner(agents: int) -> None:
    for agent in range(agents):
        game = Game(won_by_points().replace(n_agents=agents), agent=agent, others="noop", seed=3)
        game.begin()
        while game.tick():
            pass
        assert winner(Scene(game.env.worlds, 0)) == agents - 1
        assert game.state()["result"]["verdict"] == ("won" if agent == agents - 1 else "lost")
        game.close()


def test_absent_sides_do_not_win() -> None:
    game = won_by_points().replace(n_agents=3).vary(n_agents=outlast.distributions.integers(2, 3))
    env = outlast.make_vec(game, 16, seed=0, autoreset_mode="Disabled")
    env.reset()
    for _ in range(TICK):
        env.step(np.tile(env.noop, (16, 3, 1)))
    come = lineup.Standings(env.worlds).of(np.arange(16))
    counts = env.numbers()["agents_count"]
    assert set(counts) == {2, 3}
    assert (come.argmax(1) == counts - 1).all()


@needs_torch
def test_evaluations_and_opponents_of_training_know_it() -> None:
    from outlast.training.base.config import TrainingConfig
    from outlast.training.ppo.trainer import Trainer

    found = outlast.evaluate(won_by_points(), {"a": "noop", "b": "scripted"}, episodes=8, worlds=4, quiet=True)
    estimates: dict[str, Any] = found.estimates("a", "b")
    assert (estimates["wins_first"][0], estimates["wins_second"][0], estimates["wins"][0]) == (0, 1, 0.5)
    trainer = Trainer(TrainingConfig(won_by_points(), worlds=4, rollout=4 * TICK, opponents={"noop": 1.0}), 1)
    trainer.collect()
    lane = trainer.lane
    assert sorted(won for *_, won in lane.games) == [0, 0, 1, 1]
