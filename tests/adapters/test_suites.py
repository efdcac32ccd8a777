"""The suites of other libraries on every form of actions and observations; and one mask of a world, in every adapter.

TorchRL's and RLlib's are in test_torchrl.py and test_rllib.py.
"""

import contextlib
import copy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import outlast
from outlast.ecs import Clock
from tests.conftest import few_by_day
from tests.helpers.covering import covering
from tests.helpers.execution_modes import ALL, HUNT, short

pytestmark = pytest.mark.filterwarnings("ignore")  # of the suites: about dicts of rows, bounds and unused arguments
GAMES, DEAD = ["teams_3", "ffa_1", HUNT, ALL], ["end", "keep"]


def forms(*more: list[str]) -> list[Any]:
    """Forms of actions and observations, with more options; by day so many that each pair of options is there."""
    every = covering(("multi", "joint", "continuous"), ("dict", "flat"), (False, True), *more)
    values = [(dict(zip(("actions", "observations", "scaled"), each.values)), *each.values[3:]) for each in every]
    return [pytest.param(*own, marks=each.marks) for own, each in zip(values, every, strict=True)]


forms_of_games = pytest.mark.parametrize(("form", "name"), forms(GAMES))
dead_too = pytest.mark.parametrize(("form", "dead", "name"), forms(DEAD, GAMES))
games = pytest.mark.parametrize("name", few_by_day(["teams_3", ALL], ["teams_3"]))
CYCLES, SEED = 100, 4


def one(name: str, **options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make("outlast/Teams3-v1", scenario=short(name), disable_env_checker=True, **options)


@dead_too
def test_gymnasium(name: str, dead: str, form: dict[str, Any]) -> None:
    check_env(one(name, dead=dead, others="scripted", **form).unwrapped, skip_render_check=True)


@dead_too
def test_vectors_of_gymnasium(name: str, dead: str, form: dict[str, Any]) -> None:
    options = {"scenario": short(name), "dead": dead, **form}
    options["vectorization_mode"] = "vector_entry_point"
    with contextlib.closing(gymnasium.make_vec("outlast/Teams3-v1", 3, **options)) as batch:
        copies = gymnasium.vector.SyncVectorEnv([lambda: one(name, dead=dead, **form)] * 3)
        assert batch.single_action_space == copies.single_action_space
        assert batch.single_observation_space == copies.single_observation_space
        pairs = [tuple(each.reset(seed=SEED)[0] for each in (batch, copies))]
        batch.action_space.seed(SEED)
        for _ in range(5):
            actions = batch.action_space.sample()
            pairs.append(tuple(each.step(actions)[0] for each in (batch, copies)))
        for mine, theirs in pairs:
            assert batch.observation_space.contains(mine)
            assert gymnasium.utils.env_checker.data_equivalence(mine, theirs)
        copies.close()


@dead_too
def test_pettingzoo(name: str, dead: str, form: dict[str, Any]) -> None:
    pytest.importorskip("pettingzoo", reason="needs pettingzoo: outlast[pettingzoo]")
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test

    def make() -> Any:
        return outlast.adapters.parallel_env(short(name), dead=dead, **form)

    if form["actions"] == "multi" and form["observations"] == "dict":
        for masks in (True, "observation"):
            masked = outlast.adapters.aec_env(short(name), dead=dead, action_masks=masks, **form)
            api_test(masked, CYCLES)  # it samples with the masks, in infos or observations
            masked.close()
    parallel_api_test(make(), CYCLES)
    parallel_seed_test(make, CYCLES)
    api_test(outlast.adapters.aec_env(short(name), dead=dead, **form), CYCLES)


@forms_of_games
def test_supersuit(name: str, form: dict[str, Any]) -> None:
    """Its vectors, which refuse agents that leave."""
    pytest.importorskip("pettingzoo", reason="needs pettingzoo: outlast[pettingzoo]")
    supersuit = pytest.importorskip("supersuit", reason="needs SuperSuit: outlast[test-all]")
    agents = supersuit.pettingzoo_env_to_vec_env_v1(outlast.adapters.parallel_env(short(name), dead="keep", **form))
    env = supersuit.concat_vec_envs_v1(agents, 2, num_cpus=0, base_class="gymnasium")
    seen = env.reset(seed=SEED)[0]
    spaces = env.observation_space, env.action_space
    many, drawn = (gymnasium.vector.utils.batch_space(space, env.num_envs) for space in spaces)
    drawn.seed(SEED)
    for _ in range(CYCLES):
        assert many.contains(seen)
        seen, rewards, *_ = env.step(drawn.sample())
        assert np.isfinite(rewards).all()


@dead_too
def test_stable_baselines(name: str, dead: str, form: dict[str, Any]) -> None:
    pytest.importorskip("stable_baselines3", reason="needs Stable-Baselines3: outlast[sb3]")
    from stable_baselines3.common import env_checker

    env_checker.check_env(one(name, dead=dead, **form).unwrapped)


@pytest.mark.parametrize(("form", "dead"), forms(DEAD))
def test_minari(dead: str, form: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari", reason="needs Minari: outlast[data]")
    pytest.importorskip("jax", reason="needs JAX, as Minari's collector does: outlast[test-ray]")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(gymnasium.make("outlast/Teams3-v1", dead=dead, max_episode_steps=CYCLES, **form))
    seen = [env.reset(seed=SEED)[0]]
    env.action_space.seed(SEED)
    over = False
    while not over:
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        seen.append(observation)
        over = terminated or truncated
    dataset = env.create_dataset("outlast/collected-v0")
    env.close()
    (episode,) = dataset.iterate_episodes()
    again = minari.load_dataset("outlast/collected-v0").recover_environment()
    assert again.observation_space == dataset.observation_space
    replayed = [again.reset(seed=SEED)[0], *(again.step(action)[0] for action in episode.actions)]
    assert len(replayed) == len(seen)
    assert all(gymnasium.utils.env_checker.data_equivalence(*pair) for pair in zip(seen, replayed, strict=True))
    again.close()


@pytest.mark.parametrize("ends", [(-1.0, 0.3), (-2.0, 0.1), (-3.0, 0.3), (0.0, 255.0)])
def test_actions_that_gymnasium_rescales_are_in_range(ends: tuple[float, float]) -> None:
    """Its float32 goes beyond the ends by a rounding."""
    env = gymnasium.wrappers.RescaleAction(one("ffa_1", actions="continuous"), *map(np.float32, ends))
    env.reset(seed=SEED)
    for action in (env.action_space.low, env.action_space.high):
        env.step(action)


@pytest.mark.parametrize("actions", ["multi", "joint"])
@games
def test_masks_are_those_of_the_worlds(name: str, actions: str) -> None:
    """In every adapter of several worlds, given one of the same seed; test_parallel.py has one of a world."""
    plain = outlast.make_vec(short(name), 1, seed=SEED, actions=actions)
    plain.reset()
    batches = []
    for make in ("make_agents", "make_sb3", "make_puffer"):
        with contextlib.suppress(ModuleNotFoundError):
            batches.append(getattr(outlast.adapters, make)(short(name), 1, seed=SEED, actions=actions))
            batches[-1].reset()
    rng, ended = np.random.default_rng(SEED), False
    while not ended:
        for each in batches:
            assert np.array_equal(each.action_masks(), plain.action_masks()[0]), each
        chosen = rng.integers(0, plain.single_action_space.nvec)
        ended = np.any(plain.step(chosen[None])[2:4])
        for each in batches:
            each.step(chosen)


def test_a_seed_repeats_how_many_frames_supersuit_skips() -> None:
    """The reset's and the constructor's, in the generator that copies go on with; worlds draw nothing from it."""
    pytest.importorskip("pettingzoo", reason="needs pettingzoo: outlast[pettingzoo]")
    supersuit = pytest.importorskip("supersuit", reason="needs SuperSuit: outlast[test-all]")
    env = outlast.adapters.parallel_env(short("ffa_3"), dead="keep", seed=SEED)
    first = copy.deepcopy(env).np_random.integers(0, 1000, 5).tolist()
    for options in ({}, {"seed": SEED}):
        env.reset(**options)
        assert env.np_random.integers(0, 1000, 5).tolist() == first
    skipping, ticks = supersuit.frame_skip_v0(env, (1, 6)), []
    for _ in range(2):
        skipping.reset(seed=SEED)
        skipping.step(dict.fromkeys(env.possible_agents, np.ones(6, int)))
        ticks.append(env.base_env.worlds[Clock].tick[0, 0])
    assert ticks[0] == ticks[1]
