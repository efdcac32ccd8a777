"""A vector environment in which every agent of every world is a sub-environment: for agents that share one policy."""

from typing import Any, Unpack

from gymnasium.vector import AutoresetMode

from ..core.agents import present
from ..core.spaces import statistics
from ..core.validation import Array
from ..core.vector_env import world_options
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords
from ..scenarios.scenario import Scenario
from .per_agent import PerAgentVectorEnv, requested


class SurvivalAgentVectorEnv(PerAgentVectorEnv):
    """All agents of `num_worlds` worlds as a gymnasium VectorEnv; made by `outlast.adapters.make_agents`.

    ## Description
    Sub-environment w * num_agents + i is agent i of world w; num_envs = num_worlds * num_agents.

    ## Action Space
    MultiDiscrete (num_envs, actions), in the paper [3, 3, 3, 2, 2, 2]: ahead, left and turn (0, 1, 2 for -1, 0,
    +1), attack, use, give. With actions="joint" Discrete, (num_envs,), 0 to 215, with "continuous" Box(-1, 1), float32
    (num_envs, actions). What the dead do is ignored.

    ## Observation Space
    Dict of float32 (num_envs, ...), by the keys that the scenario's mechanics declare; with observations="flat" a
    single Box, float32 (num_envs, base_env.flat_size), whose columns are called base_env.flat_names.

    ## Rewards
    float32 (num_envs,), each agent's own.

    ## Starting State
    World w of seed s is keyed by (s, w): it is world w of `outlast.make_vec` with that seed.

    ## Episode End
    terminated and truncated, bool (num_envs,), are those of the agent's world. As in the paper's training, the dead
    stay until their world ends: this is dead="keep" of the adapters that offer a choice.

    ## Info
    info["alive"], bool (num_envs,), with its mask info["_alive"]: whether the agent of this observation is alive; a
    learner may drop the steps of dead agents. When worlds end, info["statistics"] describes their episodes, (num_envs,)
    by key: each agent's own "return", its side's "kills", its world's "length", ...; its mask is info["_statistics"].

    If the number of agents varies, info["present"], bool (num_envs,), is whether the episode has the agent. An absent
    agent is not alive, has observations and rewards of 0, and no statistics; its sub-environment ends with its world.

    ## Version History
    v1: the rules of the paper's runs.
    """

    def _report(self, done: Array) -> dict[str, Any]:
        found, there = statistics(self.base_env.worlds, done), self._rows(present(self.base_env.worlds))
        return {"statistics": self._statistics(found), "_statistics": self._spread(done) & there}


@checks_keywords
def make_agents(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    seed: int | None = None,
    threads: int = 1,
    max_episode_steps: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    copy: bool = True,
    check_actions: bool = True,
    render_mode: str | None = None,
    actions: str = "multi",
    observations: str = "dict",
    scaled: bool = False,
    action_masks: bool = False,
    **numbers: Unpack[Numbers],
) -> SurvivalAgentVectorEnv:
    """Make a gymnasium VectorEnv whose sub-environments are all agents of `num_worlds` worlds.

    >>> env = outlast.adapters.make_agents("teams_3", 1024, seed=0, melee_damage=20)  # 4096 sub-environments

    Args:
        scenario: A Scenario or the name of one: "ffa_3", "mygame.py:arena".
        num_worlds: How many worlds to step together.
        seed: Seed of the first episodes, as in `reset`. None: an unpredictable seed.
        threads: Threads among which a step divides the worlds, with the same results.
        max_episode_steps: Ticks after which a world is truncated; it sets the scenario's ending_limit.
        autoreset_mode: When a world that ended begins its next episode: NEXT_STEP, SAME_STEP or DISABLED of
            gymnasium.vector.AutoresetMode, or their values, such as "NextStep".
        copy: Whether to return observations in new arrays; if not, which is faster, they are read-only views, and the
            next call overwrites them, and any tensors that share their memory, such as those from jax.device_put.
        check_actions: Whether to check the range of actions; if not, an action out of range has an unspecified effect,
            but does no harm.
        render_mode: "rgb_array", "ansi" or None.
        actions: "multi", an integer for each action; "joint", one integer for all actions of an agent, 0 to 215 in the
            paper; or "continuous", a float from -1 to 1 for each action, whose values share that range equally.
        observations: "dict", arrays by key, or "flat", one array that joins those of all keys.
        scaled: Whether to divide observations, and `state`, by the scales of their fields to about -1 to 1, with angles
            wrapped; columns without bounds are clipped to -10 to 10.
        action_masks: Whether to put "action_mask" into info, int8: what `action_masks` returns.
        numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    Raises:
        ScenarioError, NumberError, ValueError: As for `outlast.make_vec`.
    """
    asked = requested(make_agents, scenario, numbers, max_episode_steps)
    return SurvivalAgentVectorEnv(asked, num_worlds, **world_options(locals()))
