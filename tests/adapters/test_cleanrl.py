"""CleanRL's manner: the single-file PPO of the documents learns, from every agent of every world."""

import math
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.helpers.execution_modes import EACH_LEVEL, LEVELS, short

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "cleanrl_ppo.py"
pytestmark = pytest.mark.usefixtures("one_torch_thread")
SMALL = {"num_worlds": 4, "num_steps": 64, "num_minibatches": 2, "update_epochs": 2}


@pytest.fixture(scope="module")
def ppo() -> SimpleNamespace:
    return SimpleNamespace(**runpy.run_path(str(EXAMPLE)))


@pytest.mark.parametrize("variant", ["duel", "teams_3", *EACH_LEVEL])
def test_updates(ppo: SimpleNamespace, variant: str) -> None:
    agents = 2 if variant == "duel" else 4
    game = short(variant) if variant in LEVELS else variant
    args = ppo.Args(game, total_timesteps=3 * 4 * agents * SMALL["num_steps"], **SMALL)
    agent, rows = ppo.train(args)
    assert rows.shape == (3, 4)
    assert np.isfinite(rows[:, 1:]).all()
    assert 0.99 * math.log(27) < rows[0, 3] < math.log(27 * 8)  # entropy: nearly uniform over what is not masked
    torch.manual_seed(args.seed)
    untrained = ppo.Agent(agent.actor[0].in_features, agent.sizes)
    changed = [not torch.equal(one, other) for one, other in zip(agent.parameters(), untrained.parameters())]
    assert len(changed) == 12
    assert all(changed)
    assert np.array_equal(ppo.train(args)[1], rows, equal_nan=True)


def test_what_is_cut_short_is_worth_what_the_critic_expects(ppo: SimpleNamespace) -> None:
    """Of the last observation, not of the first one of the next episode; agents that die or win get nothing more."""
    args = ppo.Args(gamma=0.5)
    last, following = np.full(3, None), np.zeros((3, 2), np.float32)
    last[:] = list(np.full((3, 2), 7, np.float32))
    ends = np.array([True, False, False]), np.array([False, True, False])
    info = {"alive": np.ones(3, bool), "final_obs": last, "action_mask": np.ones((3, 15), np.int8)}
    envs = SimpleNamespace(step=lambda actions: (following, np.ones(3, np.float32), *ends, info))
    critic = SimpleNamespace(value=lambda obs: obs.sum(1))
    this = SimpleNamespace(envs=envs, agent=critic, args=args, returns=[], see=lambda observations, info: None)
    reward, done = ppo.Rollouts.step(this, torch.zeros((3, 6), dtype=torch.int64))
    assert reward.tolist() == pytest.approx([1.0, 1.0 + 0.5 * 2 * 7, 1.0])
    assert done.tolist() == [True, True, False]


@pytest.mark.nightly
def test_it_learns(ppo: SimpleNamespace) -> None:
    _, rows = ppo.train(ppo.Args(total_timesteps=150_000))
    assert rows[-5:, 0].mean() > rows[0, 0] + 30


@pytest.mark.nightly
def test_the_command() -> None:
    options = ["--variant", "ffa_1", "--num-worlds", "2", "--num-steps", "4", "--total-timesteps", "16"]
    done = subprocess.run([sys.executable, str(EXAMPLE), *options], capture_output=True, text=True)
    assert (done.returncode, len(done.stdout.splitlines())) == (0, 1), done.stderr
