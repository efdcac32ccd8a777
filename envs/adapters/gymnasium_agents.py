"""A vector environment in which every agent of every world is a sub-environment: for agents that share one policy."""

from typing import Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode

from ..core.action_spaces import ActionSpace
from ..core.observations import each
from ..core.spaces import agent_statistics, present, statistics
from ..core.validation import Array, Seeds, as_array, check_flags, reset_mask
from ..core.validation import autoreset_mode as checked_mode
from ..core.vector_env import Actions, Arrays, BatchedSpaces, SurvivalVectorEnv, world_options
from ..errors import FaultError, NotResetError
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .base import Adapter, Info, requested


class SurvivalAgentVectorEnv(Adapter, BatchedSpaces):
    """All agents of `num_worlds` worlds as a gymnasium VectorEnv; made by `outlast.adapters.make_agents`.

    Sub-environment w * num_agents + i is agent i of world w, and num_envs = num_worlds * num_agents. Spaces, rewards
    and info are those of `outlast.SurvivalVectorEnv` with the axes of worlds and agents joined: (num_envs, ...).

    terminated and truncated, bool (num_envs,), are those of the agent's world. As in the paper's training, the dead
    stay until their world ends (dead="keep" of the adapters that offer a choice), and what they do is ignored:
    info["alive"], bool (num_envs,), is whether the agent of this observation is alive; a learner may drop the steps of
    dead agents. When worlds end, info["statistics"] describes their episodes, (num_envs,) by key: each agent's own
    "return", its side's "kills", its world's "length", ...; its mask is info["_statistics"].

    If the number of agents varies, info["present"], bool (num_envs,), is whether the episode has the agent. An absent
    agent has no statistics; its sub-environment ends with its world.

    base_env, a SurvivalVectorEnv without copies, ends episodes and resets worlds according to autoreset_mode. Under
    SAME_STEP, its own mode is NEXT_STEP, and the adapter keeps the last observations and then resets the worlds itself;
    only worlds that were set to a state in which they have ended wait for the next step.
    """

    _checks_all = False  # whether base_env checks the actions of all agents again

    def __init__(
        self,
        scenario: Scenario,
        num_worlds: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        check_actions: bool = True,
        actions: str = "multi",
        action_masks: bool = False,
        **options: Any,
    ) -> None:
        check_flags(copy=copy, check_actions=check_actions, action_masks=action_masks)
        self.autoreset_mode, self.copy, self.check_actions = checked_mode(autoreset_mode), copy, check_actions
        self._resets = self.autoreset_mode is AutoresetMode.SAME_STEP
        inner = AutoresetMode.NEXT_STEP if self._resets else self.autoreset_mode
        options |= {"autoreset_mode": inner, "copy": False, "check_actions": self._checks_all}
        self.base_env = SurvivalVectorEnv(scenario, num_worlds, **options)
        self.metadata = self.base_env.metadata | {"autoreset_mode": self.autoreset_mode}
        self.render_mode = self.base_env.render_mode
        self.num_worlds, self.num_agents = self.base_env.num_worlds, self.base_env.num_agents
        self._indices = self._choose()
        chosen = range(self.num_agents)[self._indices]
        self._each = len(chosen)
        self.num_envs = self.num_worlds * self._each
        self._actions, self._masked = ActionSpace(self.base_env.worlds, actions, action_masks), bool(action_masks)
        self.single_observation_space = self.base_env._reader.of_agent(chosen[0])
        self.single_action_space = self._actions.single

    def reset(self, *, seed: Seeds | None = None, options: Info | None = None) -> tuple[Arrays, Info]:
        """Start new episodes.

        Args:
            seed: An integer keys world w by (seed, w), so that no two seeds have a world in common. A sequence has an
                integer for each sub-environment, equal ones for the agents of a world, and keys that world by
                (integer, 0). None: every world goes on to its next episode.
            options: {"reset_mask": bool (num_envs,)} resets the worlds of these sub-environments only; all agents of a
                world must have the same entry.
        """
        mask = self._of_worlds("reset_mask", reset_mask(options, self.num_envs))
        self.base_env.reset(seed=self._seeds(seed), options={"reset_mask": mask})
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))  # for np_random_seed only
        return self._observe(), self._info(mask)

    def step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, Info]:
        """Advance every world by one tick, as `outlast.SurvivalVectorEnv.step` does, which lists the errors.

        actions: (num_envs, actions), or with actions="joint" (num_envs,). Returns observations, float32 (num_envs,
        ...); rewards, float32 (num_envs,); terminated and truncated, bool (num_envs,); and info.
        """
        self._check_running()
        shape, who = (self.num_envs,), "sub-environment {0}"
        rows = self._actions.rows(actions, shape, self.check_actions, axes="num_envs", who=who)
        try:
            observed, reward, terminated, truncated, _ = self._play(rows)
        except FaultError:  # one world failed; the others have taken the step
            if self._resets and (ended := self.base_env._tracker.done).any():
                self.base_env.reset(options={"reset_mask": ended})
            raise
        info: Info = {}
        if (done := terminated | truncated).any():
            info, observed = self._finish(done, observed)
        info |= self._info(np.ones(self.num_worlds, bool))
        ends = self._spread(terminated), self._spread(truncated)
        return self._own(observed), self._rows(reward).copy(), *ends, info

    def render(self) -> tuple[Any, ...] | None:
        """Draw the world of every sub-environment: a tuple of frames as of SurvivalVectorEnv, which agents share."""
        frames = self.base_env.render()
        return None if frames is None else tuple(frame for frame in frames for _ in range(self._each))

    def action_masks(self) -> Array:
        """Return which actions can do something, bool (num_envs, entries); see SurvivalVectorEnv.action_masks."""
        self.base_env._check_running("action_masks")
        return self._rows(self._actions.masks())

    def set_state(self, state: State) -> Arrays:
        """Go on from `state`, of as many worlds or of one for all. Returns the observations. Raises StateError."""
        self.base_env.set_state(state)
        return self._observe()

    def close_extras(self, **kwargs: Any) -> None:
        """Close base_env."""
        if hasattr(self, "base_env"):  # missing if the constructor failed: Gymnasium closes the environment then, too
            self.base_env.close()

    def _choose(self) -> slice:
        """Return which agents of a world are sub-environments."""
        return slice(0, None)

    def _play(self, rows: Array) -> Any:
        return self.base_env.step(rows.reshape(self.num_worlds, self._each, -1))

    def _seeds(self, seed: Any) -> Any:
        """Return the seed of base_env: one for all worlds, or one for each world."""
        if as_array(seed).ndim == 0:
            return seed  # base_env checks it
        seeds = np.asarray(seed, object)
        if seeds.shape != (self.num_envs,):
            wanted = f"one integer, or one for each of {self.num_envs} sub-environments"
            raise ValueError(f"seed has shape {seeds.shape}: {wanted}")
        return self._of_worlds("seed", seeds).tolist()

    def _report(self, done: Array) -> Info:
        """Return entries that info has only when worlds end, about the worlds that are `done`, bool (worlds,)."""
        found, there = statistics(self.base_env.worlds, done), self._rows(present(self.base_env.worlds))
        return {"statistics": self._statistics(found), "_statistics": self._spread(done) & there}

    def _info(self, where: Array) -> Info:
        """Return entries that info has after every call, about the worlds `where`, bool (worlds,)."""
        rows = self._spread(where)
        info: Info = {}
        for key, values in self.base_env._presence().items():
            info |= {key: self._rows(values) & rows, f"_{key}": rows}
        if self._masked:
            masks = self._rows(self._actions.masks()) & rows[:, None]
            info |= {"action_mask": masks.view(np.int8), "_action_mask": rows}
        return info

    def _finish(self, done: Array, observed: Arrays) -> tuple[Info, Arrays]:
        """Report the episodes that just ended, reset their worlds under SAME_STEP, and return what is observed then."""
        info = self._report(done)
        if not self._resets:
            return info, observed
        rows, final = self._spread(done), np.full(self.num_envs, None, object)
        last = each(observed, self._rows)
        for k in np.flatnonzero(rows):
            final[k] = each(last, lambda view: view[k].copy())  # noqa: B023
        info |= {"final_info": info | self._info(done), "_final_info": rows.copy()}
        info |= {"final_obs": final, "_final_obs": rows}
        return info, self.base_env.reset(options={"reset_mask": done})[0]

    def _observe(self) -> Arrays:
        return self._own(self.base_env._observe())

    def _own(self, observed: Arrays) -> Arrays:
        """Return what the sub-environments observe, given what base_env does, in memory that it will overwrite."""
        rows = each(observed, self._rows)
        return each(rows, np.copy) if self.copy else rows

    def _statistics(self, statistics: Arrays) -> Arrays:
        """Return each sub-environment's own entry of the worlds' statistics, (num_envs,) by key."""
        own = agent_statistics(self.base_env.worlds, statistics, self._indices)
        return {key: values.reshape(self.num_envs, *values.shape[2:]) for key, values in own.items()}

    def _rows(self, values: Array) -> Array:
        """Reshape (worlds, agents, ...) to (num_envs, ...), sub-environments only; a view where that is possible."""
        return values[:, self._indices].reshape(self.num_envs, *values.shape[2:])

    def _spread(self, values: Array) -> Array:
        """Return values of worlds, (worlds,), for each sub-environment, (num_envs,): a copy."""
        return np.repeat(values, self._each, axis=0)

    def _of_worlds(self, name: str, rows: Array) -> Array:
        """Return values of sub-environments, (num_envs,), for each world, (worlds,). Those of a world must agree."""
        by_world = rows.reshape(self.num_worlds, self._each)
        differ = (by_world != by_world[:, :1]).any(1)
        if differ.any():
            w = int(differ.argmax())
            raise ValueError(
                f"{name}: sub-environments {w * self._each} to {(w + 1) * self._each - 1} are the agents of world {w} "
                f"and must agree; they have {by_world[w].tolist()}"
            )
        return by_world[:, 0]

    def _check_running(self) -> None:
        """Raise ClosedError or NotResetError unless every world can take a step."""
        self.base_env._check_running("step")
        if self.autoreset_mode is AutoresetMode.DISABLED and (done := self.base_env._tracker.done).any():
            raise NotResetError(
                f"sub-environments {np.flatnonzero(self._spread(done))[:8].tolist()} have ended and autoreset is "
                'disabled; reset them first: reset(options={"reset_mask": terminated | truncated})'
            )


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

    Arguments, numbers and errors are those of `outlast.make_vec`, with actions and masks for each sub-environment.
    max_episode_steps, the ticks after which a world is truncated, sets the scenario's ending_limit.
    """
    asked = requested(make_agents, scenario, numbers, max_episode_steps)
    return SurvivalAgentVectorEnv(asked, num_worlds, **world_options(locals()))
