"""The batched environment: spaces, the contract of reset and step, and the same bits whichever way it is run."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, Scenario, make_vec, variant
from outlast.components import Body, Episode, Reward
from outlast.ecs import Clock
from outlast.envs.errors import FaultError, NotResetError
from outlast.envs.vector import SurvivalVectorEnv
from tests.conftest import COMPILED, digest, draw_actions, scaled

KINDS = ("ffa_1", "ffa_3", "teams_2", "teams_3")  # the others differ from these in numbers only
WORLDS = scaled(40, least=4)
BATCH = scaled(1024, least=12)
SHORT: dict[str, Any] = {  # episodes of different lengths, all of them within 80 ticks
    "agents_health": 10, "zone_radii": (9.0, 4.0), "zone_stand": 10, "zone_shrink": 10, "ending_limit": 60,
}  # fmt: skip
KEYS = {
    "self": (), "others": (), "others_mask": (), "zone": (),
    "heals": (15, 2), "heals_mask": (15,), "heal_slot": (1, 1), "heal_slot_mask": (1,),
    "boxes": (8, 11), "boxes_mask": (8,), "box_items": (8, 10), "box_items_mask": (8,),
    "box_slot": (1, 8), "box_slot_mask": (1,),
}  # fmt: skip
Env = SurvivalVectorEnv


def short(name: str) -> Scenario:
    return variant(name).replace(**SHORT)


def numbered_actions(env: Env, tick: int) -> np.ndarray[Any, Any]:
    """Random actions that depend on the tick and on each world's own number, not on the batch."""
    sizes = env.single_action_space.nvec
    actions = np.random.default_rng(tick).integers(0, sizes, (BATCH, *sizes.shape))
    return actions[env.first_world : env.first_world + env.num_worlds]


def trace(env: Env, ticks: int, where: Any = slice(None)) -> list[str]:
    """Digests of the worlds `where` after reset(seed=3) and after each tick."""
    env.reset(seed=3)
    digests = [digest(env.worlds, where)]
    for tick in range(ticks):
        env.step(numbered_actions(env, tick))
        digests.append(digest(env.worlds, where))
    return digests


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


# ---- spaces


@pytest.mark.parametrize("name", VARIANTS)
def test_spaces_are_those_of_the_rules(name: str) -> None:
    """Reference rules, section 4, with the kinds that a variant lacks left out."""
    env = make_vec(name, 2, seed=0)
    teams, boxes = name.startswith("teams"), name not in ("ffa_1", "ffa_2", "teams_2")
    agents, features = (4, 9) if teams else (2, 8)
    shapes = {key: shape for key, shape in KEYS.items() if boxes or not key.startswith("box")}
    shapes |= {"self": (features,), "others": (agents - 1, features), "others_mask": (agents - 1,), "zone": (6,)}
    space = env.single_observation_space
    assert {key: space[key].shape for key in space} == {key: (agents, *shape) for key, shape in shapes.items()}
    assert env.single_action_space.nvec.tolist() == [[3, 3, 3, 2, 2, 2]] * agents
    observations, info = env.reset()
    assert info == {}
    assert list(observations) == sorted(shapes)
    for key, values in observations.items():
        assert (values.dtype, values.shape) == (np.float32, (2, agents, *shapes[key]))
    mask = space["heals_mask"]
    assert (mask.low.min(), mask.high.max()) == (0, 1)


@pytest.mark.parametrize("name", KINDS)
def test_what_comes_out_lies_in_the_spaces(name: str) -> None:
    env = make_vec(short(name), WORLDS, seed=0)
    env.action_space.seed(0)
    observations, _ = env.reset(seed=1)
    for _ in range(scaled(150, least=30)):
        assert env.observation_space.contains(observations)
        observations, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert (reward.dtype, reward.shape) == (np.float32, (WORLDS, env.num_agents))
        for flag in (terminated, truncated):
            assert (flag.dtype, flag.shape) == (bool, (WORLDS,))
        assert not (terminated & truncated).any()


@pytest.mark.parametrize("agents", [1, 3, 40])
def test_any_number_of_agents(agents: int) -> None:
    """Also a single one, for whom there are no others; and the same compiled tick serves them all."""
    env = make_vec(variant("ffa_1").replace(n_agents=agents), 2, seed=0)
    observations, _ = env.reset()
    assert observations["others"].shape == (2, agents, agents - 1, 8)
    rng = np.random.default_rng(0)
    for _ in range(5):
        observations, reward, terminated, _, _ = env.step(draw_actions(env, rng))
    assert observations["self"][:, :, 0].tolist() == [list(range(agents))] * 2
    assert (reward == 1).all()
    assert not terminated.any()


# ---- reset


def test_an_int_seeds_every_world_by_its_number() -> None:
    env, other = make_vec("teams_3", 4, seed=0), make_vec("teams_3", 4, seed=7)
    first = {key: values.copy() for key, values in env.reset(seed=7)[0].items()}
    assert equal(first, other.reset()[0])
    assert len({values.tobytes() for values in first["self"]}) == 4  # no two worlds alike
    assert not equal(first, other.reset(seed=8)[0])


def test_a_list_seeds_every_world_alone() -> None:
    """Worlds of one seed are equal, and equal to a batch of one with that seed."""
    env = make_vec("teams_3", 3, seed=0)
    for seeds in ([5, 9, 5], np.array([5, 9, 5], np.uint32), (5, 2**64 - 1, 5)):
        observations, _ = env.reset(seed=seeds)
        alone, _ = make_vec("teams_3", 1, seed=5).reset()
        for key, values in observations.items():
            assert np.array_equal(values[0], values[2])
            assert np.array_equal(values[0], alone[key][0])
        assert not np.array_equal(observations["self"][0], observations["self"][1])


def test_without_a_seed_reset_goes_on_to_the_next_episode() -> None:
    """The one that autoreset would have started, whenever it is called."""
    env, other = make_vec(short("teams_3"), WORLDS, seed=3), make_vec(short("teams_3"), WORLDS, seed=3)
    first = {key: values.copy() for key, values in env.reset()[0].items()}
    second, _ = env.reset()
    assert not equal(first, second)
    assert equal(first, other.reset()[0])
    seen = np.zeros(WORLDS, bool)
    over = seen.copy()
    for tick in range(80):
        observations, _, terminated, truncated, _ = other.step(numbered_actions(other, tick))
        fresh, over = over & ~seen, terminated | truncated
        for key, values in observations.items():
            assert np.array_equal(values[fresh], second[key][fresh])
        seen |= fresh
    assert seen.all()


def test_reset_mask_leaves_the_others_untouched() -> None:
    env, twin = make_vec("teams_3", 5, seed=0), make_vec("teams_3", 5, seed=0)
    mask = np.array([True, False, False, True, False])
    for one in (env, twin):
        one.reset()
        for tick in range(10):
            one.step(numbered_actions(one, tick))
    observations, _ = env.reset(seed=11, options={"reset_mask": mask})
    assert digest(env.worlds, ~mask) == digest(twin.worlds, ~mask)
    fresh, _ = make_vec("teams_3", 5, seed=11).reset()
    for key, values in observations.items():
        assert np.array_equal(values[mask], fresh[key][mask])
    assert env.worlds[Clock].tick[:, 0].tolist() == [0, 10, 10, 0, 10]
    for tick in range(10):
        env.step(numbered_actions(env, tick))
        twin.step(numbered_actions(twin, tick))
    assert digest(env.worlds, ~mask) == digest(twin.worlds, ~mask)


@pytest.mark.parametrize("name", KINDS)
def test_a_used_world_resets_to_what_a_new_one_is(name: str) -> None:
    used, new = make_vec(short(name), WORLDS, seed=1), make_vec(short(name), WORLDS, seed=3)
    used.reset()
    for tick in range(scaled(300, least=40)):
        used.step(numbered_actions(used, tick + 1000))
    ticks = scaled(100, least=15)
    assert trace(used, ticks)[1:] == trace(new, ticks)[1:]  # after reset, only the buffers of actions may differ


# ---- the ends of episodes


def test_next_step_resets_in_a_step_of_its_own() -> None:
    """It ignores the actions, pays nothing, ends nothing, and shows the new episode."""
    env, other = make_vec(short("teams_3"), WORLDS, seed=0), make_vec(short("teams_3"), WORLDS, seed=0)
    env.reset()
    other.reset()
    over, resets = np.zeros(WORLDS, bool), 0
    for tick in range(80):
        actions = numbered_actions(env, tick)
        observations, reward, terminated, truncated, _ = env.step(actions)
        actions[over] = (actions[over] + 1) % 2
        other.step(actions)
        assert np.array_equal(env.worlds.block, other.worlds.block)
        assert not reward[over].any()
        assert not (terminated | truncated)[over].any()
        assert (env.worlds[Clock].tick[over] == 0).all()
        assert (observations["self"][over, :, 2] == 10).all()
        resets += over.sum()
        over = terminated | truncated
    assert resets >= WORLDS


def test_same_step_shows_both_episodes_at_once() -> None:
    """Beside NEXT_STEP: final_obs is the observation of its last step, and the observation that of its reset step."""
    same, following = (make_vec(short("teams_3"), WORLDS, seed=0, autoreset=mode) for mode in ("SameStep", "NextStep"))
    same.reset()
    following.reset()
    over = np.zeros(1, bool)
    while not over.any():
        actions = numbered_actions(same, 0)
        observations, *outcome, info = same.step(actions)
        buffers, *expected, expected_info = following.step(actions)
        last = {key: values.copy() for key, values in buffers.items()}
        assert all(np.array_equal(mine, theirs) for mine, theirs in zip(outcome, expected, strict=True))
        over = outcome[1] | outcome[2]
    assert not over.all()
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == over.tolist()
    assert equal(info["final_info"]["statistics"], expected_info["statistics"])
    fresh, *_ = following.step(actions)
    for w in range(WORLDS):
        if over[w]:
            assert all(np.array_equal(info["final_obs"][w][key], last[key][w]) for key in last)
            assert all(np.array_equal(observations[key][w], fresh[key][w]) for key in fresh)
        else:
            assert info["final_obs"][w] is None
            assert all(np.array_equal(observations[key][w], last[key][w]) for key in last)
    assert (same.worlds[Clock].tick[over] == 0).all()
    same.step(actions)  # and on without a pause
    assert (same.worlds[Clock].tick[over] == 1).all()


def test_disabled_waits_for_a_reset_of_what_ended() -> None:
    env = make_vec(short("teams_3"), WORLDS, seed=0, autoreset="Disabled")
    env.reset()
    for tick in range(80):
        _, _, terminated, truncated, _ = env.step(actions := numbered_actions(env, tick))
        if (over := terminated | truncated).any():
            break
    before = digest(env.worlds)
    with pytest.raises(NotResetError, match=rf"worlds \[{np.flatnonzero(over)[0]}.* have ended.*reset_mask"):
        env.step(actions)
    assert digest(env.worlds) == before
    others = digest(env.worlds, ~over)
    env.reset(options={"reset_mask": over})
    assert digest(env.worlds, ~over) == others
    env.step(actions)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_statistics_tell_the_episodes_that_ended(mode: str) -> None:
    """Lengths and returns as counted here; rows of worlds that go on are zero."""
    env = make_vec(short("teams_3"), WORLDS, seed=0, autoreset=mode)
    env.reset()
    length, returns, count = np.zeros(WORLDS, int), np.zeros((WORLDS, 4)), 0
    fresh = np.zeros(WORLDS, bool)
    for tick in range(80):
        _, reward, terminated, truncated, info = env.step(numbered_actions(env, tick))
        length += ~fresh
        returns += reward
        over = terminated | truncated
        assert bool(info) == over.any()
        if info:
            found = info["statistics"]
            assert info["_statistics"].tolist() == over.tolist()
            assert np.array_equal(found["length"], np.where(over, length, 0))
            assert np.array_equal(found["return"], np.where(over[:, None], returns, 0))
            dead = found["deaths_melee"] + found["deaths_zone"]
            assert (dead[over & terminated] >= 2).all()  # one team of two, or both
            assert (dead[~over] == 0).all()
            assert ((found["first_death"] <= found["length"]) | ~over).all()
            if mode == "SameStep":
                assert found is info["final_info"]["statistics"]
            count += over.sum()
        length[over], returns[over] = 0, 0
        fresh = over if mode == "NextStep" else fresh
    assert count >= WORLDS
    assert {"heals_used", "boxes_placed", "kills"} < found.keys()


def test_the_time_limit_truncates() -> None:
    """Exactly at the limit; a world that ends by its rule in that very tick is terminated instead."""
    scenario = variant("teams_3").replace(agents_health=11, zone_radii=(8.0,))  # who is outside dies in tick 12
    limited = make_vec(scenario.replace(ending_limit=12), scaled(200, least=16), seed=0)
    unlimited = make_vec(scenario, limited.num_worlds, seed=0)
    idle = np.tile([1, 1, 1, 0, 0, 0], (limited.num_worlds, 4, 1))
    limited.reset()
    unlimited.reset()
    for tick in range(1, 13):
        *_, terminated, truncated, _ = limited.step(idle)
        *_, ended, cut, _ = unlimited.step(idle)
        assert np.array_equal(terminated, ended)
        assert truncated.tolist() == (~terminated & (tick == 12)).tolist()
        assert not cut.any()
    assert terminated.any()
    assert truncated.any()


# ---- buffers


def test_buffers_are_reused_unless_copies_are_asked_for() -> None:
    for copy in (False, True):
        env = make_vec("teams_3", 2, seed=0, copy=copy)
        first, _ = env.reset()
        kept = {key: values.copy() for key, values in first.items()}
        second, reward, *_ = env.step(np.full((2, 4, 6), 2) * [1, 1, 1, 0, 0, 0])
        assert [first[key] is second[key] for key in first] == [not copy] * len(first)
        assert equal(first, kept) == copy
        assert not np.shares_memory(reward, env.worlds[Reward].reward)
        assert not any(np.shares_memory(values, env.worlds[Episode].returns) for values in second.values())


# ---- the same bits


@pytest.mark.parametrize("name", KINDS)
def test_runs_and_threads_and_batches_make_no_difference(name: str) -> None:
    ticks = scaled(200, least=12)
    expected = trace(make_vec(short(name), WORLDS, seed=0), ticks)
    assert len(set(expected)) == ticks + 1
    assert trace(make_vec(short(name), WORLDS, seed=0), ticks) == expected
    assert trace(make_vec(short(name), WORLDS, seed=0, threads=2), ticks) == expected
    for w in (0, WORLDS // 2, WORLDS - 1):
        alone = make_vec(short(name), 1, first_world=w)
        among = make_vec(short(name), BATCH if w else WORLDS)
        assert trace(alone, ticks // 4) == trace(among, ticks // 4, slice(w, w + 1))


@pytest.mark.parametrize("name", KINDS)
def test_the_order_of_modules_makes_no_difference(name: str) -> None:
    scenario, ticks = short(name), scaled(100, least=8)
    expected = trace(make_vec(scenario, WORLDS), ticks)
    rng = np.random.default_rng(0)
    for _ in range(3):
        order = rng.permutation(len(scenario.modules))
        shuffled = dataclasses.replace(scenario, modules=tuple(scenario.modules[k] for k in order))
        env = make_vec(shuffled, WORLDS)
        assert str(env.worlds.schedule) == str(make_vec(scenario, 1).worlds.schedule)
        assert trace(env, ticks) == expected


@pytest.mark.skipif(not COMPILED, reason="the native bridge needs compiled kernels")
def test_both_bridges_give_the_same_bits() -> None:
    """Crowded, so that contacts are many; boxes are set up on top of agents."""
    scenario = short("teams_3").replace(n_agents=12, room_size=26.0, agents_health=40)
    native = make_vec(scenario.replace(physics_bridge="native"), 8)
    portable = make_vec(scenario.replace(physics_bridge="portable"), 8)
    assert "(python)" in str(portable.worlds.schedule)
    assert "(python)" not in str(native.worlds.schedule)
    assert trace(portable, 150) == trace(native, 150)


@pytest.mark.slow
@pytest.mark.parametrize("name", VARIANTS)
def test_the_same_bits_for_two_thousand_ticks(name: str) -> None:
    """Threads 1, 2, 3 and 5, and one world of 1024 alone, with the paper's own numbers and many resets."""
    ticks = scaled(2000, least=40)
    batch = make_vec(name, 1024 if COMPILED else 4, threads=2)
    alone = [make_vec(name, 1, first_world=w) for w in (0, 3)]
    some = [make_vec(name, 96 if COMPILED else 4, threads=threads) for threads in (1, 2, 3, 5)]
    for env in (batch, *alone, *some):
        env.reset(seed=3)
    for tick in range(ticks):
        actions = np.random.default_rng(tick).integers(0, batch.single_action_space.nvec, batch.action_space.shape)
        for env in (batch, *alone, *some):
            env.step(actions[env.first_world : env.first_world + env.num_worlds])
        if tick % 10 == 0 or tick == ticks - 1:
            assert len({digest(env.worlds) for env in some}) == 1
            for env in alone:
                assert digest(env.worlds) == digest(batch.worlds, slice(env.first_world, env.first_world + 1))
            width = some[0].num_worlds
            assert digest(some[0].worlds) == digest(batch.worlds, slice(0, width))


@pytest.mark.parametrize("value", [np.nan, np.inf, 2e6])
def test_a_world_with_impossible_numbers_raises_and_a_reset_cures_it(value: float) -> None:
    """A mechanic that writes NaN is found in the tick it does so, and named by its world; the others are not harmed."""
    env, twin = make_vec("ffa_1", 3, seed=4), make_vec("ffa_1", 3, seed=4)
    for each in (env, twin):
        each.reset()
        each.step(np.ones((3, 2, 6), int))
    env.worlds[Body].vx[1, 0] = value
    with pytest.raises(FaultError, match=r"world 1: .*Reset"):
        env.step(np.ones((3, 2, 6), int))
    twin.step(np.ones((3, 2, 6), int))
    env.reset(options={"reset_mask": np.array([False, True, False])})
    env.step(np.ones((3, 2, 6), int))
    twin.step(np.ones((3, 2, 6), int))
    assert digest(env.worlds, [0, 2]) == digest(twin.worlds, [0, 2])
