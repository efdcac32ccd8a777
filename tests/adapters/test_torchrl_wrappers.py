"""TorchRL's own wrappers of PettingZoo and Gymnasium around worlds in which agents die one by one."""

import warnings
from typing import Any

import gymnasium
import pytest

import outlast
from tests.helpers.execution_modes import ALL, COUNTS, LEVELS, MAZE, ROLES, short

pytest.importorskip("pettingzoo", reason="PettingZoo is not installed: pip install 'outlast[pettingzoo]'")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("torchrl", reason="TorchRL is not installed: pip install torchrl")
    import torch
    from torchrl.envs import GymEnv, GymWrapper, SerialEnv
    from torchrl.envs.libs.pettingzoo import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

pytestmark = pytest.mark.filterwarnings("ignore")  # TorchRL's own, also about the version of PettingZoo
SEED = 3
SHORT: dict[str, Any] = {"agents_health": 10, "safe_zone_radii": (6.0,), "safe_zone_stand": 1000}  # outside, they die
LIMIT = 60
FIXED = ("ffa_3", "teams_3", ROLES, MAZE)  # all episodes have all agents
GAMES = pytest.mark.parametrize(
    ("name", "dead"),  # TorchRL needs the same agents in every reset
    [*((name, dead) for name in FIXED for dead in ("end", "keep")), (COUNTS, "keep"), (ALL, "keep")],
)


def world(name: str, dead: str) -> Any:
    """With four agents; one of LEVELS with up to four."""
    counts = {} if name in LEVELS else {"n_agents": 4}
    return outlast.adapters.parallel_env(short(name), dead=dead, max_cycles=LIMIT, **SHORT, **counts)


def wrapped(name: str, dead: str) -> Any:
    env = PettingZooWrapper(world(name, dead), use_mask=True, done_on_any=False)
    env.set_seed(SEED)
    torch.manual_seed(SEED)
    return env


@GAMES
def test_specs(name: str, dead: str) -> None:
    env = wrapped(name, dead)
    check_env_specs(env)
    assert env.group_map == {"agent": ["agent_0", "agent_1", "agent_2", "agent_3"]}
    assert env.action_spec_unbatched["agent", "action"].nvec.tolist() == [[3, 3, 3, 2, 2, 2]] * 4


def test_worlds_move_to_a_device_and_stand_side_by_side() -> None:
    """Both rebuild specs from keyword arguments, which an observation called "self" does not survive."""
    assert wrapped("ffa_3", "keep").to("cpu").device == torch.device("cpu")
    several = SerialEnv(2, lambda: wrapped("ffa_3", "keep"))
    assert several.rollout(3)["agent", "observation", "own"].shape[:3] == (2, 3, 4)
    several.close()


KEPT = {"dead": "keep", **SHORT}
VECTORS = {
    "make_agents": lambda mode: outlast.adapters.make_agents("teams_3", 2, seed=SEED, autoreset_mode=mode, **SHORT),
    "make_agents of levels": lambda mode: outlast.adapters.make_agents(short(ALL), 2, seed=SEED, autoreset_mode=mode),
    "gymnasium.make_vec": lambda mode: gymnasium.make_vec("outlast/Teams3-v1", 2, autoreset_mode=mode, **KEPT),
}


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
@pytest.mark.parametrize("name", VECTORS)
def test_many_worlds_as_a_gymnasium_vector(name: str, mode: str) -> None:
    """TorchRL's own check, and a rollout with ends; TorchRL takes no NEXT_STEP."""
    env = GymWrapper(VECTORS[name](mode))
    check_env_specs(env)
    env.set_seed(SEED)
    torch.manual_seed(SEED)  # of the actions
    rollout = env.rollout(200, break_when_any_done=False)
    assert rollout.batch_size[0] == env.batch_size[0] == (2 if name == "gymnasium.make_vec" else 8)
    assert rollout["next", "done"].any()
    with pytest.raises(RuntimeError, match="NEXT_STEP"):
        GymWrapper(VECTORS[name]("NextStep"))


def test_environments_are_made_by_id() -> None:
    """GymEnv passes a keyword of Atari's games on trial; what the caller misspells stays an error with a hint."""
    env = GymEnv("outlast/FreeForAll1-v1", observations="flat", max_episode_steps=20)
    check_env_specs(env)
    assert env.rollout(30).batch_size == (20,)
    skipping = GymEnv("outlast/FreeForAll1-v1", frame_skip=4, observations="flat", max_episode_steps=20)
    assert skipping.rollout(30).batch_size == (5,)
    with pytest.raises(TypeError, match="ffa_1 has no number 'melee_damge'; did you mean melee_damage"):
        GymEnv("outlast/FreeForAll1-v1", melee_damge=20)
