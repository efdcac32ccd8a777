"""Agents as sub-environments under Gymnasium's vector wrappers, and their pictures."""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import vector as wrappers

import outlast
from outlast.envs.rendering.rgb import draw, text
from tests.adapters.test_agents import MODES, SEED, STEPS, drawn, make, same
from tests.conftest import scaled

# ---- pictures


@pytest.mark.parametrize("mode", ["rgb_array", "ansi"])
def test_sub_environments_show_their_world(mode: str) -> None:
    env = make("ffa_3", worlds=2, seed=SEED, render_mode=mode)
    env.reset()
    frames = env.render()
    assert isinstance(frames, tuple)
    assert len(frames) == 4
    expected = [(draw if mode == "rgb_array" else text)(env.base_env.worlds, w) for w in (0, 0, 1, 1)]
    assert all(np.array_equal(a, b) for a, b in zip(frames, expected, strict=True))
    assert not np.array_equal(expected[0], expected[2])
    assert isinstance(frames, tuple)
    assert frames[0] is frames[1]
    env.step(drawn(env, 0))
    assert all(np.array_equal(a, b) for a, b in zip(frames, expected, strict=True))


@pytest.mark.parametrize("mode", ["rgb_array", "ansi"])
def test_worlds_show_themselves(mode: str) -> None:
    env = outlast.make_vec("ffa_3", 2, seed=SEED, render_mode=mode)
    env.reset()
    frames = env.render()
    assert isinstance(frames, tuple)
    expected = [(draw if mode == "rgb_array" else text)(env.worlds, w) for w in (0, 1)]
    env.reset()
    assert all(np.array_equal(a, b) for a, b in zip(frames, expected, strict=True))
    for move in (env.reset, lambda: env.set_state(env.get_state()), lambda: env.step(np.ones((2, 2, 6), int))):
        move()
        assert all(np.array_equal(a, b) for a, b in zip(frames, expected, strict=True))


def test_without_a_render_mode_nothing_is_drawn() -> None:
    for env in (make(worlds=1), outlast.make_vec("ffa_3", 1)):
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None


def test_a_render_mode_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="'rgb_array', 'ansi'"):
        outlast.make_vec("ffa_3", 1, render_mode="human")


# ---- Gymnasium's wrappers


@pytest.mark.parametrize("mode", MODES)
def test_record_episode_statistics_counts_what_info_reports(mode: str) -> None:
    if mode == "SameStep" and tuple(map(int, gymnasium.__version__.split(".")[:2])) < (1, 4):
        pytest.skip("this gymnasium leaves out the first step of an episode")
    env = wrappers.RecordEpisodeStatistics(make(seed=SEED, autoreset_mode=mode), buffer_length=10_000)
    env.reset()
    ends = 0
    for tick in range(STEPS):
        _, _, terminated, truncated, info = env.step(drawn(env, tick))
        if (done := terminated | truncated).any():
            assert same(info["_episode"], done)
            assert np.array_equal(info["episode"]["r"], info["statistics"]["return"])
            assert np.array_equal(info["episode"]["l"], info["statistics"]["length"])
            if mode == "Disabled":
                env.reset(options={"reset_mask": done})
        ends += int(done.sum())
    assert env.episode_count == len(env.return_queue) == ends >= env.num_envs


@pytest.mark.parametrize("mode", ["NextStep", "Disabled"])
def test_flatten_observation(mode: str) -> None:
    """Gymnasium refuses every wrapper of observations under SAME_STEP."""
    env, flat = (make(seed=SEED, autoreset_mode=mode) for _ in range(2))
    wrapped = wrappers.FlattenObservation(flat)
    assert wrapped.single_observation_space.shape == (env.base_env.flat_size,)
    observations, flattened = env.reset()[0], wrapped.reset()[0]
    for tick in range(3):
        for k in range(env.num_envs):
            row = {key: values[k] for key, values in observations.items()}
            assert np.array_equal(gymnasium.spaces.flatten(env.single_observation_space, row), flattened[k])
        observations, flattened = env.step(drawn(env, tick))[0], wrapped.step(drawn(env, tick))[0]


def test_normalize_observation_of_flat_ones() -> None:
    """It takes no dicts, and no other mode than NEXT_STEP."""
    env = make(seed=SEED)
    wrapped = wrappers.NormalizeObservation(wrappers.FlattenObservation(env))
    wrapped.reset()
    for tick in range(scaled(40, least=10)):
        observations, *_ = wrapped.step(drawn(env, tick))
    assert observations.shape == (env.num_envs, env.base_env.flat_size)
    assert np.isfinite(observations).all()
    assert abs(observations.mean()) < 1


def test_reward_wrappers() -> None:
    plain, changed, normal = (make(seed=SEED, autoreset_mode="SameStep") for _ in range(3))
    changed = wrappers.ClipReward(wrappers.TransformReward(changed, lambda reward: 3 * reward), -2, 2)
    normal = wrappers.NormalizeReward(normal)
    for env in (plain, changed, normal):
        env.reset()
    for tick in range(scaled(40, least=10)):
        _, reward, *_ = plain.step(drawn(plain, tick))
        assert np.array_equal(changed.step(drawn(plain, tick))[1], np.clip(3 * reward, -2, 2))
        normalised = normal.step(drawn(plain, tick))[1]
        assert np.array_equal(np.sign(normalised), np.sign(reward))
        assert np.isfinite(normalised).all()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_infos_as_a_list(mode: str) -> None:
    env, other = (make(seed=SEED, autoreset_mode=mode) for _ in range(2))
    listed = wrappers.DictInfoToList(wrappers.RecordEpisodeStatistics(env))
    other.reset()
    assert listed.reset()[1] == [{"alive": True}] * env.num_envs
    ends = 0
    for tick in range(STEPS):
        _, _, terminated, truncated, infos = listed.step(drawn(env, tick))
        info = other.step(drawn(env, tick))[-1]
        for k, (done, found) in enumerate(zip(terminated | truncated, infos, strict=True)):
            assert found["alive"] == info["alive"][k]
            assert ("statistics" in found) == ("episode" in found) == done
            assert ("final_obs" in found) == ("final_info" in found) == (done and mode == "SameStep")
            if done:
                assert found["statistics"] == {key: values[k] for key, values in info["statistics"].items()}
            ends += done
    assert ends >= env.num_envs


def test_observations_are_filtered_and_changed() -> None:
    env = wrappers.FilterObservation(make(worlds=2, seed=SEED), ["own", "zone"])
    env = wrappers.TransformObservation(env, lambda observations: observations)
    assert set(env.reset()[0]) == {"own", "zone"}
    assert set(env.step(drawn(env, 0))[0]) == {"own", "zone"}


OPTIONS: dict[str, tuple[Any, ...]] = {
    "ClipReward": (-1, 1), "DelayObservation": (2,), "DtypeObservation": (np.float16,),
    "FilterObservation": (["own"],),
    "FrameStackObservation": (2,), "MaxAndSkipObservation": (2,), "ObstructView": (0.5, 2), "RepeatAction": (2,),
    "RescaleAction": (0.0, 1.0), "RescaleObservation": (0.0, 1.0), "ReshapeObservation": ((3,),),
    "ResizeObservation": ((8, 8),), "StickyAction": (0.5,), "TimeLimit": (5,),
    "TransformReward": (lambda reward: reward,),
    "TransformAction": (lambda action: action, None), "TransformObservation": (lambda seen: seen, None),
    "AddWhiteNoise": (0.5,),
}  # fmt: skip
OTHERS = {"RecordVideo", "HumanRendering", "AtariPreprocessing"}  # write files, open windows, need another library


def wrappers_of(module: Any) -> dict[str, Any]:
    base = gymnasium.vector.VectorWrapper if module is wrappers else gymnasium.Wrapper
    found = {name: kind for name, kind in vars(module).items() if isinstance(kind, type) and issubclass(kind, base)}
    return {name: kind for name, kind in found.items() if name not in OTHERS and not name.startswith("Vectorize")}


VECTORS: dict[str, Any] = {
    "make_agents": outlast.make_agents,
    "gymnasium.make_vec": lambda name, num_envs, **options: gymnasium.make_vec(
        "outlast/FreeForAll-v1", num_envs=num_envs, scenario=name, **options
    ),
}


def tried(module: Any, make_env: Callable[[], Any]) -> tuple[set[str], dict[str, str]]:
    """Gymnasium's wrappers around an environment that is played: names of those that worked, errors of the others."""
    worked, refused = set(), {}
    for name, wrapper in wrappers_of(module).items():
        try:
            env = wrapper(make_env(), *OPTIONS.get(name, ()))
            env.reset(seed=SEED)
            env.step(env.action_space.sample())
            worked.add(name)
        except (TypeError, ValueError) as error:
            refused[name] = str(error)
    return worked, refused


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("maker", VECTORS)
@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about modes of rendering
def test_vector_wrappers_work_or_say_why_not(maker: str, mode: str) -> None:
    """What is refused is refused by name, because of the autoreset mode, or as it takes no dicts."""
    make_env = partial(VECTORS[maker], "ffa_1", 2, render_mode="rgb_array", autoreset_mode=mode)
    worked, refused = tried(wrappers, make_env)
    for name, error in refused.items():
        assert name in error or "autoreset_mode" in error or name == "NormalizeObservation"
    assert {"ClipReward", "DictInfoToList", "NormalizeReward", "RecordEpisodeStatistics"} <= worked
    assert ("FlattenObservation" in worked) == (mode != "SameStep")


@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about modes of rendering
def test_wrappers_of_single_environments_work_or_say_why_not() -> None:
    worked, refused = tried(
        gymnasium.wrappers, partial(gymnasium.make, "outlast/FreeForAll1-v1", render_mode="rgb_array")
    )
    for name, error in refused.items():
        assert re.search(f"{name}|Box|TimeLimit|observation space must have the shape", error)
    assert {"FlattenObservation", "FrameStackObservation", "RecordEpisodeStatistics", "TimeLimit"} <= worked


@pytest.mark.parametrize("maker", [make, outlast.make_vec])
def test_videos_are_recorded(tmp_path: Any, maker: Any) -> None:
    pytest.importorskip("moviepy", reason="gymnasium's RecordVideo needs moviepy")
    env = wrappers.RecordVideo(
        maker("ffa_3", 2, seed=SEED, render_mode="rgb_array"), str(tmp_path / "videos"), record_first_only=True,
        video_length=5, step_trigger=lambda step: step == 0,
    )  # fmt: skip
    env.reset()
    for _ in range(8):
        env.step(env.action_space.sample())
    env.close()
    (video,) = (tmp_path / "videos").glob("*.mp4")
    assert video.stat().st_size > 1000
