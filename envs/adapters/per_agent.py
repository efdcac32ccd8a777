"""A batch of worlds seen agent by agent: what the Gymnasium faces with single-agent sub-environments share."""

from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.components import Side
from outlast.ecs import Clock, Entity, Statistic

from ..core.spaces import published, statistics
from ..core.validation import Array, reset_mask
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import ClosedError, NotResetError
from ..rendering.modes import FPS, RENDER_MODES, render_worlds
from ..snapshots.state import State
from .agent_spaces import agent_spaces
from .rows import checked_rows, world_mask, world_seeds


class Face(VectorEnv[Arrays, Actions, Array]):
    """Agents of every world as sub-environments, world by world; a view on a SurvivalVectorEnv, the core.

    seats: which agents of a world, a slice of ids. core: made by `face_core`, for the same autoreset mode. Worlds end
    as wholes: all sub-environments of a world end, and are reset, together. over: bool (worlds,), which have ended and
    wait for their reset.
    """

    def __init__(
        self,
        core: SurvivalVectorEnv,
        seats: slice,
        *,
        autoreset: AutoresetMode,
        copy: bool,
        render_mode: str | None,
        check_actions: bool = True,
    ) -> None:
        self.core, self.autoreset, self.render_mode = core, autoreset, render_mode
        self.copy, self.check_actions = copy, check_actions
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": FPS, "autoreset_mode": autoreset}
        self.metadata["name"] = core.scenario.name
        self.num_worlds, self._seats = core.num_worlds, seats
        ids = range(core.num_agents)[seats]
        self.num_envs, self._each = self.num_worlds * len(ids), len(ids)
        seen, done = agent_spaces(core)
        self.single_observation_space, self.single_action_space = seen[ids[0]], done[ids[0]]
        self._views = {key: self._rows(buffer) for key, buffer in core.observe().items()}  # of the same memory for life
        columns = published(core.worlds, Statistic)
        self._shares = {key: column.dims[0] for key, _, _, column in columns if column.dims}
        self._agents = core.worlds.span("agent")
        self.over = np.zeros(self.num_worlds, bool)
        self._started = np.zeros(self.num_worlds, bool)

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; made when first asked for, as it is as large as a batch of observations."""
        return batch_space(self.single_observation_space, self.num_envs)

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; the same object in every call, as its generator goes on from sample to sample."""
        return batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | list[int] | Array | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes everywhere, or where options["reset_mask"] (bool, (num_envs,)) says.

        seed: an int keys world w by (seed, w), so that no two seeds have a world in common; a sequence has an entry for
        each sub-environment and keys its world by (entry, 0). In sequence and mask the agents of a world must agree.
        Without a seed, every world goes on to its next episode. Raises ValueError.
        """
        mask = world_mask(reset_mask(options, self.num_envs), self._each)
        self.core.reset(seed=self._seeds(seed), options={"reset_mask": mask})
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))  # for np_random_seed
        self.over &= ~mask
        self._started |= mask
        return self._observe(), self._tell(mask)

    def step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """One tick of every world. A refused call (see ActionError) changes nothing.

        NEXT_STEP: who ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at once;
        info["final_obs"] and info["final_info"] tell of the end. DISABLED: reset it yourself.
        """
        self._check_steppable()
        joint = self._joint(checked_rows(actions, self.num_envs, self.core.action_sizes, self.check_actions))
        _, reward, terminated, truncated, _ = self.core.step(joint)
        terminated, truncated = self._ends(terminated, truncated)
        if self.over.any():  # NEXT_STEP, and this was the step that resets them
            self._restart(reward, terminated, truncated)
        self.over = terminated | truncated
        info = self._finish() if self.over.any() else {}
        info |= self._tell(np.ones(self.num_worlds, bool))
        return self._observe(), self._rows(reward).copy(), self._spread(terminated), self._spread(truncated), info

    def render(self) -> tuple[Any, ...] | None:
        """A frame of each agent's world, uint8 (512, 512, 3) or text; agents of one world share it."""
        if self.render_mode is not None:
            self._check_started("render")
        return render_worlds(self.core.worlds, self.render_mode, self._each)

    def get_state(self) -> State:
        """The worlds as plain arrays, to go on from later; see SurvivalVectorEnv.get_state."""
        return self.core.get_state()

    def set_state(self, state: State) -> Arrays:
        """Go on from `state`, of as many worlds or of one for all; returns the observations. Raises StateError."""
        self.core.set_state(state)
        self._started[:] = state.arrays["started"]
        self.over[:] = state.arrays["over"]
        self.over = np.logical_or(*self._ends(self.over, np.zeros(self.num_worlds, bool)))
        return self._observe()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the core."""
        if hasattr(self, "core"):  # gymnasium 1.1 also closes what could not be made
            self.core.close()

    def _seeds(self, seed: Any) -> Any:
        """What the core is to be seeded with."""
        return world_seeds(seed, self.num_worlds, self._each)

    def _joint(self, rows: Array) -> Array:
        """The actions of all agents, (worlds, agents, actions), given those of the sub-environments."""
        raise NotImplementedError

    def _ends(self, terminated: Array, truncated: Array) -> tuple[Array, Array]:
        """Which worlds end here, given which end by themselves; new or the same arrays, bool (worlds,)."""
        return terminated, truncated

    def _report(self) -> dict[str, Any]:
        """What info holds only when sub-environments end, about those."""
        return {}

    def _tell(self, where: Array) -> dict[str, Any]:
        """What info always holds, about the worlds `where`."""
        rows = self._spread(where)
        return {"alive": self._alive().ravel() & rows, "_alive": rows}

    def _restart(self, reward: Array, terminated: Array, truncated: Array) -> None:
        """Make this the resetting step of the worlds that were over: the core knows only of those that it ended."""
        stale = self.over & (self.core.worlds[Clock].tick[:, 0] > 0)
        if stale.any():
            self.core.reset(options={"reset_mask": stale})
        reward[self.over] = 0
        terminated[self.over] = truncated[self.over] = False

    def _finish(self) -> dict[str, Any]:
        """Report the episodes that just ended; under SAME_STEP also start the next ones."""
        info = self._report()
        if self.autoreset is AutoresetMode.SAME_STEP:
            rows, final = self._spread(self.over), np.full(self.num_envs, None, object)
            for k in np.flatnonzero(rows):
                final[k] = {key: view[k].copy() for key, view in self._views.items()}
            info |= {"final_info": info | self._tell(self.over), "_final_info": rows.copy()}
            info |= {"final_obs": final, "_final_obs": rows}
            self.core.reset(options={"reset_mask": self.over})
            self.over = np.zeros(self.num_worlds, bool)
        return info

    def _observe(self) -> Arrays:
        return {key: view.copy() if self.copy else view for key, view in self._views.items()}

    def _alive(self) -> Array:
        """Which of the seated agents live, bool (worlds, seats)."""
        alive: Array = self.core.worlds[Entity].alive[:, self._agents][:, self._seats] != 0
        return alive

    def _own(self, where: Array) -> Arrays:
        """Statistics of the episodes so far, (num_envs, ...), zero but for the worlds `where`.

        Of what is counted by agent or by side, every sub-environment gets its own, or its side's.
        """
        side = self.core.worlds[Side].side[:, self._agents][:, self._seats]
        own = {}
        for key, values in statistics(self.core.worlds, where).items():
            share = self._shares.get(key)
            if share == "sides":
                own[key] = values[np.arange(self.num_worlds)[:, None], side].reshape(self.num_envs, *values.shape[2:])
            else:
                own[key] = self._rows(values).copy() if share == "agents" else self._spread(values)
        return own

    def _rows(self, values: Array) -> Array:
        """(worlds, agents, ...) as (num_envs, ...), the seated agents only; a view where that is possible."""
        return values[:, self._seats].reshape(self.num_envs, *values.shape[2:])

    def _spread(self, values: Array) -> Array:
        """(worlds, ...) as (num_envs, ...): a copy in which every sub-environment has what its world has."""
        return np.repeat(values, self._each, axis=0)

    def _check_started(self, name: str) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; make a new one")
        if not self._started.all():
            missing = int((~self._started).sum())
            raise NotResetError(f"{name}() before reset(): {missing} worlds have not started; reset them")

    def _check_steppable(self) -> None:
        self._check_started("step")
        if self.autoreset is AutoresetMode.DISABLED and self.over.any():
            raise NotResetError(
                f"sub-environments {np.flatnonzero(self._spread(self.over))[:8].tolist()} have ended and autoreset is "
                'disabled; reset them first: reset(options={"reset_mask": terminated | truncated})'
            )
