"""SuperSuit: its vector environments and wrappers over PettingZoo environments, beside plain worlds stepped by hand."""

import copy
import warnings
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock
from tests.helpers.execution_modes import HUNT, LEVELS, short

pytest.importorskip("pettingzoo", reason="PettingZoo is not installed: pip install 'outlast[pettingzoo]'")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    supersuit = pytest.importorskip("supersuit", reason="SuperSuit is not installed: pip install supersuit")

pytestmark = pytest.mark.filterwarnings("ignore")  # SuperSuit's own
SIZES, COPIES, SEED = (3, 3, 3, 2, 2, 2), 2, 7
STEPS = 65  # enough for every world of short() to end


def world(name: str, **options: Any) -> Any:
    """With all agents there until the end: SuperSuit's vectors refuse agents that leave."""
    return outlast.adapters.parallel_env(short(name), dead="keep", **options)


def stacked(dicts: list[dict[str, Any]], key: str | None = None) -> list[Any]:
    """The values of all agents of all worlds in one row; of observations, one key."""
    return [value if key is None else value[key].tolist() for each in dicts for value in each.values()]


@pytest.mark.parametrize(
    ("name", "cpus"), [("ffa_3", 0), ("teams_3", 0), ("teams_3", COPIES), (HUNT, 0), *((name, 0) for name in LEVELS)]
)
def test_a_vector_of_worlds(name: str, cpus: int) -> None:
    """Rows are the agents of every copy in order, seeded one apart; an episode's end starts the next one at once."""
    agents = supersuit.pettingzoo_env_to_vec_env_v1(world(name))
    env = supersuit.concat_vec_envs_v1(agents, COPIES, num_cpus=cpus, base_class="gymnasium")
    plain = [world(name) for _ in range(COPIES)]
    assert env.num_envs == COPIES * len(plain[0].possible_agents)
    observations, _ = env.reset(seed=SEED)
    expected = [each.reset(seed=SEED + i)[0] for i, each in enumerate(plain)]
    rng, ends = np.random.default_rng(0), 0
    for _ in range(STEPS):
        for key, space in env.observation_space.items():
            assert (observations[key].dtype, observations[key].shape[1:]) == (np.float32, space.shape)
            assert observations[key].tolist() == stacked(expected, key)
        actions = rng.integers(0, SIZES, (env.num_envs, 6))
        observations, *outcome, _ = env.step(actions)
        expected, *signals = zip(*(step(each, rows) for each, rows in zip(plain, np.split(actions, COPIES))))
        for mine, theirs in zip(outcome, signals[:3], strict=True):
            assert mine.tolist() == stacked(theirs)
        for i, each in enumerate(plain):
            if not each.agents:
                expected = [*expected[:i], each.reset()[0], *expected[i + 1 :]]
                ends += 1
    env.close()
    assert ends >= COPIES


def step(env: Any, rows: Any) -> Any:
    return env.step(dict(zip(env.possible_agents, rows, strict=True)))


def test_a_seed_repeats_how_many_frames_are_skipped() -> None:
    """The reset's and the constructor's, in the generator that copies go on with; worlds draw nothing from it."""
    env = world("ffa_3", seed=SEED)
    first = copy.deepcopy(env).np_random.integers(0, 1000, 5).tolist()
    env.reset()
    assert env.np_random.integers(0, 1000, 5).tolist() == first
    env.reset(seed=SEED)
    assert env.np_random.integers(0, 1000, 5).tolist() == first
    skipping = supersuit.frame_skip_v0(world("ffa_3"), (1, 6))
    ticks = []
    for _ in range(2):
        skipping.reset(seed=SEED)
        step(skipping, np.ones((2, 6), int))
        ticks.append(skipping.unwrapped.base_env.worlds[Clock].tick[0, 0])
    assert ticks[0] == ticks[1]
