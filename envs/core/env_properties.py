"""Properties of a batch of worlds: its spaces, the names of its arrays' columns, its present state."""

from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.components.agent import side_names
from outlast.ecs import AgentRoles, Fields, Worlds

from ..levels import Level
from ..rendering.notebook import Pictured
from ..scenarios.scenario import Scenario
from .action_spaces import ActionSpace
from .agents import Presence, counted
from .buffers import writable
from .concurrency import check_callable, exclusive
from .global_state import GlobalState
from .lifecycle import EpisodeTracker
from .numbers import current_levels, current_numbers
from .observations import Observations
from .spaces import statistics
from .step_events import StepEvents

Arrays = dict[str, np.ndarray[Any, Any]]
Actions = np.ndarray[Any, Any]


class EnvProperties(Pictured, VectorEnv[Arrays, Actions, np.ndarray[Any, Any]]):
    """The base of SurvivalVectorEnv, whose constructor sets these attributes."""

    scenario: Scenario
    worlds: Worlds
    num_worlds: int
    copy: bool
    _tracker: EpisodeTracker
    _reader: Observations
    _actions: ActionSpace
    _masked: bool
    _step_events: StepEvents

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """`single_observation_space`, batched. Made on first use, as it takes as much memory as a batch does."""
        return batch_space(self.single_observation_space, self.num_worlds)

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """`single_action_space`, batched. Always the same object, as its generator goes on from sample to sample."""
        return batch_space(self.single_action_space, self.num_worlds)

    @property
    def fields(self) -> Fields:
        """Return what the last axis of observations holds: `ecs.Field` by key and name, in order of columns.

        Keys that declare no fields, such as masks, are not in it. `columns` of a field is its slice of the row, and
        `ecs.columns_of` the index of several fields: observations["own"][..., columns_of(env.fields["own"], "x", "y")].
        """
        return {key: dict(named) for key, named in self.worlds.layout.fields.items()}

    @property
    def sides(self) -> tuple[str, ...]:
        """The names of the sides, in the order in which statistics have an entry for each side."""
        return side_names(self.worlds.layout)

    @property
    def roles(self) -> tuple[str, ...]:
        """The names of the roles; info["roles"] holds indices of it (-1: agent absent). Empty if there are no roles."""
        return self.scenario.by_role.names if self.scenario.by_role else ()

    @property
    def flat_size(self) -> int:
        """Return how many numbers the observation of one agent has: the length of its row in a flat array."""
        return self._reader.flat_size

    @property
    def flat_names(self) -> list[str]:
        """The names of a flat array's columns: "own.health", "heals.3.x" (of the fourth heal), "heals_mask.3"."""
        return self._reader.names

    @property
    def action_columns(self) -> list[tuple[str, int]]:
        """Names of the actions, and the value that the integer 0 stands for."""
        return list(zip(self._actions.keys, (-self._actions.zeros).tolist(), strict=True))

    @property
    def action_sizes(self) -> Actions:
        """Return how many values each action has, integers (actions,)."""
        return self._actions.sizes

    @property
    def noop(self) -> Actions:
        """The action that does nothing, integers (actions,); "joint": a single one; "continuous": floats (actions,)."""
        return self._actions.noop

    @property
    def action_mask_size(self) -> int:
        """The length of an agent's action mask: 15 in the paper; with actions="joint" 216, with "continuous" 0."""
        return self._actions.mask_size

    @cached_property
    def _presence(self) -> Presence:
        return Presence(self.worlds)

    @cached_property
    def _varied(self) -> bool:
        return bool(self.worlds.layout.varied)

    @cached_property
    def _roles(self) -> bool:
        return AgentRoles in self.worlds

    @cached_property
    def _global_state(self) -> GlobalState:
        return GlobalState(self.worlds, self._reader.scaled)

    @property
    def state_space(self) -> Any:
        """The space of one world's row of `state`: Box, float32 (size,)."""
        return self._global_state.space

    @property
    def state_names(self) -> list[str]:
        """The names of the columns of `state`: "agent_0.health", "box_3.x" ..."""
        return self._global_state.names

    @exclusive
    def observe(self, out: Any = None) -> Arrays:
        """Return the observations as they are now.

        Args:
            out: Memory to write them to as well: float32 arrays (worlds, agents, ...) by key, or one float32 array
                (worlds, agents, flat_size) that joins all keys; numpy arrays, or tensors that can share memory with
                numpy.

        Returns:
            As from `step`: copies, or views if copy=False.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has other keys, shapes or types; nothing was written.
        """
        self._tracker.check_running("observe")
        if out is not None:
            self._reader.write(self._reader.check(out))
        return self._observe()

    @exclusive
    def state(self, out: Any = None) -> Actions:
        """Return each world as one vector, for centralised critics. It includes what no agent sees.

        `state_names` has the names of its columns, which global_state.GlobalState describes.

        Args:
            out: Memory to write it to: float32 (worlds, size), a numpy array or a tensor that can share memory with it.

        Returns:
            float32 (worlds, size), scaled if observations are: a new array, or `out` as a numpy array.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has another shape or type.
        """
        self._tracker.check_running("state")
        if out is None:
            return self._global_state(slice(None))
        array = writable("out", out, (self.num_worlds, *self.state_space.shape))
        array[...] = self._global_state(slice(None))
        return array

    @exclusive
    def action_masks(self, out: Any = None) -> Actions:
        """Return which actions can change anything in the next step, or are `noop`.

        An action that is False would leave exactly the same world behind as `noop`, to the bit: attacks while the
        weapon is cooling down, use with an empty bag, whatever the dead do. One that is True may still do nothing.

        Args:
            out: Memory to write it to, bool of the shape below; otherwise as for `state`.

        Returns:
            bool (worlds, agents, action_mask_size): the values of the first action, then those of the second, and so
            on; with actions="joint" all joint actions. A new array, or `out` as a numpy array.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has another shape or type, or actions are continuous.
        """
        self._tracker.check_running("action_masks")
        if out is None:
            return self._actions.masks()
        array = writable("out", out, (self.num_worlds, self.worlds.dims["agents"], self.action_mask_size), bool)
        array[...] = self._actions.masks()
        return array

    @exclusive
    def events(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return what happened in the last step, or reset, of each world: who hit, killed, used, gave or broke what.

        Returns:
            By name of the event ("hit", "death", "item_used" ...), a structured array with a row for each event, in
            order of worlds: `world`, its index; `episode` and `tick`, int64; and the columns of the event (see
            docs/events.md), in which entities are rows of the world. The arrays are copies. A world that SAME_STEP has
            reset shows the events of the step that ended its episode.
        """
        return self._step_events.read()

    @exclusive
    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the game by name, as they are now.

        Numbers that vary (see Scenario.vary) are arrays (worlds, ...), with the value in each world's current episode;
        those that differ by role are arrays (worlds, agents). If there are any such numbers, NotResetError before
        reset().
        """
        return current_numbers(self.worlds)

    @exclusive
    def levels(self, mask: Any = None) -> list[Level]:
        """Return what the worlds' current episodes were made from; see outlast.levels. mask: bool (worlds,)."""
        return current_levels(self.worlds, mask)

    def _observe(self) -> Arrays:
        observed: Arrays = self._reader.read(self.copy)
        return observed

    def _check_running(self, call: str) -> None:
        """Raise ClosedError, PendingError or NotResetError unless `call` can look at all worlds; for adapters."""
        check_callable(self)
        self._tracker.check_running(call)

    def _info(self) -> dict[str, Any]:
        """Return the entries of info about the observations that are returned."""
        info: dict[str, Any] = {**self._presence()}
        if self._masked:
            info["action_mask"] = self._actions.masks().view(np.int8)  # the type that Gymnasium's Space.sample takes
        if self._varied:
            info["numbers"] = self.worlds.numbers()
        if self._roles:
            info["roles"] = np.where(info.get("present", True), self.worlds[AgentRoles].role, np.int32(-1))
        return info

    def _ended(self, done: Actions) -> dict[str, Any]:
        """Return the entries of info about the episodes that just ended, in the worlds `done`."""
        info: dict[str, Any] = {"statistics": statistics(self.worlds, done), "_statistics": done}
        if there := counted(self.worlds):
            info["statistics_present"] = there
        return info

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.scenario.name!r}, num_worlds={self.num_worlds})"

    def __reduce__(self) -> Any:
        raise TypeError(
            "an environment cannot be pickled or copied; pickle what makes it, as "
            "functools.partial(outlast.make_vec, 'ffa_3', 64, seed=0), and what get_state() returns"
        )
