"""One agent of every world learns, the others follow a policy: the vector environment behind gymnasium.make_vec."""

from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.ecs import Clock
from outlast.ecs.kernels.integers import is_whole

from ..core.spaces import alive, fewest_agents, statistics
from ..core.validation import Array, check_choice, check_count
from ..core.vector_env import world_options
from ..errors import ActionError
from ..rendering.rgb import RENDER_MODES
from ..rollout.lineup import Lineup, Others, entries_of
from ..scenarios.known_numbers import Numbers
from ..scenarios.scenario import Scenario
from .base import Info, check_dead, requested
from .gymnasium_agents import SurvivalAgentVectorEnv


class SurvivalLearnerVectorEnv(SurvivalAgentVectorEnv):
    """`num_envs` worlds, in each of which one agent learns; made by `gymnasium.make_vec`.

    >>> envs = gymnasium.make_vec("outlast/Teams3-v1", num_envs=64, others="scripted")

    A sub-environment with the seed s is bit-identical to a `SurvivalEnv` with the seed s, whose datasheet and arguments
    it has, in observations, rewards, ends and infos: arrays (num_envs, ...), and infos have a mask for each key.

    An int seed s gives sub-environment w the seed s + w, as in Gymnasium's own vector environments, so seeds 0 and 1
    have all worlds but one in common. For independent samples use seeds that are num_envs or more apart.

    Arguments beside those of `SurvivalEnv` are those of `outlast.make_vec`. max_episode_steps truncates as gymnasium's
    TimeLimit does. render_mode: None, "rgb_array" or "ansi".
    """

    _checks_all = True  # the others' actions are checked nowhere else

    def __init__(
        self,
        num_envs: int,
        scenario: str | Scenario = "ffa_3",
        *,
        learner: int = 0,
        others: Others = "random",
        dead: str = "end",
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        actions: str = "multi",
        observations: str = "dict",
        scaled: bool = False,
        action_masks: bool = False,
        **numbers: Unpack[Numbers],
    ) -> None:
        check_count("num_envs", num_envs, 1)
        window = "; for a window wrap 'rgb_array' in gymnasium.wrappers.vector.HumanRendering"
        check_choice("render_mode", render_mode, (None, *RENDER_MODES), window)
        entries = entries_of(others)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps, 1)
        self.learner, self.dead, self.max_episode_steps = learner, dead, max_episode_steps
        asked = requested(type(self).__init__, scenario, numbers)
        super().__init__(asked, num_envs, **world_options(locals()))
        check_dead(dead, self.base_env.worlds)
        self.base_env.stop_when(self._stops)
        self._others = Lineup(entries, self.base_env, self.learner)

    def _choose(self) -> slice:
        learner: Any = self.learner
        last, name = fewest_agents(self.base_env.worlds) - 1, self.base_env.scenario.name
        if not is_whole(learner, 0, last):
            where = " that every world has" if last < self.num_agents - 1 else ""
            raise ValueError(f"learner = {learner!r}: an agent of {name}{where} is needed, an integer from 0 to {last}")
        self.learner = int(learner)
        return slice(self.learner, self.learner + 1)

    def _seeds(self, seed: Any) -> Any:
        if is_whole(seed):
            return [int(seed) + w for w in range(self.num_worlds)]
        return super()._seeds(seed)

    def _play(self, rows: Array) -> Any:
        joint = np.empty((self.num_worlds, self.num_agents, rows.shape[1]), np.int64)
        joint[:, self.learner] = rows
        joint[:, self._others.agents] = self._others.actions()
        try:
            return self.base_env.step(joint)
        except ActionError as error:  # the learner's actions are already checked, so the others' are wrong
            raise ActionError(f"others: {error}") from None

    def _stops(self) -> tuple[Array, Array]:
        """Return which worlds end as their learner died, and which at the time limit, for `stop_when` of base_env."""
        worlds, nowhere = self.base_env.worlds, np.zeros(self.num_worlds, bool)
        late = nowhere if self.max_episode_steps is None else worlds[Clock].tick[:, 0] >= self.max_episode_steps
        return ~alive(worlds)[:, self.learner] if self.dead == "end" else nowhere, late

    def _report(self, done: Array) -> Info:
        return {}  # statistics are in every info

    def _info(self, where: Array) -> Info:
        """Return info about the worlds `where`: whether the learner is alive, and statistics of the episode so far."""
        info = super()._info(where)
        for key, values in self._statistics(statistics(self.base_env.worlds, where)).items():
            info |= {key: values, f"_{key}": where.copy()}
        return info
