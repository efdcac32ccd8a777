"""Every agent of every world as a sub-environment: for learners whose agents share one policy."""

from typing import Any

from gymnasium.vector import AutoresetMode

from ..core.validation import Array, check_choice, check_count
from ..rendering.modes import RENDER_MODES
from ..scenarios.scenario import Scenario
from .per_agent import Face
from .rows import face_core


class SurvivalAgentVectorEnv(Face):
    """`num_worlds` worlds as a gymnasium VectorEnv with a sub-environment for each agent: num_envs = worlds * agents.

    Sub-environment w * agents + i is agent i of world w. Observations: dict of float32 (num_envs, ...). Actions:
    integers (num_envs, actions). Rewards: float32 (num_envs,). Terminated, truncated: bool (num_envs,), those of the
    agent's world: as in the paper's training, the dead stay until their world ends.

    info["alive"], bool (num_envs,), with its mask info["_alive"]: whether the agent of this observation lives; a
    learner may drop the steps of those that did not. Whenever worlds end, info["statistics"] and info["_statistics"]
    tell of their episodes, each sub-environment of its own return and its own side's kills.

    seed: as in reset, for the first episodes. copy=True: what comes out is the caller's. copy=False, the fast path:
    observations are read-only and overwritten by the next call. check_actions=False leaves out the range check.
    """

    def __init__(
        self,
        scenario: str | Scenario,
        num_worlds: int,
        *,
        seed: int | None = None,
        threads: int = 1,
        autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        check_actions: bool = True,
        render_mode: str | None = None,
    ) -> None:
        check_count("num_worlds", num_worlds, 1)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        core, mode = face_core(scenario, num_worlds, autoreset, seed=seed, threads=threads, check_actions=False)
        self.num_agents = core.num_agents
        super().__init__(
            core, slice(0, None), autoreset=mode, copy=copy, render_mode=render_mode, check_actions=check_actions
        )

    def _joint(self, rows: Array) -> Array:
        return rows.reshape(self.num_worlds, self.num_agents, -1)

    def _report(self) -> dict[str, Any]:
        return {"statistics": self._own(self.over), "_statistics": self._spread(self.over)}


def make_agents(scenario: str | Scenario, num_worlds: int, **options: Any) -> SurvivalAgentVectorEnv:
    """All agents of `num_worlds` worlds of a variant or scenario, as a gymnasium VectorEnv of single agents.

    >>> env = outlast.make_agents("teams_3", 1024, seed=0)  # 4096 sub-environments

    options: seed, threads, autoreset, copy, check_actions, render_mode; see SurvivalAgentVectorEnv. Raises as make_vec.
    """
    return SurvivalAgentVectorEnv(scenario, num_worlds, **options)
