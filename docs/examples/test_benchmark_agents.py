"""Tests of benchmark_agents.py. Run it: python -m pytest docs/examples/test_benchmark_agents.py."""

import itertools
from pathlib import Path

import numba
import numpy as np
import pytest

import outlast

pytest.importorskip("torch", reason="needs torch: outlast[train]")

import benchmark_agents
import cleanrl_ppo
import torch
from benchmark_agents import LAYERS, drawn, mappo, rows, saved, train_cleanrl

from outlast.training.arena.players import Contender
from outlast.training.benchmark.games import play
from outlast.training.benchmark.tasks import TaskGame

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="worlds without compiled systems take minutes")
EXAMPLE = Path(__file__).with_name("benchmark_agents.py")
SHORT = outlast.variant("ffa_2").replace(safe_zone_damage=20, safe_zone_stand=20, safe_zone_shrink=10)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of weights. Trainings are small."""
    monkeypatch.setenv("AGENTS_FOLDER", str(tmp_path))
    monkeypatch.delenv("AGENTS_STEPS", raising=False)
    monkeypatch.setattr(benchmark_agents, "AGENTS", 8)
    monkeypatch.setattr(benchmark_agents, "TICKS", 20)
    return tmp_path


@pytest.mark.parametrize("name", ["striker", "sb3", "cleanrl"])
def test_agents_play(name: str, folder: Path) -> None:
    if name == "sb3":
        pytest.importorskip("stable_baselines3")
    if name != "striker":
        getattr(benchmark_agents, f"train_{name}")("ffa_2", 0, 1, folder)  # steps are rounded up to one rollout
    game = TaskGame("trained", SHORT.titled_as(outlast.variant("ffa_2")), (), 0)
    found = play(game, [Contender(name, f"{EXAMPLE}:{name}", seed=0)], 4)
    assert sum(found.outcome[name] for name in ("won", "drawn", "lost")) == 4
    assert len(found.moves.foreign)  # its actions are kept, as nobody else can ask it


def test_weights_after_each_fifth(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The newest are played, or the newest of at most so many agent-steps."""
    train_cleanrl("teams_2", 3, 1_500, folder)
    assert {path.name for path in folder.iterdir()} == {f"cleanrl-teams_2-3-{320 * part}.npz" for part in range(1, 6)}
    assert "cleanrl-teams_2-3: 1,600 agent-steps, the last 320 at " in capsys.readouterr().out
    env = outlast.make_vec("teams_2", 1)
    assert saved("cleanrl", env, 3).stem.endswith("-1600")
    monkeypatch.setenv("AGENTS_STEPS", "700")
    assert saved("cleanrl", env, 3).stem.endswith("-640")
    with pytest.raises(FileNotFoundError, match=r"cleanrl-teams_2-1-\* of at most 700 agent-steps: there is none"):
        saved("cleanrl", env, 1)


def test_rows_are_those_of_training() -> None:
    """Also in worlds where other policies see what is hidden from cameras."""
    flat = outlast.adapters.make_agents("hide_small", 8, observations="flat", scaled=True)
    env, generator = outlast.make_vec("hide_small", 8, seed=1, cameras_mode="revealed"), np.random.default_rng(0)
    (wanted, _), (seen, _), row, hidden = flat.reset(seed=1), env.reset(), rows(env), 0
    for _ in range(60):
        np.testing.assert_array_equal(row(seen).reshape(wanted.shape), wanted)
        actions = generator.integers(env.action_sizes, size=(8, env.num_agents, len(env.action_sizes)))
        wanted, seen = flat.step(actions.reshape(flat.num_envs, -1))[0], env.step(actions)[0]
        hidden += seen["others"][seen["others_mask"] == 0].any()
    assert hidden


def test_actions_are_drawn_by_their_logits() -> None:
    odds = [np.array([0.5, 0.3, 0.2]), np.array([0.9, 0.1]), np.array([1.0])]
    logits = np.tile(np.log(np.concatenate(odds)), (100_000, 1, 1))
    actions = drawn(logits, np.array([3, 2, 1]), np.random.default_rng(0))
    for k, own in enumerate(odds):
        shares = np.bincount(actions[:, 0, k], minlength=len(own)) / len(actions)
        assert np.abs(shares - own).max() < 4 * np.sqrt(0.25 / len(actions))


@pytest.mark.parametrize("name", ["sb3", "cleanrl"])
def test_agents_play_as_they_were_trained(name: str, folder: Path) -> None:
    """With a last layer so sharp that the likeliest actions are drawn."""
    form = {"observations": "flat", "scaled": True, "action_masks": True}
    flat, env = outlast.adapters.make_agents("teams_3", 4, **form), outlast.make_vec("teams_3", 4, seed=1)
    sizes = env.action_sizes.tolist()
    if name == "sb3":
        ppo = pytest.importorskip("stable_baselines3").PPO
        learner = outlast.adapters.make_sb3("teams_3", 4, observations="flat", scaled=True)
        model = ppo("MlpPolicy", learner, seed=0, device="cpu")
        torch.nn.init.normal_(model.policy.action_net.weight, std=1e5)
        model.save(folder / "sb3-teams_3-0-1")
    else:
        agent = cleanrl_ppo.Agent(flat.single_observation_space.shape[0], sizes)
        torch.nn.init.normal_(agent.actor[-1].weight, std=1e5)
        layers = {key: array.numpy() for key, array in agent.actor.state_dict().items()}
        np.savez(folder / "cleanrl-teams_3-0-1", **layers)
    act = getattr(benchmark_agents, name)(env, 0)
    (row, info), (seen, _) = flat.reset(seed=1), env.reset()
    for _ in range(20):
        if name == "sb3":
            wanted, _ = model.predict(row, deterministic=True)
        else:
            wanted, *_ = agent.act(torch.from_numpy(row), torch.from_numpy(info["action_mask"]).bool())
        actions = act(seen)
        assert np.array_equal(actions.reshape(flat.num_envs, -1), wanted)
        row, *_, info = flat.step(np.asarray(wanted))
        seen = env.step(actions)[0]


@pytest.mark.parametrize("wanted", [(2, 0, 1, 1, 0, 0), (2, 0, 1, 0, 1, 0)])
def test_mappo_draws_actions_that_do_something(wanted: tuple[int, ...], folder: Path) -> None:
    """A strike, where a network wants that above all; something else, where it wants to use what it does not have."""
    env = outlast.make_vec("teams_2", 8, seed=0)
    observations, _ = env.reset()
    width = outlast.make_vec("teams_2", 1, observations="flat").single_observation_space.shape[-1]
    sizes = [width, 8, 8, int(np.prod(env.action_sizes))]
    weights = [np.zeros((more, less), np.float32) for less, more in itertools.pairwise(sizes)]
    biases = [np.zeros(size, np.float32) for size in sizes[1:]]
    biases[-1][np.ravel_multi_index(wanted, tuple(env.action_sizes))] = 100
    layers = [each for pair in zip(weights, biases, strict=True) for each in pair]
    np.savez(folder / "mappo-teams_2-0-1", **dict(zip(LAYERS, layers, strict=True)))
    actions = mappo(env, 0)(observations)
    assert (actions == wanted).all(-1).all() == (wanted[3] == 1)
    assert np.take_along_axis(env.action_masks(), actions + np.cumsum([0, *env.action_sizes[:-1]]), -1).all()
