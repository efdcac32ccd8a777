"""What a batch of worlds says of itself: its spaces, and the names of what is in its arrays."""

from functools import cached_property
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.ecs import AgentRoles, Fields, Worlds

from ..scenarios.scenario import Scenario
from .agents import alive, counted, present
from .buffers import flat_size
from .spaces import statistics

Arrays = dict[str, np.ndarray[Any, Any]]
Actions = np.ndarray[Any, Any]


class Described(VectorEnv[Arrays, Actions, np.ndarray[Any, Any]]):
    """The base of SurvivalVectorEnv, whose constructor makes these."""

    scenario: Scenario
    worlds: Worlds
    num_worlds: int
    _observations: Arrays

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; made when first asked for, as it is as large as a batch of observations."""
        return batch_space(self.single_observation_space, self.num_worlds)

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; the same object in every call, as its generator goes on from sample to sample."""
        return batch_space(self.single_action_space, self.num_worlds)

    @property
    def fields(self) -> Fields:
        """What the last axis of observations holds: `ecs.Field` by key and name, in order of columns.

        Of keys that declare it, so not of masks. `columns` of a field is its slice of the row, `ecs.columns_of` the
        index of several: observations["own"][..., columns_of(env.fields["own"], "x", "y")].
        """
        return self.worlds.layout.fields

    @property
    def sides(self) -> tuple[str, ...]:
        """What the sides are called, by number, as in statistics of sides."""
        return self.worlds.layout.side_names

    @property
    def roles(self) -> tuple[str, ...]:
        """What the roles are called, by number, as in info["roles"] (-1: of who is absent); none without any."""
        return self.scenario.by_role.names if self.scenario.by_role else ()

    @property
    def flat_size(self) -> int:
        """Numbers in the observation of one agent: the length of its row in a flat array."""
        return flat_size(self._observations)

    def _info(self) -> dict[str, Any]:
        """What info has of the observations that are returned."""
        info: dict[str, Any] = {"alive": alive(self.worlds)}
        if self.worlds.layout.varied:
            info |= {"numbers": self.worlds.numbers(), "present": present(self.worlds)}
        if AgentRoles in self.worlds:
            info["roles"] = np.where(info.get("present", True), self.worlds[AgentRoles].role, np.int32(-1))
        return info

    def _ended(self, done: Actions) -> dict[str, Any]:
        """What info has of the episodes that just ended, in the worlds `done`."""
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
