"""A policy against a line-up: sides, wins, and outlast rollout --others."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock
from outlast.envs.core.agents import alive, side
from outlast.envs.errors import UsageError
from outlast.envs.rollout.against import Against
from outlast.envs.rollout.lineup import own_side, role_of
from outlast.envs.rollout.local import rollout
from outlast.envs.rollout.outcome import own_wins, shares_beaten, wins
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import COMPILED, digest, run, scaled
from tests.helpers.execution_modes import short
from tests.helpers.remembering import Remembering
from tests.rollout.test_lineup import mixed, naive_draw

STEPS = scaled(160, least=28)

# ---- sides


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
    assert wins(np.array([[3, 2], [2, 2], [0, 9]])).tolist() == [[1, 0], [0.5, 0.5], [0, 1]]


def test_equals_outlive_half_of_the_others_however_many_sides_there_are() -> None:
    life = np.array([[5, 9, 5, 0, 7], [5, 9, 3, 0, 0]])  # in the second world, three sides are there
    of_each = [shares_beaten(life, np.full(2, own), np.array([5, 3])).tolist() for own in range(3)]
    assert of_each == [[1.5 / 4, 0.5], [1, 1], [1.5 / 4, 0]]
    many = np.random.default_rng(0).integers(0, 4, (50, 5))
    each = [shares_beaten(many, np.full(50, own), np.full(50, 5)) for own in range(5)]
    np.testing.assert_allclose(np.mean(each, 0), 0.5)
    two, own = many[:, :2], many[:, 2] % 2
    assert (shares_beaten(two, own, np.full(50, 2)) == own_wins(two, own)).all()


# ---- a policy against a line-up


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
    worlds, each, names = scaled(24, least=4), 2, ["noop", "scripted"]
    expected = counted(scenario, names, worlds, each, 3)
    env = outlast.make_vec(scenario, worlds, seed=3)
    against = Against(env, POLICIES["scripted"](env, 3), mixed(dict.fromkeys(names, 1), env))
    assert rollout(env, against, episodes=each, watch=against.watch).episodes == worlds * each
    assert against.counts.tolist() == list(expected.values())
    assert against.counts.sum() == worlds * each
    assert (against.counts[:, [0, 2]].sum(0) > 0).all() or not COMPILED


def test_a_policy_with_a_memory_plays_against_others() -> None:
    env, one, other = outlast.make_vec(short("ffa_3"), 3, seed=3), Remembering(), Remembering()
    against = Against(env, one, mixed({other: 1}, env))
    alone = outlast.make_vec(short("ffa_3"), 3, seed=3)
    rollout(env, against, STEPS)
    rollout(alone, Remembering(), STEPS)
    assert digest(env.worlds) == digest(alone.worlds)  # as they do the same
    assert one.told[0].all()
    assert len(one.told) > 1
    assert len(one.told) == len(other.told)


def test_one_side_has_nobody_to_play_against() -> None:
    env = outlast.make_vec("ffa_1", 2, seed=0, n_agents=1)
    with pytest.raises(UsageError, match="ffa_1-n_agents=1 has one side: there is nobody to play against"):
        Against(env, POLICIES["noop"](env, 0), mixed({"noop": 1}, env))


SMALL = ("rollout", "ffa_2", "--worlds", "20", "--set", "safe_zone_damage=100", "--quiet")


def test_the_command_reports_wins_against_each(capsys: Any) -> None:
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


def test_others_are_written_and_recorded_as_all_agents(capsys: Any, tmp_path: Any) -> None:
    files = ("--events", tmp_path / "a.csv", "--record", tmp_path / "a.rec")
    assert run(capsys, *SMALL, "--others", "scripted,random", *files)[0] == 0
    assert (tmp_path / "a.csv").stat().st_size > 1000
    assert run(capsys, "replay", tmp_path / "a.rec", "--quiet")[0] == 0


@pytest.mark.parametrize(
    ("others", "words"),
    [("scriptd:0.5", "--others: scriptd: did you mean scripted"), ("noop:0", "the weight of noop is '0'")],
)
def test_lineups_that_the_command_refuses(capsys: Any, others: str, words: str) -> None:
    with pytest.raises(SystemExit):
        run(capsys, *SMALL, "--others", others)
    assert words in capsys.readouterr().err


def test_others_and_ray_are_refused_together(capsys: Any) -> None:
    status, _, err = run(capsys, *SMALL, "--others", "noop", "--ray")
    assert status == 2
    assert err == "outlast: --others plays on one machine: leave it out with --ray\n"
