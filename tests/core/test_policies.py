"""Policies without training: they act within the rules, and the scripted one is clearly better than chance."""

import numpy as np
import pytest

import outlast
from outlast.envs.errors import UsageError
from outlast.envs.rollout.policies import POLICIES, random_policy, scripted_policy
from tests.conftest import COMPILED, few_by_day, scaled

WORLDS, STEPS = scaled(256, 2), scaled(700, 5)


@pytest.mark.parametrize("name", sorted(POLICIES))
@pytest.mark.parametrize("given", [{}, "ffa_1"])
def test_what_is_no_environment_is_refused(name, given):
    with pytest.raises(UsageError, match=r"as in scripted_policy\(env\), not for (dict|str): give"):
        POLICIES[name](given, 0)


@pytest.mark.skipif(not COMPILED, reason="statistics need episodes by the hundred")
@pytest.mark.parametrize("variant", few_by_day(outlast.VARIANTS, ("ffa_2", "teams_4")))
def test_the_script_beats_chance(variant):
    """Side 0 follows the script, the others act at random, in the same worlds for the same number of steps."""
    env = outlast.make_vec(variant, WORLDS, seed=1, check_actions=False)
    chance, script = random_policy(env), scripted_policy(env)
    observations, _ = env.reset()
    first, total = env.num_agents // 2, np.zeros((WORLDS, env.num_agents))
    for _ in range(STEPS):
        actions = chance(observations)
        actions[:, :first] = script(observations)[:, :first]
        observations, reward, _, _, _ = env.step(actions)
        total += reward
    lead = total[:, :first].mean(1) - total[:, first:].mean(1)
    assert lead.mean() > 5 * lead.std() / np.sqrt(WORLDS)
