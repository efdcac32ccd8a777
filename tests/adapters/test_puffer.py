"""PufferLib: beside PufferLib's own emulation, the batched environment, and under its backends."""

import runpy
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import unflatten

import outlast
from outlast.ecs import Entity
from tests.conftest import few_by_day
from tests.helpers.execution_modes import EACH_LEVEL, HUNT, equal, short

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    try:
        import pufferlib.emulation
        import pufferlib.vector
    except ImportError:
        pufferlib = None

needs_puffer = pytest.mark.skipif(pufferlib is None, reason="needs PufferLib: outlast[puffer]")
SIZES, SEED = (3, 3, 3, 2, 2, 2), 5
WORLDS, STEPS = 20, 150  # enough for every world of short() to end
LIMIT = 20  # ticks after which some worlds are truncated, and others have ended by their rule
ARRAYS = ("observations", "rewards", "terminals", "truncations", "masks")


def drawn(env: Any, tick: int) -> np.ndarray[Any, Any]:
    """Random actions, the same for two environments of one shape; of another type every tick."""
    actions = np.random.default_rng(tick).integers(0, SIZES, (env.num_agents, 6))
    return actions.astype(["i4", "u1", "i8"][tick % 3])


def alike(one: list[Any], other: list[Any]) -> bool:
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in zip(one, other, strict=True))


@needs_puffer
@pytest.mark.parametrize("name", ["ffa_3", "teams_3", HUNT, *EACH_LEVEL])
def test_it_is_the_batched_environment(name: str) -> None:
    """Beside SAME_STEP with the same seed: rows, ends, agents alive, and the statistics of episodes."""
    game = short(name).replace(ending_limit=LIMIT)
    env = outlast.adapters.make_puffer(game, WORLDS, seed=SEED)
    batch = outlast.make_vec(game, WORLDS, seed=SEED, autoreset_mode="SameStep")
    assert env.reset()[1] == []
    expected, _ = batch.reset()
    space = outlast.adapters.make_agents(short(name), 1).single_observation_space
    episodes = dead = cut = 0
    for tick in range(STEPS):
        for i in (0, env.num_agents - 1):
            row = unflatten(space, env.observations[i])
            assert equal(row, {key: values[divmod(i, batch.num_agents)] for key, values in expected.items()})
        assert alike([env.observations], [flat(batch)])
        assert env.masks.tolist() == (batch.worlds[Entity].alive[:, batch.worlds.span("agent")] == 1).ravel().tolist()
        dead += int((~env.masks).sum())
        actions = drawn(env, tick)
        *arrays, infos = env.step(actions)
        assert [array is getattr(env, key) for array, key in zip(arrays, ARRAYS)] == [True] * 4
        expected, reward, terminated, truncated, info = batch.step(actions.reshape(WORLDS, batch.num_agents, 6))
        ends = [np.repeat(each, batch.num_agents) for each in (terminated, truncated)]
        assert alike([env.rewards, env.terminals, env.truncations], [reward.ravel(), *ends])
        assert len(infos) == int("statistics" in info)
        if infos:
            done = info["_statistics"]
            there = info.get("statistics_present", {})
            last = infos[0].pop("final_obs", None)
            assert (last is not None) == truncated.any()
            if last is not None:
                assert alike([last], [rows_of(batch, info["final_obs"][truncated])])
                cut += len(last)
            assert infos[0] == {
                key: [x for rows in zip(values[done], there.get(key, values == values)[done]) for x in own(*rows)]
                for key, values in info["statistics"].items()
            }
            episodes += len(infos[0]["length"])
    assert episodes >= WORLDS
    assert cut > 0
    assert (dead > 0) == (name != "ffa_3")  # of two, the last one's world ends with the other's death


def own(values: Any, there: Any) -> list[Any]:
    """The entries that an episode has."""
    return [value for value, had in zip(np.atleast_1d(values).tolist(), np.atleast_1d(there), strict=True) if had]


def rows_of(batch: Any, last: Any) -> np.ndarray[Any, Any]:
    """The last observations of several worlds, a dict each, as flat rows of their agents."""
    parts = [np.concatenate([each[key].reshape(batch.num_agents, -1) for key in each], 1) for each in last]
    return np.concatenate(parts)


def flat(batch: Any) -> np.ndarray[Any, Any]:
    out = np.zeros((batch.num_worlds, batch.num_agents, batch.flat_size), np.float32)
    batch.observe(out=out)
    return out.reshape(-1, batch.flat_size)


@needs_puffer
@pytest.mark.parametrize("backend", few_by_day(["Serial", "Multiprocessing"], ("Serial",)))
def test_puffers_backends(backend: str) -> None:
    """Environments write into their parts of PufferLib's arrays: those of two environments with seeds one apart."""
    worlds = 3
    options = {"num_workers": 2, "overwork": True} if backend == "Multiprocessing" else {}
    game = short("ffa_3").replace(ending_limit=LIMIT)
    vector = pufferlib.vector.make(outlast.adapters.make_puffer, [game, worlds], num_envs=2, backend=backend, **options)
    alone = [outlast.adapters.make_puffer(game, worlds, seed=SEED + i) for i in range(2)]
    observations, _ = vector.reset(seed=SEED)
    expected = [np.concatenate([each.reset()[0] for each in alone])]
    episodes = cut = 0
    for tick in range(STEPS):
        assert alike([observations], expected[:1])
        actions = drawn(vector, tick).astype(np.int64)
        observations, *outcome, infos = vector.step(actions)
        mine = [each.step(rows) for each, rows in zip(alone, np.split(actions, 2))]
        expected = [np.concatenate(arrays) for arrays in list(zip(*mine))[:4]]
        of_each = [info for *_, infos_of_one in mine for info in infos_of_one]
        assert alike(outcome, expected[1:])
        last, own_last = ([info["final_obs"] for info in each if "final_obs" in info] for each in (infos, of_each))
        assert alike(last, own_last)
        assert sum(map(len, last)) == outcome[2].sum()
        cut += len(last)
        episodes += sum(len(info["length"]) for info in infos)
    vector.close()
    assert episodes >= 2 * worlds
    assert cut > 0


EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "puffer_ppo.py"


@needs_puffer
def test_the_example_values_last_observations_where_episodes_are_cut_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two environments, the second one without a truncation; agents that die or win get nothing more."""
    torch = pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    rollouts = runpy.run_path(str(EXAMPLE))["VectorRollouts"]
    size, ones, none = 2, np.ones(4, np.float32), np.zeros(4, bool)
    last = {"return": [], "final_obs": np.full((2, size), 7, np.float32)}
    ends = np.array([1, 0, 0, 0], bool), np.array([0, 1, 1, 0], bool)
    batch = np.zeros((4, size), np.float32), ones, *ends, None, [last, {"return": [3.0]}], None, ~none
    this = SimpleNamespace(envs=SimpleNamespace(recv=lambda: batch), args=SimpleNamespace(gamma=0.5), returns=[])
    this.agent = SimpleNamespace(value=lambda obs: obs.sum(1), sizes=list(SIZES))
    reward, done = rollouts.receive(this)
    assert reward.tolist() == [1, 1 + 0.5 * 7 * size, 1 + 0.5 * 7 * size, 1]
    assert done.tolist() == [True, True, True, False]
    assert ones.tolist() == [1] * 4  # PufferLib's own array
    assert isinstance(this.obs, torch.Tensor)


@needs_puffer
@pytest.mark.nightly
def test_the_example_learns() -> None:
    """Ticks that agents live, 200 at most, without masks."""
    done = subprocess.run([sys.executable, str(EXAMPLE)], capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    returns = [float(line.split("return ")[1].split(",")[0]) for line in done.stdout.splitlines()]
    assert np.mean(returns[-5:]) > np.mean(returns[:5]) + 50
