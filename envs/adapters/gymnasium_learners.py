"""One agent of every world learns, the others follow a policy: the batch behind gymnasium.make_vec."""

from numbers import Integral
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.ecs import Clock

from ..core.validation import Array, check_choice, check_count
from ..core.vector_env import SurvivalVectorEnv
from ..rendering.modes import RENDER_MODES
from ..scenarios.scenario import Scenario
from .opponents import Opponents, Others, check_others
from .per_agent import Face
from .rows import face_core

DEAD = ("end", "keep")
HUMAN = "; for a window wrap 'rgb_array' in gymnasium.wrappers.vector.HumanRendering"


class SurvivalLearnerVectorEnv(Face):
    """`num_envs` worlds, in each of which one agent learns, as a gymnasium VectorEnv of single agents.

    Sub-environment w, seeded s, is bit for bit SurvivalEnv seeded s, in observations, rewards, ends and infos (which
    have a mask for each key). An int seed gives it seed + w, as Gymnasium's own vector environments do: seeds 0 and 1
    have all worlds but one in common. For independent samples take seeds that are num_envs or more apart.

    Observations: dict of float32 (num_envs, ...). Actions: integers (num_envs, actions). Rewards: float32 (num_envs,).
    Terminated, truncated: bool (num_envs,).

    variant: name or Scenario. learner: id of the agent that learns. others: what the other agents do, see
    opponents.Opponents. dead="end": the learner's death terminates its episode. dead="keep": it stays, with its
    rewards, until its world ends. max_episode_steps: truncates after so many steps, as gymnasium's TimeLimit does.
    copy=False, the fast path: observations are read-only and overwritten by the next call.
    """

    def __init__(
        self,
        num_envs: int,
        variant: str | Scenario = "ffa_3",
        *,
        learner: int = 0,
        others: Others = "random",
        dead: str = "end",
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
    ) -> None:
        check_count("num_envs", num_envs, 1)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES), HUMAN)
        check_choice("dead", dead, DEAD)
        check_others(others)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps, 1)
        core, mode = face_core(variant, num_envs, autoreset, threads=threads)
        self.learner, self.dead, self.max_episode_steps = _checked_learner(learner, core), dead, max_episode_steps
        seats = slice(self.learner, self.learner + 1)
        super().__init__(core, seats, autoreset=mode, copy=copy, render_mode=render_mode)
        self._opponents = Opponents(others, core, self.learner)

    def _seeds(self, seed: Any) -> Any:
        if isinstance(seed, int | np.integer) and not isinstance(seed, bool):
            return [int(seed) + w for w in range(self.num_worlds)]
        return super()._seeds(seed)  # what is no seed, the core refuses

    def _joint(self, rows: Array) -> Array:
        joint = np.empty((self.num_worlds, self.core.num_agents, rows.shape[1]), np.int64)
        joint[:, self.learner] = rows
        joint[:, self._opponents.seats] = self._opponents.actions()
        return joint

    def _ends(self, terminated: Array, truncated: Array) -> tuple[Array, Array]:
        if self.dead == "end":
            terminated |= ~self._alive()[:, 0]
        if self.max_episode_steps is not None:
            truncated |= self.core.worlds[Clock].tick[:, 0] >= self.max_episode_steps
        return terminated, truncated

    def _tell(self, where: Array) -> dict[str, Any]:
        """Whether the learner lives, and the statistics of the episode so far."""
        told = super()._tell(where)
        for key, values in self._own(where).items():
            told |= {key: values, f"_{key}": where.copy()}
        return told


def _checked_learner(learner: Any, core: SurvivalVectorEnv) -> int:
    if isinstance(learner, bool) or not isinstance(learner, Integral) or not 0 <= int(learner) < core.num_agents:
        last, name = core.num_agents - 1, core.scenario.name
        raise ValueError(f"learner = {learner!r}: an agent of {name} is needed, an integer from 0 to {last}")
    return int(learner)
