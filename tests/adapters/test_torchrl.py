"""make_torchrl: a batched environment of TorchRL's, against make_vec and TorchRL's own checks."""

import contextlib
import runpy
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import Clock
from outlast.envs.errors import ActionError, FaultError, NotResetError
from tests.conftest import few_by_day
from tests.helpers.covering import covering
from tests.helpers.execution_modes import ALL, COUNTS, LEVELS, MAZE, ROLES, short

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install 'outlast[torchrl]'")
    import torch
    from tensordict import TensorDict
    from torchrl.envs import ParallelEnv, SerialEnv
    from torchrl.envs.utils import check_env_specs

pytestmark = pytest.mark.filterwarnings("ignore")  # TorchRL's own
SEED, WORLDS = 3, 4
QUICK: dict[str, Any] = {"agents_health": 10, "max_episode_steps": 25, "seed": SEED}
EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "torchrl_mappo.py"
OWN = {"one": ["agent_2", "agent_0"], "two": ["agent_3", "agent_1"]}  # in an order of its own


def make(name: str = "teams_3", worlds: int = WORLDS, **options: Any) -> Any:
    counts = {} if name in LEVELS else {"n_agents": 4}
    return outlast.adapters.make_torchrl(short(name), worlds, **(QUICK | counts | options))


FORMS = (["joint", "multi", "continuous"], ["flat", "dict"], [False, True], ["all", "sides", OWN])


@pytest.mark.parametrize(("actions", "observations", "scale", "groups"), covering(*FORMS))
def test_specs(actions: str, observations: str, scale: bool, groups: Any) -> None:
    env = make(actions=actions, observations=observations, scaled=scale, groups=groups)
    check_env_specs(env)
    assert env.batch_size == (WORLDS,)
    assert sorted(name for own in env.group_map.values() for name in own) == [f"agent_{i}" for i in range(4)]


@pytest.mark.parametrize("name", ["ffa_3", ROLES, MAZE, COUNTS, ALL])
def test_specs_of_other_games(name: str) -> None:
    check_env_specs(make(name))


@pytest.mark.parametrize("groups", ["all", OWN], ids=["all", "own"])
def test_a_rollout_is_that_of_plain_worlds(groups: Any) -> None:
    """Bit for bit, through ends and partial resets: observations, rewards, ends, states and masks."""
    env, steps = make(groups=groups, melee_damage=10), 120
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
    assert (ends > 0).all()
    assert len(set(ends)) > 1  # or resets were never partial
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
    assert torch.equal(make(seed=None).reset(seed=SEED)["state"], make().reset()["state"])
    for seed in (first.set_seed, lambda seed: first.reset(seed=seed)):
        with pytest.raises(ValueError, match="seed = -1"):
            seed(-1)
    with pytest.raises(TypeError, match=r"reset\(\) has no keyword sede: it takes seed"):
        first.reset(sede=3)


def played(plain: Any, env: Any, td: Any) -> tuple[Any, Any]:
    """A step with actions drawn anew, in both; what they observe after it."""
    td = env.rand_action(td)
    seen, *_ = plain.step(td["agents", "action"].numpy())
    return seen, env.step(td)["next"].exclude("_reset").clone()


def flat_worlds(seed: int) -> Any:
    form = {"observations": "flat", "actions": "joint", "autoreset_mode": "Disabled"}
    return outlast.make_vec("teams_3", WORLDS, seed=seed, ending_limit=50, **form)


@pytest.mark.parametrize("how", ["set_seed", "reset"])
def test_a_seed_in_mid_run_leaves_worlds_that_go_on_alone(how: str) -> None:
    """Those of the mask begin with it, the others go on bit for bit, and begin with it at their own next reset."""
    env = outlast.adapters.make_torchrl("teams_3", WORLDS, seed=1, max_episode_steps=50)
    old, new = map(flat_worlds, (1, 2))
    old.reset()
    torch.manual_seed(SEED)
    seen, td = played(old, env, env.reset())
    assert np.array_equal(td["agents", "observation"], seen)
    if how == "set_seed":
        env.set_seed(2)
    some = np.array([True, False, False, True])
    start, _ = new.reset()
    td["_reset"] = torch.from_numpy(some[:, None])
    td = env.reset(td, **({} if how == "set_seed" else {"seed": 2}))
    assert np.array_equal(td["agents", "observation"], np.where(some[:, None, None], start, seen))
    for _ in range(3):
        seen, td = played(old, env, td)
        assert np.array_equal(td["agents", "observation"][~some], seen[~some])
    middle = td["agents", "observation"].clone()
    for more in (np.array([True, True, False, False]), np.array([False, False, True, False])):
        td["_reset"] = torch.from_numpy(more[:, None])
        td = env.reset(td)
        middle[more & ~some] = torch.from_numpy(start[more & ~some])
        assert torch.equal(td["agents", "observation"][1:], middle[1:])
    second, _ = new.reset()
    assert np.array_equal(td["agents", "observation"][0], second[0])  # its seed was used up: the next episode


def test_worlds_that_are_not_reset_say_how_they_ended() -> None:
    env = make("ffa_1", agents_health=100, max_episode_steps=2)
    td = env.reset()
    for _ in range(2):
        td["agents", "action"] = torch.ones_like(env.full_action_spec["agents", "action"].rand())
        td = env.step(td)["next"]
    assert td["truncated"].all()
    assert not td["terminated"].any()
    some = torch.tensor([[True], [False], [True], [False]])
    after = env.reset(TensorDict({"_reset": some}, batch_size=[WORLDS]))
    assert torch.equal(after["truncated"], ~some)
    assert not after["terminated"].any()
    assert torch.equal(after["done"], ~some)


def test_worlds_that_a_step_leaves_out_stay() -> None:
    """As in rollouts until all have ended: each world is as in a rollout of its own, and then stays."""
    limits = outlast.variant("teams_2").vary(ending_limit=outlast.distributions.integers(3, 9))
    env, alone = (outlast.adapters.make_torchrl(limits, WORLDS, seed=SEED) for _ in range(2))
    td = env.rollout(20, break_when_all_done=True)
    lengths = env.vector_env.worlds[Clock].tick[:, 0].tolist()
    assert td.shape == (WORLDS, max(lengths))
    assert min(lengths) < max(lengths)
    assert len(env.statistics["length"]) == lengths.count(max(lengths))
    alone.reset()
    actions = td["agents", "action"]
    for tick in range(max(lengths)):
        going = torch.tensor([length > tick for length in lengths])
        found = alone.vector_env._step(actions[:, tick].numpy(), None, None if going.all() else going.numpy())
        observations, rewards, terminated, truncated, _ = found
        rows = td[:, tick]["next"]
        for w in torch.nonzero(going).ravel().tolist():
            np.testing.assert_array_equal(rows["agents", "observation"][w].numpy(), observations[w])
            np.testing.assert_array_equal(rows["agents", "reward"][w, :, 0].numpy(), rewards[w])
            assert (rows["terminated"][w].item(), rows["truncated"][w].item()) == (terminated[w], truncated[w])
    with pytest.raises(NotResetError, match="have ended"):
        alone.vector_env._step(actions[:, 0].numpy(), None, np.arange(WORLDS) == 0)
    for each in (env, alone):
        each.close()


def test_steps_of_some_worlds_are_recorded(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    env = make(worlds=6, agents_health=3, max_episode_steps=60)
    with caplog.at_level("INFO", "outlast.deaths"), outlast.record(env.vector_env, tmp_path / "a.rec"):
        env.rollout(60, break_when_all_done=True)
    with contextlib.closing(outlast.Replay(outlast.Recording.open(tmp_path / "a.rec"))) as replay:
        assert len([*replay.ticks()]) > 2
    logged = [record.getMessage() for record in caplog.records if record.name == "outlast.deaths"]
    assert len(logged) == len({*logged}) > 6
    td = env.reset()
    env.vector_env.worlds[Body].vx[1, 0] = np.nan
    for k in range(2):
        td["agents", "action"] = env.full_action_spec["agents", "action"].rand()
        td["_step"] = torch.arange(6) != (-1, 1)[k]
        with pytest.raises(FaultError, match="world 1") if k == 0 else contextlib.nullcontext():
            env.step(td.clone())


@pytest.mark.parametrize(
    ("form", "actions", "message"),
    [
        ("joint", torch.full((WORLDS, 4), 0.9), "actions of the group agents are float32: integers are needed"),
        ("joint", torch.ones(WORLDS, 4, 1, dtype=torch.int64), r"\(4, 4, 1\): \(worlds, n\) = \(4, 4\) is needed"),
        ("joint", torch.full((WORLDS, 4), 216), "is 216: 0 to 215 is allowed"),
        ("multi", torch.full((WORLDS, 4, 6), 2), "is 2: 0 to 1 is allowed"),
        ("continuous", torch.zeros(WORLDS, 4, 6, dtype=torch.int64), "are int64: floats are needed"),
        ("continuous", torch.full((WORLDS, 4, 6), 1.5), r"action 0 \(ahead\) of agent 0 of agents in world 0 is 1.5"),
    ],
)
def test_actions_that_cannot_be_are_refused(form: str, actions: Any, message: str) -> None:
    env = make(actions=form)
    td = env.reset()
    before = td["state"].clone()
    td["agents", "action"] = actions
    with pytest.raises(ActionError, match=message):
        env.step(td)
    assert np.array_equal(env.vector_env.state(), before)


def test_policies_of_continuous_actions_may_have_gradients() -> None:
    from tensordict.nn import TensorDictModule

    env = make(actions="continuous")
    net = torch.nn.Linear(env.observation_spec["agents", "observation"].shape[-1], 6)
    policy = TensorDictModule(
        lambda seen: torch.tanh(net(seen / 1000)), in_keys=[("agents", "observation")], out_keys=[("agents", "action")]
    )
    assert env.rollout(3, policy)["agents", "action"].requires_grad


@pytest.mark.parametrize("observations", ["flat", "dict"])
def test_defaults_of_torch_change_nothing(observations: str) -> None:
    reward = torch.float32
    try:
        torch.set_default_dtype(torch.float64)
        torch.set_default_device("meta")
        env = make(observations=observations)
        check_env_specs(env)
        rollout = env.rollout(3)
    finally:
        torch.set_default_dtype(torch.float32)
        torch.set_default_device(None)
    assert rollout["next", "agents", "reward"].dtype == env.full_reward_spec["agents", "reward"].dtype == reward
    assert rollout["state"].dtype == torch.float32
    assert rollout["state"].device == torch.device("cpu")


def test_tensors_of_a_step_stay_as_they_are() -> None:
    env = make()
    one = env.rollout(1)
    kept = one["next", "agents", "observation"].clone()
    env.rollout(5)
    assert torch.equal(one["next", "agents", "observation"], kept)


def test_masked_actions_are_not_drawn() -> None:
    from torchrl.envs import ActionMask, TransformedEnv

    keys = {"action_key": ("agents", "action"), "mask_key": ("agents", "action_mask")}
    rollout = TransformedEnv(make(melee_cooldown=5), ActionMask(**keys)).rollout(40)
    allowed = rollout["agents", "action_mask"].gather(-1, rollout["agents", "action"][..., None])
    assert allowed.all()
    assert not rollout["agents", "action_mask"].all()


@pytest.mark.parametrize("kind", [SerialEnv, pytest.param(ParallelEnv, marks=pytest.mark.nightly)])
def test_it_moves_and_stands_beside_others(kind: Any) -> None:
    assert make().to("cpu").device == torch.device("cpu")
    several = kind(2, make)
    assert several.rollout(3)["agents", "observation"].shape[:4] == (2, WORLDS, 3, 4)
    several.close()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"groups": "teams"}, "groups = 'teams': allowed are 'all', 'sides', 'roles', or names of agents by group"),
        ({"groups": {"a": ["agent_0"]}}, "each of agent_0, agent_1, agent_2, agent_3 has to be in one of them, once"),
        ({"groups": {"a": [f"agent_{i}" for i in range(4)], "b": []}}, "groups: 'b' has no agents; leave it out"),
        *[
            ({"groups": {name: [f"agent_{i}" for i in range(4)]}}, f"groups: a group cannot be called '{name}'; take a")
            for name in ("state", "done", "next", "reward", "action_mask", "terminated")
        ],
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
    one, again = (train(short(name), 2 * 64 * WORLDS, SEED, WORLDS) for _ in range(2))
    assert one == again
    assert 1 <= len(one) <= 2
    assert np.isfinite(one).all()


@pytest.mark.nightly
def test_mappo_learns(one_torch_thread: None) -> None:
    """The return, paid for each tick alive, against that of about the first 100,000 frames; it was 340 and 470."""
    returns = runpy.run_path(str(EXAMPLE))["train"]("ffa_1", 500_000, 0)
    assert np.mean(returns[-20:]) > np.mean(returns[5:25]) + 50
