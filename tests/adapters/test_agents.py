"""Every agent of every world as a sub-environment: beside the batched environment, and under Gymnasium's wrappers."""

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import vector as wrappers

import outlast
from outlast import make_vec
from outlast.ecs import columns_of
from outlast.envs.adapters.gymnasium_agents import SurvivalAgentVectorEnv
from outlast.envs.core.spaces import counts_vary, present, side
from outlast.envs.errors import NotResetError
from tests.helpers.execution_modes import EACH_LEVEL, HUNT, equal, same, short

KINDS = ("ffa_3", "teams_3", HUNT, *EACH_LEVEL)
MODES = [mode.value for mode in AutoresetMode]
WORLDS, SEED = 20, 5
STEPS = 65  # enough for every world of short() to end


def make(name: str = "teams_3", worlds: int = WORLDS, **options: Any) -> SurvivalAgentVectorEnv:
    return outlast.adapters.make_agents(short(name), worlds, **options)


def drawn(env: Any, tick: int) -> np.ndarray[Any, Any]:
    """Random actions, the same for two environments of one shape; of another type every tick."""
    actions = np.random.default_rng(tick).integers(0, env.single_action_space.nvec, (env.num_envs, 6))
    return actions.astype(["i1", "u2", "i8"][tick % 3])


def rows(values: Any) -> Any:
    """(worlds, agents, ...) as the sub-environments have it."""
    return np.concatenate(list(values))


def lives(env: Any, observations: Any) -> Any:
    """Who is alive, from observations: the place of the dead, and of who is absent, is 0."""
    place = columns_of(env.base_env.fields["own"], "x", "y")
    return (observations["own"][:, place] != 0).any(-1)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("mode", MODES)
def test_rows_are_those_of_the_batched_environment(name: str, mode: str) -> None:
    env, batch = make(name, autoreset_mode=mode), make_vec(short(name), WORLDS, autoreset_mode=mode)
    agents = batch.num_agents
    assert (env.num_envs, env.num_worlds, env.num_agents) == (WORLDS * agents, WORLDS, agents)
    assert env.observation_space == batch_space(env.single_observation_space, env.num_envs)
    assert env.action_space == batch_space(env.single_action_space, env.num_envs)
    seen, info = env.reset(seed=SEED)
    expected, _ = batch.reset(seed=SEED)
    assert equal(seen, {key: rows(values) for key, values in expected.items()})
    everybody = np.ones(env.num_envs, bool)
    there = {"present": rows(present(batch.worlds)), "_present": everybody} if counts_vary(batch.worlds) else {}
    assert same(info, {"alive": there.get("present", everybody), "_alive": everybody} | there)
    ends = deaths = 0
    for tick in range(STEPS):
        actions, sides = drawn(env, tick), side(batch.worlds)
        seen, reward, terminated, truncated, info = env.step(actions)
        expected, *outcome, batch_info = batch.step(actions.reshape(WORLDS, agents, 6))
        assert equal(seen, {key: rows(values) for key, values in expected.items()})
        assert env.observation_space.contains(seen)
        assert same(reward, rows(outcome[0]))
        assert same(terminated, np.repeat(outcome[1], agents))
        assert same(truncated, np.repeat(outcome[2], agents))
        assert same(info["alive"], lives(env, seen))
        assert info["_alive"].all()
        assert ("present" in info) == bool(there)
        if there:
            assert same(info["present"], rows(present(batch.worlds)))
        assert ("statistics" in info) == ("statistics" in batch_info)
        if "statistics" in batch_info:
            compare_ends(env, info, batch_info, sides)
        ends += int(terminated.sum())
        deaths += int((rows(present(batch.worlds)) & ~info["alive"]).sum())
        if mode == "Disabled" and (done := terminated | truncated).any():
            with pytest.raises(NotResetError, match=rf"sub-environments \[{done.argmax()}.* have ended.*reset_mask"):
                env.step(actions)
            seen, info = env.reset(options={"reset_mask": done})
            expected, _ = batch.reset(options={"reset_mask": done[::agents].copy()})
            assert equal(seen, {key: rows(values) for key, values in expected.items()})
            assert same(info["_alive"], done)
            assert same(info["alive"], done & rows(present(batch.worlds)))
    assert ends >= env.num_envs
    assert deaths > 0 or (name, mode) == ("ffa_3", "SameStep")  # of two, none is dead in a world that goes on


def compare_ends(env: Any, info: dict[str, Any], batch_info: dict[str, Any], sides: Any) -> None:
    """Infos of ended worlds: final observations, and of the statistics each sub-environment's own.

    sides: of each agent, (worlds, agents), -1 of who is absent, whose statistics are 0.
    """
    agents, absent = sides.shape[1], rows(sides < 0)
    assert same(info["_statistics"], np.repeat(batch_info["_statistics"], agents) & ~absent)
    for key, values in batch_info["statistics"].items():
        mine = info["statistics"][key]
        expected = rows(values) if key == "return" else np.repeat(values, agents)
        if key == "kills":
            expected = rows(np.take_along_axis(values, np.maximum(sides, 0), 1))
        assert same(mine, np.where(absent, 0, expected).astype(expected.dtype))
    assert ("final_obs" in info) == ("final_obs" in batch_info)
    if "final_obs" in batch_info:
        assert same(info["_final_obs"], np.repeat(batch_info["_final_obs"], agents))
        assert same(info["_final_info"], info["_final_obs"])
        assert same(info["final_info"]["statistics"], info["statistics"])
        assert same(info["final_info"]["_alive"], info["_final_obs"])
        for k, final in enumerate(info["final_obs"]):
            if not batch_info["_final_obs"][k // agents]:
                assert final is None
                continue
            assert same(final, {key: v[k % agents] for key, v in batch_info["final_obs"][k // agents].items()})
            assert info["final_info"]["alive"][k] == lives(env, {"own": final["own"][None]})[0]


def test_seeds_of_worlds_in_every_form() -> None:
    env = make(worlds=3)
    batch = make_vec(short("teams_3"), 3)
    given: list[tuple[Any, Any]] = [(SEED, SEED), (np.int64(SEED), SEED), ([5] * 4 + [6] * 4 + [7] * 4, [5, 6, 7])]
    for seed, same_seed in (*given, (np.repeat([5, 6, 7], 4).astype(np.uint8), [5, 6, 7])):
        observations, _ = env.reset(seed=seed)
        assert equal(observations, {key: rows(values) for key, values in batch.reset(seed=same_seed)[0].items()})
    assert equal(env.reset(seed=SEED)[0], make(worlds=3, seed=SEED).reset()[0])
    assert not equal(env.reset(seed=SEED)[0], env.reset()[0])
    env.reset(seed=8)
    assert env.np_random_seed == 8


RESETS: dict[str, tuple[dict[str, Any], str]] = {
    "agents disagree on the seed": ({"seed": [1] * 7 + [2]}, r"seed: sub-environments 4 to 7 .* world 1 .*1, 1, 1, 2"),
    "a seed a world": ({"seed": [1, 2]}, r"shape \(2,\).*each of 8 sub-environments"),
    "a text in a list": ({"seed": ["1"] * 8}, "seed = '1'"),
    "agents disagree on the reset": (
        {"options": {"reset_mask": np.arange(8) != 2}}, "reset_mask: sub-environments 0 to 3 .* world 0 and must agree",
    ),
    "a mask of worlds": ({"options": {"reset_mask": np.ones(2, bool)}}, r"shape \(8,\)"),
    "an empty mask": ({"options": {"reset_mask": np.zeros(8, bool)}}, "at least one True"),
    "a mask of numbers": ({"options": {"reset_mask": np.ones(8)}}, "must be bool"),
    "a typo": ({"options": {"reset_masc": np.ones(8, bool)}}, "reset_masc"),
}  # fmt: skip


@pytest.mark.parametrize("name", RESETS)
def test_resets_that_are_refused_change_nothing(name: str) -> None:
    env, reference = make(worlds=2, seed=SEED), make(worlds=2, seed=SEED)
    for each in (env, reference):
        each.reset()
    bad, message = RESETS[name]
    with pytest.raises(ValueError, match=message):
        env.reset(**bad)
    assert all(same(*pair) for pair in zip(env.step(drawn(env, 0)), reference.step(drawn(env, 0)), strict=True))


# ---- pictures


def test_without_a_render_mode_nothing_is_drawn() -> None:
    for env in (make(worlds=1), outlast.make_vec("ffa_3", 1)):
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None


@pytest.mark.parametrize("mode", MODES)
def test_record_episode_statistics_counts_what_info_reports(mode: str) -> None:
    page = (Path(__file__).parents[2] / "docs/libraries.md").read_text("utf-8")
    (since,) = re.findall(r'`"SameStep"`, `RecordEpisodeStatistics` counts right from Gymnasium 1\.(\d+) on', page)
    if mode == "SameStep" and tuple(map(int, gymnasium.__version__.split(".")[:2])) < (1, int(since)):
        pytest.skip("this gymnasium leaves out the first step of an episode, as the page says")
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


WRAPPER_OPTIONS: dict[str, tuple[Any, ...]] = {
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
    "make_agents": partial(outlast.adapters.make_agents, "ffa_1", 2),
    "make_vec": partial(make_vec, "ffa_1", 2),
    "gymnasium.make_vec": partial(gymnasium.make_vec, "outlast/FreeForAll1-v1", num_envs=2),
}
SUMMING = {"NormalizeReward", "RecordEpisodeStatistics"}  # of one reward a world; in make_vec every agent has its own


def tried(module: Any, make_env: Callable[[], Any]) -> tuple[set[str], dict[str, str]]:
    """Gymnasium's wrappers around an environment that is played: names of those that worked, errors of the others."""
    worked, refused = set(), {}
    for name, wrapper in wrappers_of(module).items():
        try:
            env = wrapper(make_env(), *WRAPPER_OPTIONS.get(name, ()))
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
    make_env = partial(VECTORS[maker], render_mode="rgb_array", autoreset_mode=mode)
    worked, refused = tried(wrappers, make_env)
    several = SUMMING if maker == "make_vec" else set()
    for name, error in refused.items():
        assert name in error or "autoreset_mode" in error or name in {"NormalizeObservation", *several}
    assert {"ClipReward", "DictInfoToList", *SUMMING} - several <= worked
    assert ("FlattenObservation" in worked) == (mode != "SameStep")


@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about modes of rendering
def test_wrappers_of_single_environments_work_or_say_why_not() -> None:
    make_env = partial(gymnasium.make, "outlast/FreeForAll1-v1", render_mode="rgb_array")
    worked, refused = tried(gymnasium.wrappers, make_env)
    for name, error in refused.items():
        assert re.search(f"{name}|Box|TimeLimit|observation space must have the shape", error)
    assert {"FlattenObservation", "FrameStackObservation", "RecordEpisodeStatistics", "TimeLimit"} <= worked
