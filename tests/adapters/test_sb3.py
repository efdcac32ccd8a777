"""Stable-Baselines3: its conventions, and the same bits as the batched environment."""

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

import outlast
from outlast import make_vec, variant
from outlast.envs.adapters.gymnasium_single import SurvivalEnv
from outlast.envs.core.agents import alive, counts_vary, present, side
from outlast.envs.errors import ActionError, NotResetError, PendingError
from tests.conftest import scaled
from tests.helpers.execution_modes import EACH_LEVEL, HUNT, equal, short
from tests.helpers.goal import TICK, won_at_the_limit

vec = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs stable_baselines3: outlast[sb3]")
make_sb3 = outlast.make_sb3  # importing it above would fail before the line above can skip

WORLDS, AGENTS = 5, 4  # of SHORT
SHORT = short("teams_3").replace(ending_limit=22)  # ends both ways, early
LONE = variant("ffa_1").replace(
    n_agents=1, agents_health=10, safe_zone_radii=(8.0,), safe_zone_stand=1000, ending_limit=25
)
STEPS = scaled(150, least=60)


def draw(env: Any, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    return rng.integers(0, env.action_space.nvec, (env.num_envs, len(env.action_space.nvec)))


def agent(observations: dict[str, Any], *index: int) -> dict[str, Any]:
    return {key: values[index] for key, values in observations.items()}


def walk(env: Any, seed: int = 0) -> Any:
    """Reset, and yield (observations, rewards, dones, infos) of steps with random actions."""
    rng = np.random.default_rng(seed)
    env.reset()
    for _ in range(STEPS):
        yield env.step(draw(env, rng))


# ---- the conventions


class Lone(gymnasium.Env[dict[str, Any], Any]):
    """The only agent of a world, by hand, as an environment of which SB3 makes a DummyVecEnv.

    SB3 seeds environment w with seed + w; this one is the world w of the seed itself.
    """

    def __init__(self, w: int) -> None:
        self.w, self.world = w, make_vec(LONE, 1, autoreset_mode="Disabled", copy=True, first_world=w)
        boxes = {key: (box.low[0], box.high[0]) for key, box in self.world.single_observation_space.items()}
        self.observation_space = spaces.Dict({key: spaces.Box(*ends, dtype=np.float32) for key, ends in boxes.items()})
        self.action_space = spaces.MultiDiscrete(self.world.action_sizes)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[dict[str, Any], dict[str, Any]]:
        return agent(self.world.reset(seed=None if seed is None else seed - self.w)[0], 0, 0), {"alive": 1}

    def step(self, action: Any) -> tuple[dict[str, Any], Any, bool, bool, dict[str, Any]]:
        observations, reward, terminated, truncated, _ = self.world.step(action[None, None])
        return agent(observations, 0, 0), reward[0, 0], bool(terminated[0]), bool(truncated[0]), {}


def test_it_does_what_sb3_makes_of_single_environments() -> None:
    """Beside a DummyVecEnv of worlds with one agent: resets, ends, seeds, types and keys, bit by bit."""
    env, dummy = make_sb3(LONE, 6), vec.DummyVecEnv([partial(Lone, w) for w in range(6)])
    assert env.observation_space == dummy.observation_space
    assert env.action_space == dummy.action_space
    assert env.seed(11) == [seed - w for w, seed in enumerate(dummy.seed(11))]
    rng, ends = np.random.default_rng(0), []
    for _ in range(2):
        assert equal(env.reset(), dummy.reset())
        assert env.reset_infos == dummy.reset_infos
        for _ in range(STEPS // 2):
            actions = draw(env, rng)
            observations, rewards, dones, infos = env.step(actions)
            expected, *outcome, expected_infos = dummy.step(actions)
            assert equal(observations, expected)
            for mine, theirs in zip((rewards, dones), outcome, strict=True):
                assert (mine.dtype, mine.shape, mine.tolist()) == (theirs.dtype, theirs.shape, theirs.tolist())
            for info, expected_info in zip(infos, expected_infos, strict=True):
                assert info.keys() - expected_info.keys() <= {"alive", "statistics", *info.get("statistics", ())}
                assert info["TimeLimit.truncated"] is expected_info["TimeLimit.truncated"]
                if "terminal_observation" in expected_info:
                    assert equal(info["terminal_observation"], expected_info["terminal_observation"])
                    ends.append(info["TimeLimit.truncated"])
            assert env.reset_infos == dummy.reset_infos
    assert {True, False} == set(ends)


@pytest.mark.parametrize("name", ["ffa_3", HUNT, *EACH_LEVEL])
@pytest.mark.filterwarnings("ignore:Your observation .* has an unconventional shape")
def test_sb3s_own_checker_finds_nothing(name: str) -> None:
    """In the environment of one agent; but that rows of entities are no vectors, which MultiInputPolicy flattens."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(SurvivalEnv(short(name), learner=1, render_mode="rgb_array"))


@pytest.mark.parametrize("name", ["ffa_1", "ffa_3", "teams_3", HUNT, *EACH_LEVEL])
def test_spaces_are_those_of_one_agent(name: str) -> None:
    env, batch = make_sb3(short(name), 3, seed=0), make_vec(short(name), 3)
    assert env.num_envs == 3 * batch.num_agents
    assert env.action_space.nvec.tolist() == [3, 3, 3, 2, 2, 2]
    for key, box in batch.single_observation_space.items():
        mine = env.observation_space[key]
        assert (mine.shape, mine.dtype) == (box.shape[1:], np.float32)
        assert (mine.low == box.low).all()
        assert (mine.high == box.high).all()
    observations = env.reset()
    for i in range(env.num_envs):
        assert env.observation_space.contains(agent(observations, i))


@pytest.mark.parametrize("name", ["teams_3", HUNT, *EACH_LEVEL])
def test_it_is_the_batched_environment(name: str) -> None:
    """Beside SAME_STEP with the same seeds and actions; agent i of world w is w * agents + i. Who is absent is dead."""
    scenario = short(name).replace(ending_limit=22)
    env, batch = make_sb3(scenario, WORLDS, seed=3), make_vec(scenario, WORLDS, autoreset_mode="SameStep")
    assert equal(env.reset(), {key: np.concatenate(rows) for key, rows in batch.reset(seed=3)[0].items()})
    rng, ended, cut = np.random.default_rng(0), 0, 0
    for _ in range(STEPS):
        actions, sides = draw(env, rng), side(batch.worlds)
        observations, rewards, dones, infos = env.step(actions)
        expected, reward, terminated, truncated, info = batch.step(actions.reshape(WORLDS, AGENTS, 6))
        assert equal(observations, {key: np.concatenate(rows) for key, rows in expected.items()})
        assert rewards.tolist() == reward.ravel().tolist()
        assert dones.tolist() == np.repeat(terminated | truncated, AGENTS).tolist()
        for i in np.flatnonzero(dones):
            w, k = divmod(int(i), AGENTS)
            assert equal(infos[i]["terminal_observation"], agent(info["final_obs"][w], k))
            assert infos[i]["TimeLimit.truncated"] is bool(truncated[w])
            own = {key: values[w] for key, values in info["statistics"].items()}
            own |= {"return": own["return"][k], "kills": own["kills"][sides[w, k]]}
            there = sides[w] >= 0
            assert infos[i].get("statistics") == (own if there[k] else None)
            assert all(type(value) in (int, float) for value in infos[i].get("statistics", {}).values())
            dead = own["deaths_melee"] + own["deaths_zone"]
            assert dead == there.sum() - sum(infos[o]["alive"] for o in range(w * AGENTS, (w + 1) * AGENTS))
        living, existing = alive(batch.worlds).ravel(), present(batch.worlds).ravel()
        for i in np.flatnonzero(~dones):
            expected_info = {"present": int(existing[i])} if counts_vary(batch.worlds) else {}
            assert infos[i] == {"alive": int(living[i]), "TimeLimit.truncated": False} | expected_info
        ended, cut = ended + terminated.sum(), cut + truncated.sum()
    assert min(ended, cut) > 0


def test_what_is_won_in_the_last_tick_of_the_limit_is_not_cut_off() -> None:
    """Stable-Baselines3 would bootstrap from the observation at the end."""
    env = make_sb3(won_at_the_limit(), 2, seed=0)
    env.reset()
    for _ in range(TICK - 1):
        assert not env.step(np.ones((env.num_envs, 6), int))[2].any()
    _, _, dones, infos = env.step(np.ones((env.num_envs, 6), int))
    assert dones.all()
    assert not any(info["TimeLimit.truncated"] for info in infos)


def test_nothing_that_is_handed_out_changes_later() -> None:
    """New observations, rewards and infos in every step, and none shared by two agents."""
    env = make_sb3(SHORT, WORLDS, seed=0)
    before = env.reset()
    kept = {key: values.copy() for key, values in before.items()}
    last: list[dict[str, Any]] = []
    for observations, rewards, dones, infos in walk(env):
        assert equal(before, kept)
        assert len({id(info) for info in infos + last}) == 2 * env.num_envs - (0 if last else env.num_envs)
        assert not any(np.shares_memory(values, env.base_env.observe()[key]) for key, values in observations.items())
        if dones.sum() > 1:
            one, other = (infos[i]["terminal_observation"] for i in np.flatnonzero(dones)[:2])
            assert not any(np.shares_memory(one[key], other[key]) for key in one)
        if last:
            assert ["mark" in info for info in env.reset_infos] == (~dones).tolist()
        for info in env.reset_infos:
            info["mark"] = 1
        rewards[:] = np.nan
        before, last = observations, infos
        kept = {key: values.copy() for key, values in before.items()}
    assert equal(before, kept)


# ---- seeds


def test_worlds_are_keyed_by_seed_and_number_at_the_next_reset() -> None:
    env = make_sb3("ffa_1", 3, seed=8)
    built = env.reset()
    assert env.seed(8) == [8] * 6
    following, *_ = env.step(np.tile([2, 1, 1, 0, 0, 0], (6, 1)))  # not yet
    moved = np.hypot(*(following["own"] - built["own"])[:, 2:4].T)
    assert ((moved > 0) & (moved < 1)).all()
    assert equal(env.reset(), built)
    for w in range(3):
        alone, _ = make_vec("ffa_1", 1, seed=8, first_world=w).reset()
        assert all(np.array_equal(alone[key][0], built[key][2 * w : 2 * w + 2]) for key in built)
    second = env.reset()  # a seed is used once
    assert not equal(second, built)
    batch = make_vec("ffa_1", 3)
    batch.reset(seed=8)
    assert equal(second, {key: np.concatenate(rows) for key, rows in batch.reset()[0].items()})


def test_no_seed_is_a_new_one() -> None:
    """Whatever numpy's own random state is."""
    drawn = []
    for _ in range(2):
        np.random.seed(0)  # noqa: NPY002
        env = make_sb3("ffa_1", 2)
        drawn += [env.reset()["own"].tobytes(), env.seed()[0], env.reset()["own"].tobytes()]
    assert len(set(drawn)) == 6


@pytest.mark.parametrize("seed", [-1, True, 1.5, "7", 2**64])
def test_a_bad_seed_is_refused(seed: Any) -> None:
    env = make_sb3("ffa_1", 2, seed=1)
    with pytest.raises(ValueError, match="0 to 2\\*\\*64 - 1"):
        env.seed(seed)
    assert equal(env.reset(), make_sb3("ffa_1", 2, seed=1).reset())


# ---- actions


def test_actions_are_those_of_step_async() -> None:
    """Whatever becomes of the array until step_wait; any integers will do."""
    env, other = make_sb3("ffa_1", 2, seed=0), make_sb3("ffa_1", 2, seed=0)
    env.reset()
    other.reset()
    actions = np.tile(np.array([2, 0, 1, 0, 1, 0], np.int8), (4, 1))
    env.step_async(actions)
    expected, *_ = other.step(actions.tolist())
    actions[:] = 0
    assert equal(env.step_wait()[0], expected)


def test_step_async_and_step_wait_take_turns() -> None:
    env, other = make_sb3("ffa_1", 2, seed=0), make_sb3("ffa_1", 2, seed=0)
    actions = np.tile([2, 1, 1, 0, 0, 0], (4, 1))
    env.step_async(actions)
    with pytest.raises(NotResetError, match="reset them"):
        env.step_wait()
    env.reset()
    other.reset()
    with pytest.raises(PendingError, match="without step_async"):
        env.step_wait()
    env.step_async(actions)
    with pytest.raises(PendingError, match="call step_wait"):
        env.step_async(actions)
    assert equal(env.step_wait()[0], other.step(actions)[0])
    env.step_async(actions)
    assert equal(env.reset(), other.reset())  # drops it
    assert equal(env.step(actions)[0], other.step(actions)[0])


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((2, 2, 6), int), r"shape \(2, 2, 6\): \(num_envs, actions\) = \(4, 6\)"),
        ([[0] * 6] * 3 + [[0]], r"\(num_envs, actions\) = \(4, 6\)"),
        (np.zeros((4, 6)), "float64: integers"),
        (np.tile([0, 0, 0, 0, 0, 2], (4, 1)), r"action 5 \(give\) of sub-environment 0 is 2: 0 to 1"),
    ],
)
def test_bad_actions_change_nothing(actions: Any, message: str) -> None:
    env, other = make_sb3("ffa_1", 2, seed=0), make_sb3("ffa_1", 2, seed=0)
    env.reset()
    other.reset()
    with pytest.raises(ActionError, match=message):
        env.step(actions)
    good = np.tile([2, 1, 1, 0, 0, 0], (4, 1))
    assert equal(env.step(good)[0], other.step(good)[0])
