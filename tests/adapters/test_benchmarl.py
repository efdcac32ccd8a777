"""BenchMARL: its algorithms train in outlast's worlds, vectorised, and write what marl-eval reads."""

import json
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import outlast
from tests.conftest import few_by_day
from tests.helpers.execution_modes import ALL, COUNTS, LEVELS, short

pytest.importorskip("benchmarl", reason="BenchMARL is not installed: pip install 'outlast[benchmarl]'")
import torch
from torchrl.envs.utils import ExplorationType, set_exploration_type

from outlast.envs.adapters.benchmarl import OutlastTask, task

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "benchmarl_mappo.py"
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.usefixtures("one_torch_thread")]
BATCH = 512
SMALL: dict[str, Any] = {
    **dict.fromkeys(("on_policy_n_envs_per_worker", "off_policy_n_envs_per_worker"), 4),
    **dict.fromkeys(("on_policy_collected_frames_per_batch", "off_policy_collected_frames_per_batch"), BATCH),
    "on_policy_minibatch_size": 64,
    "off_policy_n_optimizer_steps": 2,
    "off_policy_train_batch_size": 64,
    "evaluation_interval": BATCH,
    "evaluation_episodes": 2,
}


@pytest.fixture(scope="module")
def example() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(EXAMPLE)))


ALGORITHMS = few_by_day(["mappo", "ippo", "qmix", "vdn", "maddpg", "masac"], ("mappo", "maddpg"))


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_algorithms_train(example: SimpleNamespace, algorithm: str, tmp_path: Path) -> None:
    """Networks change, returns are finite, and its file for marl-eval has every evaluation."""
    game = short("teams_2")
    actions = "continuous" if algorithm in example.CONTINUOUS else "joint"
    run = example.experiment(task(game, actions=actions), algorithm, 2 * BATCH, tmp_path, **SMALL)
    before = [value.clone() for value in run.policy.parameters()]
    run.run()
    assert not all(map(torch.equal, before, run.policy.parameters()))
    (file,) = tmp_path.rglob("*.json")
    assert list(json.loads(file.read_text())["outlast"][game.name]) == [algorithm]
    frames, values = example.returns(tmp_path)
    assert frames.tolist() == [BATCH, 2 * BATCH]
    assert [len(each) for each in values] == [2, 2]
    assert np.isfinite(values).all()


def test_ensemble_of_sides(example: SimpleNamespace, tmp_path: Path) -> None:
    run = example.experiment(task("teams_2"), "mappo", BATCH, tmp_path, **SMALL)
    assert {group: len(names) for group, names in run.group_map.items()} == {"team_0": 2, "team_1": 2}
    run.close()


@pytest.mark.parametrize("name", ["ffa_3", "teams_3+bounty", *LEVELS])
def test_specs(name: str) -> None:
    own = task(short(name) if name in LEVELS else name, groups="all" if name in (COUNTS, ALL) else "sides")
    env = own.get_env_fun(3, continuous_actions=False, seed=0, device="cpu")()
    seen = env.reset()
    for group in env.group_map:
        for kind, spec in (("observation", own.observation_spec(env)), ("action_mask", own.action_mask_spec(env))):
            assert tuple(spec[group, kind].shape) == tuple(seen[group, kind].shape[1:])
    assert tuple(own.state_spec(env)["state"].shape) == tuple(seen["state"].shape[1:])
    assert own.group_map(env) == env.group_map
    assert own.supports_discrete_actions()
    assert not own.supports_continuous_actions()


def test_a_task_has_discrete_actions_or_continuous_ones() -> None:
    own = task("teams_2", actions="continuous")
    env = own.get_env_fun(3, continuous_actions=True, seed=0, device="cpu")()
    assert (own.supports_continuous_actions(), own.supports_discrete_actions()) == (True, False)
    assert own.action_mask_spec(env) is None
    assert own.action_spec(env)["team_0", "action"].shape == (2, 6)
    assert "action_mask" not in env.reset()["team_0"]


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"seed": 4}, "seed = 4 of a task: take seed= of BenchMARL's Experiment; leave it out"),
        ({"device": "cpu"}, "device = 'cpu' of a task: take sampling_device"),
        ({"num_worlds": 4}, "num_worlds = 4 of a task: take on_policy_n_envs_per_worker"),
        ({"actions": "multi"}, "actions = 'multi' of a task: BenchMARL's algorithms take joint actions"),
    ],
)
def test_what_benchmarl_sets_by_itself_is_refused(config: dict[str, Any], message: str) -> None:
    for make in (lambda: task("teams_2", **config), lambda: OutlastTask.TEAMS_2.get_task(config=config)):
        with pytest.raises(ValueError, match=message):
            make()


@pytest.mark.parametrize("stray", [0, 1])
def test_evaluation_plays_other_worlds_than_training(example: SimpleNamespace, stray: int, tmp_path: Path) -> None:
    """Also where it is seeded anew before each evaluation, and if somebody else asked the task for environments."""
    own = task("teams_2")
    for _ in range(stray):
        own.get_env_fun(4, continuous_actions=False, seed=7, device="cpu")().close()
    run = example.experiment(own, "mappo", BATCH, tmp_path, seed=7, **SMALL | {"evaluation_episodes": 4})
    plain = outlast.adapters.make_torchrl("teams_2", 4, groups="sides", scaled=True, seed=7)
    first, training = plain.reset()["state"], run.env_func()
    assert torch.equal(training.reset()["state"], first)
    evaluated = run.test_env.reset()["state"]
    run.test_env.set_seed(7)
    assert torch.equal(run.test_env.reset()["state"], evaluated)
    assert not any(torch.equal(one, two) for one in evaluated for two in first)
    run.close()


def test_ticks_of_an_evaluation() -> None:
    for config, ticks in (({"max_episode_steps": 30}, 30), ({}, 10_000)):
        for own in (task("teams_2", actions="joint", **config), OutlastTask.TEAMS_2.get_task(config=config)):
            env = own.get_env_fun(2, continuous_actions=False, seed=0, device="cpu")()
            assert own.max_steps(env) == ticks
            env.close()


def test_every_variant_is_a_task() -> None:
    assert [each.name.lower() for each in OutlastTask] == list(outlast.VARIANTS)
    assert OutlastTask.FFA_1.get_task().name == "FFA_1"
    with pytest.raises(outlast.errors.ScenarioError, match="there is no variant 'ffa_9'"):
        task("ffa_9")


def test_the_benchmark_s_agent_plays_as_it_was_trained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without BenchMARL: a saved network chooses what BenchMARL's does in the same worlds."""
    monkeypatch.setenv("AGENTS_FOLDER", str(tmp_path))
    monkeypatch.syspath_prepend(EXAMPLE.parent)
    agents, trained = runpy.run_path(str(EXAMPLE.with_name("benchmark_agents.py"))), []
    import benchmarl_mappo

    small = benchmarl_mappo.experiment

    def experiment(*arguments: Any, **changes: Any) -> Any:
        trained.append(small(*arguments, **SMALL | changes))
        return trained[-1]

    monkeypatch.setattr(benchmarl_mappo, "experiment", experiment)
    agents["train_mappo"]("teams_2", 0, 8 * BATCH, tmp_path)
    (newest,) = tmp_path.glob("mappo-teams_2-0-*.npz")
    with np.load(newest) as file:
        layers = dict(file)
    layers |= {key: layer * 1e5 for key, layer in layers.items() if key.startswith("4.")}  # draws the likeliest
    np.savez(newest, **layers)
    own = outlast.adapters.make_torchrl("teams_2", 16, seed=3, scaled=True)
    env = outlast.make_vec("teams_2", 16, seed=3)
    policy, act = trained[0].algorithm.get_policy_for_loss("agents"), agents["mappo"](env, 0)
    table, (observations, _) = own.reset(), env.reset()
    for _ in range(20):
        actions = act(observations)
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            table = policy(table)
        chosen = np.stack(np.unravel_index(table["agents", "action"].numpy(), env.action_sizes), -1)
        assert np.array_equal(chosen, actions)
        table, (observations, *_) = own.step(table)["next"], env.step(actions)
