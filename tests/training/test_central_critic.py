"""A critic that learns from the state of the whole world, which nobody needs to play."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.components import Body
from outlast.envs.core.global_state import GlobalState
from outlast.envs.rollout.memory import told

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast import load_policy  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.policies.rows import Observed  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs.resume import capture, restore  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
WORLDS, STEPS, AGENTS = 3, 32, 4
SHORT = variant("teams_2").replace(ending_limit=20)


def make(chosen: str = "fast", **changes: Any) -> Trainer:
    given = {"worlds": WORLDS, "rollout": WORLDS * STEPS, "critic": "state"}
    given |= {"settings": {"n_epochs": 1, "batch_size": 64, "target_kl": 0.0}}
    return Trainer(TrainingConfig(SHORT, chosen, **(given | changes)))


def observed(trainer: Trainer) -> Observed:
    return trainer.lane._seen(trainer.env.observe())


# ---- the state


@pytest.mark.parametrize("name", ["ffa_1", "ffa_3", "teams_3"])
def test_the_states_of_many_worlds_are_those_of_each(name: str) -> None:
    env = make_vec(name, 5, seed=1, copy=False)
    env.reset()
    overview = GlobalState(env.worlds)
    for _ in range(120):
        env.step(env.action_space.sample())
    states = overview(slice(None))
    assert states.dtype == np.float32
    assert states.shape == (5, *overview.space.shape)
    assert all(np.array_equal(states[w], overview(w)) for w in range(5))
    assert np.array_equal(states[1:3], overview(slice(1, 3)))


def test_the_state_of_pettingzoo_is_that_of_the_world() -> None:
    env, batch = outlast.parallel_env("teams_3", seed=4), make_vec("teams_3", 2, seed=4)
    env.reset(seed=4)
    batch.reset(seed=4)
    assert np.array_equal(env.state(), GlobalState(batch.worlds)(slice(None))[0])


@pytest.mark.parametrize("name", ["ffa_1", "ffa_3", "teams_3", "teams_3+steering"])
def test_scaled_states_are_about_minus_1_to_1(name: str) -> None:
    """But for the numbers of agents and teams, as in observations."""
    env = make_vec(name, 5, seed=1, copy=False)
    overview, found = GlobalState(env.worlds), []
    assert overview.scale.shape == overview.space.shape
    env.reset()
    for _ in range(200):
        env.step(env.action_space.sample())
        found.append(np.abs(overview(slice(None)) / overview.scale))
    most = np.max(found, axis=(0, 1))
    assert (most > 0.1).mean() > 0.5
    assert most.max() < 6
    assert (most > 2.5).mean() < 0.05


# ---- the critic


def test_agents_of_a_world_get_the_same_state() -> None:
    trainer = make()
    rollout = trainer.collect()
    states = rollout.seen.state.view(STEPS, WORLDS, AGENTS, -1)
    assert (states == states[:, :, :1]).all()
    assert (states[:, 0] != states[:, 1]).any()
    assert (states[0] != states[-1]).any()
    assert states.shape[3] == trainer.state
    part = torch.tensor([5, 0, 5])
    assert torch.equal(rollout.seen.select(part).state, rollout.seen.state[part])


@pytest.mark.parametrize(("chosen", "memory"), [("fast", 0), ("fast", 8), ("original", 0), ("paper", 8)])
def test_values_depend_on_what_an_agent_cannot_see_and_actions_do_not(chosen: str, memory: int) -> None:
    trainer, agents = make(chosen, memory=memory), WORLDS * AGENTS
    given = (torch.zeros(agents, memory), torch.ones(agents, dtype=torch.bool)) if memory else ()
    policy, found = trainer.policies[0], []
    for moved in (0.0, 1.0):
        trainer.env.worlds[Body].x[1, trainer.env.worlds.span("heal").start] += moved  # what is observed stays
        with torch.no_grad():
            found.append((*policy(observed(trainer), *given)[:2], policy.logs(observed(trainer), *given)[0]))
    (logs, values, alone), (other_logs, other_values, other_alone) = found
    assert torch.equal(logs, other_logs)
    assert torch.equal(alone, other_alone)
    assert torch.allclose(alone, logs, atol=1e-6)
    differ = (values != other_values).view(WORLDS, AGENTS)
    assert differ[1].all()
    assert not differ[[0, 2]].any()


def test_the_critic_learns_from_the_state_and_the_policy_does_not() -> None:
    trainer = make()
    policy = trainer.policies[0]
    before = {name: weight.clone() for name, weight in policy.state_dict().items()}
    trainer.update(trainer.collect())
    assert any(not torch.equal(before[name], policy.state_dict()[name]) for name in before if "overview" in name)
    logs, values, _ = policy(observed(trainer))
    assert torch.autograd.grad(values.sum(), policy.overview.weight, retain_graph=True)[0].abs().sum() > 0
    assert torch.autograd.grad(logs.sum(), policy.overview.weight, allow_unused=True) == (None,)


def test_a_policy_is_saved_goes_on_and_plays_without_the_state(tmp_path: Path) -> None:
    trainer, path = make(), tmp_path / "a.zip"
    trainer.update(trainer.collect())
    files = capture(trainer, trainer.config.header())
    checkpoint.write_checkpoint(path, files)
    other = make()
    restore(other, files)
    for _ in range(2):
        assert trainer.update(trainer.collect()) == other.update(other.collect())
    env = make_vec("teams_2", 2, seed=0)
    act, (observations, _) = told(load_policy(path), env), env.reset()
    assert act(observations).shape == (2, AGENTS, 6)
    opposed = make(opponents={str(path): 1.0, "past": 1.0}, snapshots=1)
    for _ in range(3):
        opposed.update(opposed.collect())
    assert {opposed.opponents.all[k].kind for k in opposed.lane.opponent} == {str(path), "past"}
    make(opponents={str(path): 1.0}, critic="own").collect()
    header = json.loads(files["run.json"])
    assert header["state"] == trainer.state
    for state, words in ((0, "does not hold"), (2**16, "too small for")):
        wrong = json.dumps(header | {"state": state}).encode()
        checkpoint.write_checkpoint(path, files | {"run.json": wrong})
        with pytest.raises(TrainingError, match=words):
            load_policy(path)


def test_another_critic_is_refused() -> None:
    with pytest.raises(TrainingError, match="critic = 'world': allowed are 'own', 'state'"):
        TrainingConfig(variant("ffa_2"), critic="world")
