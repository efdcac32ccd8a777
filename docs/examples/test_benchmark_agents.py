"""Tests of benchmark_agents.py. Run it: python -m pytest docs/examples/test_benchmark_agents.py."""

import itertools
from pathlib import Path

import numba
import numpy as np
import pytest

import outlast

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from benchmark_agents import LAYERS, mappo, train_sb3

from outlast.training.benchmark.agents import Made
from outlast.training.benchmark.matches import play
from outlast.training.benchmark.tasks import TaskGame

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="worlds without compiled systems take minutes")
EXAMPLE = Path(__file__).with_name("benchmark_agents.py")
SHORT = outlast.variant("ffa_2").replace(safe_zone_damage=20, safe_zone_stand=20, safe_zone_shrink=10)


@pytest.mark.parametrize("name", ["striker", "sb3"])
def test_agents_play(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "sb3":
        pytest.importorskip("stable_baselines3")
        train_sb3("ffa_2-v1", seed=0, steps=1)  # steps are rounded up to one rollout
    game = TaskGame("trained", SHORT.titled_as(outlast.variant("ffa_2")), (), 0)
    found = play(game, [Made(name, f"{EXAMPLE}:{name}", 0)], 4, tmp_path / "self.rec")
    assert found["games"] == 4


@pytest.mark.parametrize("wanted", [(2, 0, 1, 1, 0, 0), (2, 0, 1, 0, 1, 0)])
def test_mappo_draws_actions_that_do_something(
    wanted: tuple[int, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A strike, where a network wants that above all; something else, where it wants to use what it does not have."""
    monkeypatch.chdir(tmp_path)
    env = outlast.make_vec("teams_2", 8, seed=0)
    observations, _ = env.reset()
    width = outlast.make_vec("teams_2", 1, observations="flat").single_observation_space.shape[-1]
    sizes = [width, 8, 8, int(np.prod(env.action_sizes))]
    weights = [np.zeros((more, less), np.float32) for less, more in itertools.pairwise(sizes)]
    biases = [np.zeros(size, np.float32) for size in sizes[1:]]
    biases[-1][np.ravel_multi_index(wanted, tuple(env.action_sizes))] = 100
    layers = [each for pair in zip(weights, biases, strict=True) for each in pair]
    np.savez("mappo-teams_2-0", **dict(zip(LAYERS, layers, strict=True)))
    actions = mappo(env, 0)(observations)
    assert (actions == wanted).all(-1).all() == (wanted[3] == 1)
    assert np.take_along_axis(env.action_masks(), actions + np.cumsum([0, *env.action_sizes[:-1]]), -1).all()
