"""The bases of adapters: of all, of those of one world, and of those in which each agent is a sub-environment."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.components import Return
from outlast.ecs import NumberError, Worlds

from ..core.action_spaces import ActionSpace
from ..core.agents import agent_statistics
from ..core.observations import each
from ..core.validation import Array, as_array, check_choice, check_count, check_flags, reset_mask
from ..core.validation import autoreset_mode as checked_mode
from ..core.vector_env import Actions, Arrays, BatchedSpaces, SurvivalVectorEnv
from ..errors import FaultError, NotResetError
from ..rendering.rgb import Pictured, Window
from ..scenarios.parse import options_of, resolve
from ..scenarios.scenario import Scenario
from ..snapshots.state import State

DEAD = ("end", "keep")  # whether an agent's death ends its episode, or it stays until its world ends


def check_dead(dead: str, worlds: Worlds) -> None:
    """Raise ValueError unless `dead` is one of DEAD, and "keep" if agents come back to life."""
    check_choice("dead", dead, DEAD)
    if dead == "end" and Return in worlds:
        raise ValueError("dead = 'end': agents come back in this scenario, so none ends at its death; take dead='keep'")


def requested(
    make: Callable[..., Any], scenario: str | Scenario, numbers: Mapping[str, Any], max_episode_steps: int | None = None
) -> Scenario:
    """Return the scenario that the factory `make` was called with; its time limit becomes the number ending_limit."""
    given = dict(numbers)
    if (dead := given.pop("dead", "keep")) != "keep":  # for factories that have no keyword `dead`
        cure = "gymnasium.make, gymnasium.make_vec, parallel_env and SurvivalMultiAgentEnv have dead='end'"
        raise ValueError(f"dead = {dead!r}: 'keep' is needed, as all agents of a world end together here; {cure}")
    if max_episode_steps is not None:
        check_count("max_episode_steps", max_episode_steps, 1)
        if "ending_limit" in given:
            raise ValueError("max_episode_steps and ending_limit are the same number: give one of them")
        scenario = resolve(scenario)
        if "ending_limit" not in scenario.numbers():
            raise NumberError(f"max_episode_steps: {scenario.name} has no mechanic Ending, whose ending_limit that is")
        given["ending_limit"] = max_episode_steps
    return resolve(scenario, given, options_of(make))


class Adapter(Pictured):
    """The base of adapters: what all of them take from `base_env`, the SurvivalVectorEnv below."""

    base_env: SurvivalVectorEnv

    @property
    def state_space(self) -> Any:
        """The space of one world's row of `state`: Box, float32 (size,)."""
        return self.base_env.state_space

    @property
    def state_names(self) -> list[str]:
        """The names of the columns of `state`; see SurvivalVectorEnv.state_names."""
        return self.base_env.state_names

    def state(self, out: Any = None) -> Array:
        """Return each world as one vector, float32 (num_worlds, size), for critics; see SurvivalVectorEnv.state."""
        return self.base_env.state(out)

    def get_state(self) -> State:
        """Return the worlds' state as plain arrays, to go on from later; see SurvivalVectorEnv.get_state."""
        return self.base_env.get_state()


class OneWorldAdapter(Adapter):
    """The base of adapters of a single world, which a window may show."""

    _window: Window | None
    render: Callable[[], Any]

    def state(self) -> Array:  # type: ignore[override]
        """Return the complete world, also what no agent sees, float32 (size,); see SurvivalVectorEnv.state."""
        return self.base_env.state()[0]

    def close(self) -> None:
        """Close the window and the world. Closing again does no harm."""
        if self._window is not None:
            self._window.close()
        self.base_env.close()

    def _show(self) -> None:
        if self._window is not None:
            self.render()


class PerAgentVectorEnv(Adapter, BatchedSpaces):
    """Agents of every world as sub-environments, world by world. All agents of a world end and are reset together.

    base_env, a SurvivalVectorEnv without copies, ends episodes and resets worlds according to autoreset_mode. Under
    SAME_STEP, its own mode is NEXT_STEP: the adapter keeps the last observations and infos, and then resets the worlds
    itself; only worlds that were set to a state in which they have ended wait for the next step.

    check_joint: Whether base_env checks the range of the actions of all agents. For the other arguments see
    `outlast.adapters.make_agents`; base_env always has actions="multi".
    """

    def __init__(
        self,
        scenario: str | Scenario,
        num_worlds: int,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        check_actions: bool = True,
        check_joint: bool = False,
        actions: str = "multi",
        action_masks: bool = False,
        **options: Any,
    ) -> None:
        check_flags(copy=copy, check_actions=check_actions, action_masks=action_masks)
        self.autoreset_mode, self.copy, self.check_actions = checked_mode(autoreset_mode), copy, check_actions
        inner = AutoresetMode.NEXT_STEP if self.autoreset_mode is AutoresetMode.SAME_STEP else self.autoreset_mode
        self.base_env = SurvivalVectorEnv(
            resolve(scenario), num_worlds, autoreset_mode=inner, copy=False, check_actions=check_joint, **options
        )
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

    def reset(
        self, *, seed: int | list[int] | Array | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: An integer keys world w by (seed, w), so that no two seeds have a world in common. A sequence has an
                integer for each sub-environment, equal ones for the agents of a world, and keys that world by
                (integer, 0). None: every world goes on to its next episode.
            options: {"reset_mask": bool (num_envs,)} resets the worlds of these sub-environments only; all agents of a
                world must have the same entry. Other options do not exist.

        Returns:
            Observations, float32 (num_envs, ...), and info, with "alive" for the agents whose worlds were reset.

        Raises:
            ValueError: The seed or an option is not valid, or agents of one world have different mask entries.
        """
        mask = self._of_worlds("reset_mask", reset_mask(options, self.num_envs))
        self.base_env.reset(seed=self._seeds(seed), options={"reset_mask": mask})
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))  # for np_random_seed only
        return self._observe(), self._info(mask)

    def step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """Advance every world by one tick. A refused call changes nothing.

        NEXT_STEP: a world that ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at
        once; info["final_obs"] and info["final_info"] hold its end. DISABLED: reset it yourself.

        Args:
            actions: Integers of any type, (num_envs, actions); with actions="joint" (num_envs,); with
                actions="continuous" floats from -1 to 1, (num_envs, actions).

        Returns:
            Observations, float32 (num_envs, ...); rewards, float32 (num_envs,); terminated and truncated, bool
            (num_envs,); info.

        Raises:
            ActionError: Actions of the wrong shape or type, or out of range.
            NotResetError: Some worlds have not been reset, or have ended under DISABLED.
            FaultError: A world is in a state that the physics cannot handle; the others have been stepped.
        """
        self._check_running()
        shape, who = (self.num_envs,), "sub-environment {0}"
        rows = self._actions.rows(actions, shape, self.check_actions, axes="num_envs", who=who)
        try:
            observed, reward, terminated, truncated, _ = self._play(rows)
        except FaultError:  # one world failed; the others have taken the step
            if (ended := self.base_env._tracker.done).any():
                self._begin_next(ended)
            raise
        info: dict[str, Any] = {}
        if (done := terminated | truncated).any():
            info = self._finish(done, observed)
            begun = self._begin_next(done)
            observed = observed if begun is None else begun
        info |= self._info(np.ones(self.num_worlds, bool))
        ends = self._spread(terminated), self._spread(truncated)
        return self._own(observed), self._rows(reward).copy(), *ends, info

    def render(self) -> tuple[Any, ...] | None:
        """Draw the world of every sub-environment: a tuple of images, uint8 (height, width, 3) in RGB, or of texts.

        Agents of a world share one frame. Without a render_mode it warns and returns None. NotResetError before
        reset().
        """
        frames = self.base_env.render()
        return None if frames is None else tuple(frame for frame in frames for _ in range(self._each))

    def action_masks(self) -> Array:
        """Return which actions can do something, bool (num_envs, entries); see SurvivalVectorEnv.action_masks."""
        self.base_env._check_running("action_masks")
        return self._masks()

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
        """Take a step of base_env with the checked actions of the sub-environments, and return its results."""
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

    def _report(self, done: Array) -> dict[str, Any]:
        """Return entries that info has only when worlds end, about the worlds that are `done`, bool (worlds,)."""
        return {}

    def _info(self, where: Array) -> dict[str, Any]:
        """Return entries that info has after every call, about the worlds `where`, bool (worlds,)."""
        rows = self._spread(where)
        info: dict[str, Any] = {}
        for key, values in self.base_env._presence().items():
            info |= {key: self._rows(values) & rows, f"_{key}": rows}
        if self._masked:
            info |= {"action_mask": (self._masks() & rows[:, None]).view(np.int8), "_action_mask": rows}
        return info

    def _finish(self, done: Array, observed: Arrays) -> dict[str, Any]:
        """Report the episodes that just ended; `observed` is what base_env returned."""
        info = self._report(done)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            rows, final = self._spread(done), np.full(self.num_envs, None, object)
            last = each(observed, self._rows)
            for k in np.flatnonzero(rows):
                final[k] = each(last, lambda view: view[k].copy())  # noqa: B023
            info |= {"final_info": info | self._info(done), "_final_info": rows.copy()}
            info |= {"final_obs": final, "_final_obs": rows}
        return info

    def _begin_next(self, done: Array) -> Arrays | None:
        """Reset the worlds that just ended, under SAME_STEP, and return what base_env observes now."""
        if self.autoreset_mode is not AutoresetMode.SAME_STEP:
            return None
        return self.base_env.reset(options={"reset_mask": done})[0]

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

    def _masks(self) -> Array:
        return self._rows(self._actions.masks())

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
