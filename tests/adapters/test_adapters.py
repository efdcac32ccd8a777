"""What holds for all environments of many worlds, whichever library they are made for: spaces, seeds, pictures."""

import re
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast.components import Body
from tests.adapters.test_puffer import pufferlib

WORLDS = 64
SAMPLES = 20


def learners(name: str, worlds: int, **options: Any) -> Any:
    return gymnasium.make_vec("outlast/FreeForAll-v1", num_envs=worlds, scenario=name, **options)


def sb3(name: str, worlds: int, **options: Any) -> Any:
    pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[sb3]")
    return outlast.make_sb3(name, worlds, **options)


def puffer(name: str, worlds: int, **options: Any) -> Any:
    if pufferlib is None:
        pytest.skip("needs PufferLib; what outlast.make_puffer raises says how")
    return outlast.make_puffer(name, worlds, **options)


BATCHED: dict[str, Callable[..., Any]] = {
    "make_vec": outlast.make_vec,
    "make_agents": outlast.make_agents,
    "gymnasium.make_vec": learners,
    "make_sb3": sb3,
    "make_puffer": puffer,
}


# ---- spaces


def sample(space: Any) -> bytes:
    drawn = space.sample()
    return b"".join(np.asarray(part).tobytes() for part in (drawn.values() if isinstance(drawn, dict) else [drawn]))


@pytest.mark.parametrize("kind", ["action_space", "observation_space"])
@pytest.mark.parametrize("name", BATCHED)
def test_samples_of_a_space_differ_and_its_seed_repeats_them(name: str, kind: str) -> None:
    """The space is asked for anew in every line, as in a user's loop."""
    env = BATCHED[name]("ffa_1", 3)
    for of in [kind] if name == "make_sb3" else [kind, f"single_{kind}"]:
        assert len({sample(getattr(env, of)) for _ in range(SAMPLES)}) > SAMPLES / 2  # two of 216 actions may be alike
        getattr(env, of).seed(7)
        first = [sample(getattr(env, of)) for _ in range(SAMPLES)]
        assert [sample(getattr(env, of)) for _ in range(SAMPLES)] != first
        getattr(env, of).seed(7)
        assert [sample(getattr(env, of)) for _ in range(SAMPLES)] == first
    env.close()


# ---- seeds


def starts(env: Any) -> set[bytes]:
    """Where all bodies of each world are."""
    body = getattr(env, "base_env", env).worlds[Body]
    return {x.tobytes() + y.tobytes() for x, y in zip(body.x, body.y, strict=True)}


def seeded(name: str, seed: int) -> Iterator[set[bytes]]:
    """The first worlds of a seed in all the ways in which it can be given."""
    env = BATCHED[name]("ffa_1", WORLDS)
    if name == "make_sb3":
        env.seed(seed)
        env.reset()
    else:
        env.reset(seed=seed)
    yield starts(env)
    env.close()
    if name != "gymnasium.make_vec":  # Gymnasium has no seed at the start
        env = BATCHED[name]("ffa_1", WORLDS, seed=seed)
        env.reset()
        yield starts(env)
        env.close()


@pytest.mark.parametrize("name", BATCHED)
def test_no_two_seeds_have_a_world_in_common(name: str) -> None:
    """But for gymnasium.make_vec, whose worlds are seeded as Gymnasium's own: seed + number."""
    batch = outlast.make_vec("ffa_1", WORLDS, seed=0)
    batch.reset()
    for zero, one in zip(seeded(name, 0), seeded(name, 1), strict=True):
        assert len(zero) == len(one) == WORLDS
        if name == "gymnasium.make_vec":
            assert len(zero & one) == WORLDS - 1
            assert not zero & next(seeded(name, WORLDS))
        else:
            assert zero == starts(batch)
            assert not zero & one


# ---- pictures

PAGE = (Path(__file__).parents[2] / "docs" / "libraries.md").read_text(encoding="utf-8")
RENDERS = {  # adapter -> what the page says of it: modes, and what render() returns
    adapter: (re.findall(r'"(\w+)"', modes), returns)
    for adapters, modes, returns in re.findall(r'^\| (`.+?) \| (`"rgb_array".*?) \| (.*) \|$', PAGE, re.MULTILINE)
    for adapter in re.findall(r"`([\w.]+)`", adapters)
}
NEEDS = {"make_sb3": "stable_baselines3", "make_puffer": "pufferlib", "parallel_env": "pettingzoo"}
NEEDS |= {"aec_env": "pettingzoo", "SurvivalMultiAgentEnv": "ray"}


def rendering(adapter: str, mode: str) -> Any:
    if adapter == "gymnasium.make":
        return gymnasium.make("outlast/FreeForAll1-v1", render_mode=mode)
    if adapter == "SurvivalMultiAgentEnv":
        return outlast.SurvivalMultiAgentEnv({"scenario": "ffa_1", "render_mode": mode})
    if adapter in ("parallel_env", "aec_env"):
        return getattr(outlast, adapter)("ffa_1", render_mode=mode)
    make = learners if adapter == "gymnasium.make_vec" else getattr(outlast, adapter)
    return make("ffa_1", 3, render_mode=mode)


@pytest.mark.parametrize("adapter", RENDERS)
@pytest.mark.parametrize("mode", ["rgb_array", "ansi", "human"])
@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about a mode that it knows to be missing
def test_adapters_render_what_the_page_says(adapter: str, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if find_spec(NEEDS.get(adapter, "numpy")) is None or (mode == "human" and find_spec("pygame") is None):
        pytest.skip("a library is missing")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    modes, returns = RENDERS[adapter]
    if mode not in modes:
        with pytest.raises(ValueError, match=mode):
            rendering(adapter, mode)
        return
    env = rendering(adapter, mode)
    env.reset()
    frames = env.render()
    if mode == "human":
        assert frames is None
    elif "for each environment" in returns:
        assert len(frames) == env.num_envs
        frames = frames[0]
    if mode == "rgb_array":
        assert (frames.dtype, frames.ndim, frames.shape[2]) == (np.uint8, 3, 3)
    elif mode == "ansi":
        assert isinstance(frames, str)
    env.close()


def test_the_page_describes_all_adapters() -> None:
    described = re.findall(r"^\| .* \| (`.+`) \| .* \|$", PAGE.split("## Seeds")[0], re.MULTILINE)
    adapters = {name.removeprefix("outlast.") for cell in described for name in re.findall(r"`([\w.]+)`", cell)}
    assert RENDERS.keys() == adapters - {"PettingZooWrapper"}
