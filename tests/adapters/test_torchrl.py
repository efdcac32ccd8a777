"""make_torchrl: a batched environment of TorchRL's, against make_vec and TorchRL's own checks."""

import itertools
import runpy
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from tests.conftest import COMPILED, few_by_day, scaled
from tests.helpers.execution_modes import ALL, COUNTS, LEVELS, MAZE, ROLES, short

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install 'outlast[torchrl]'")
    import torch
    from torchrl.envs import ParallelEnv, SerialEnv
    from torchrl.envs.utils import check_env_specs

pytestmark = pytest.mark.filterwarnings("ignore")  # TorchRL's own
SEED, WORLDS = 3, 4
QUICK: dict[str, Any] = {"agents_health": 10, "max_episode_steps": scaled(25, least=6), "seed": SEED}
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "torchrl_mappo.py"
OWN = {"one": ["agent_2", "agent_0"], "two": ["agent_3", "agent_1"]}  # in an order of its own


def make(name: str = "teams_3", worlds: int = WORLDS, **options: Any) -> Any:
    counts = {} if name in LEVELS else {"n_agents": 4}
    return outlast.make_torchrl(short(name), worlds, **(QUICK | counts | options))


@pytest.mark.parametrize("groups", ["all", "sides", OWN], ids=["all", "sides", "own"])
@pytest.mark.parametrize(
    ("actions", "observations", "scale"), [*itertools.product(["joint", "multi"], ["flat", "dict"], [False, True])]
)
def test_specs(actions: str, observations: str, scale: bool, groups: Any) -> None:
    """TorchRL's own check of every combination."""
    env = make(actions=actions, observations=observations, scaled=scale, groups=groups)
    check_env_specs(env)
    assert env.batch_size == (WORLDS,)
    assert sorted(name for own in env.group_map.values() for name in own) == [f"agent_{i}" for i in range(4)]
    env.close()


@pytest.mark.parametrize("name", ["ffa_3", ROLES, MAZE, COUNTS, ALL])
def test_specs_of_other_games(name: str) -> None:
    check_env_specs(make(name))


@pytest.mark.parametrize("groups", ["all", OWN], ids=["all", "own"])
def test_a_rollout_is_that_of_plain_worlds(groups: Any) -> None:
    """Bit for bit, through ends and partial resets: observations, rewards, ends, states and masks."""
    env, steps = make(groups=groups, melee_damage=10), scaled(120, least=20)
    torch.manual_seed(SEED)
    rollout = env.rollout(steps, break_when_any_done=False)
    plain = outlast.make_vec(
        short("teams_3"), WORLDS, seed=SEED, autoreset_mode="Disabled", observations="flat", actions="joint",
        agents_health=10, melee_damage=10, ending_limit=QUICK["max_episode_steps"], n_agents=4,
    )  # fmt: skip
    seen, info = plain.reset()
    ends = np.zeros(WORLDS, int)
    for t in range(steps):
        now, after = rollout[:, t], rollout[:, t]["next"]
        actions = np.zeros((WORLDS, 4), int)
        for group, names in env.group_map.items():
            members = [int(name[-1]) for name in names]
            assert np.array_equal(now[group, "observation"], seen[:, members])
            assert np.array_equal(now[group, "mask"], info["alive"][:, members])
            assert np.array_equal(now[group, "action_mask"], plain.action_masks()[:, members])
            actions[:, members] = now[group, "action"]
        assert np.array_equal(now["state"], plain.state())
        seen, rewards, terminated, truncated, info = plain.step(actions)
        for group, names in env.group_map.items():
            members = [int(name[-1]) for name in names]
            assert np.array_equal(after[group, "observation"], seen[:, members])
            assert np.array_equal(after[group, "reward"][..., 0], rewards[:, members])
        assert np.array_equal(after["terminated"][:, 0], terminated)
        assert np.array_equal(after["truncated"][:, 0], truncated)
        assert np.array_equal(after["done"][:, 0], terminated | truncated)
        if (done := terminated | truncated).any():
            ends += done
            seen, info = plain.reset(options={"reset_mask": done})
    assert (ends > 0).all() or not COMPILED
    assert len(set(ends)) > 1 or not COMPILED  # or resets were never partial
    assert env.statistics["length"].shape == (int(done.sum()) or env.statistics["length"].shape[0],)


def test_groups_of_sides_and_roles() -> None:
    assert make(groups="sides").group_map == {"team_0": ["agent_0", "agent_1"], "team_1": ["agent_2", "agent_3"]}
    assert len(make("ffa_3", groups="sides").group_map) == 4
    roles = make(ROLES, groups="sides")
    assert sum(map(len, roles.group_map.values())) == roles.vector_env.num_agents


def test_seeds() -> None:
    """The seed of the call, and that of set_seed; every reset goes on to the next episode."""
    first, again, other = make(), make(), make(seed=None)
    other.set_seed(SEED)
    starts = [env.reset()["agents", "observation"] for env in (first, again, other)]
    assert torch.equal(starts[0], starts[1])
    assert torch.equal(starts[0], starts[2])
    assert not torch.equal(starts[0], first.reset()["agents", "observation"])
    with pytest.raises(ValueError, match="seed = -1"):
        first.set_seed(-1)


def test_tensors_of_a_step_stay_as_they_are() -> None:
    env = make()
    one = env.rollout(1)
    kept = one["next", "agents", "observation"].clone()
    env.rollout(5)
    assert torch.equal(one["next", "agents", "observation"], kept)


def test_masked_actions_are_not_drawn() -> None:
    """TorchRL's transform draws among what the mask leaves."""
    from torchrl.envs import ActionMask, TransformedEnv

    keys = {"action_key": ("agents", "action"), "mask_key": ("agents", "action_mask")}
    rollout = TransformedEnv(make(melee_cooldown=5), ActionMask(**keys)).rollout(scaled(40, least=5))
    allowed = rollout["agents", "action_mask"].gather(-1, rollout["agents", "action"][..., None])
    assert allowed.all()
    assert not rollout["agents", "action_mask"].all()


def test_it_moves_and_stands_beside_others() -> None:
    assert make().to("cpu").device == torch.device("cpu")
    several = SerialEnv(2, make)
    assert several.rollout(3)["agents", "observation"].shape[:4] == (2, WORLDS, 3, 4)
    several.close()


@pytest.mark.nightly
def test_processes() -> None:
    several = ParallelEnv(2, make)
    assert several.rollout(3)["agents", "observation"].shape[:4] == (2, WORLDS, 3, 4)
    several.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"groups": "teams"}, "groups = 'teams': allowed are 'all', 'sides', 'roles', or names of agents by group"),
        ({"groups": {"a": ["agent_0"]}}, "each of agent_0, agent_1, agent_2, agent_3 has to be in one of them, once"),
        ({"groups": "roles"}, "this scenario has no roles, or draws who has them"),
        ({"name": COUNTS, "groups": "sides"}, "the number of agents varies, so groups would, too; take 'all'"),
        ({"actions": "discrete"}, "actions = 'discrete': allowed are 'multi', 'joint'"),
        ({"dead": "end"}, "dead = 'end': 'keep' is needed"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**options)


@pytest.mark.parametrize("name", few_by_day(["ffa_1", "teams_3", ALL], ("ffa_1",)))
def test_mappo_updates(name: str, one_torch_thread: None) -> None:
    """The example: returns are those of whole episodes, and the same seed learns the same."""
    train = runpy.run_path(str(EXAMPLE))["train"]
    frames = 4 * scaled(64, least=40) * WORLDS
    one, again = (train(short(name), frames, SEED, WORLDS, frames // WORLDS // 4) for _ in range(2))
    assert one == again
    assert 1 <= len(one) <= 4
    assert np.isfinite(one).all()


@pytest.mark.nightly
def test_mappo_learns(one_torch_thread: None) -> None:
    """The return, paid for each tick alive, against that of about the first 100,000 frames; it was 340 and 470."""
    returns = runpy.run_path(str(EXAMPLE))["train"]("ffa_1", 500_000, 0)
    assert np.mean(returns[-20:]) > np.mean(returns[5:25]) + 50
