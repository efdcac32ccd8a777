"""The spaces of actions: an integer for each action, or one integer for all of them; and masks of useless actions."""

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np
from gymnasium import spaces

from outlast.components.masks import Idle, MasksActions
from outlast.ecs import Action, AgentRoles, DeclarationError, Module, Worlds
from outlast.ecs.kernels.errors import did_you_mean
from outlast.systems.role_limits import without

from ..errors import ActionError, UsageError
from .spaces import published
from .validation import Array, as_array, check_choice, checked_actions, checked_fractions

KINDS = ("multi", "joint", "continuous")
MOST = 1 << 16  # maximum joint actions: learners have an output for each
MASKED = 20  # maximum actions: a mask is stored for every subset of them


class MaskedMultiDiscrete(spaces.MultiDiscrete):
    """A MultiDiscrete (actions,) whose `sample` also takes a mask in the environments' form, (entries,)."""

    def sample(self, mask: Any = None, probability: Any = None) -> Any:
        """Sample as Gymnasium's own does, which takes a tuple with a mask for each action. mask: int8, bool or that."""
        if isinstance(mask, np.ndarray):
            mask = tuple(np.split(mask.astype(np.int8), np.cumsum(self.nvec)[:-1]))
        return super().sample(mask, probability)


class ActionSpace:
    """The actions of an agent in the form for a learner, and their masks.

    "multi": an integer for each action, as in `MultiDiscrete([3, 3, 3, 2, 2, 2])`. "joint": one integer for all of
    them, as in `Discrete(216)`: in the mixed base `sizes`, with the first action as the first digit, as in
    numpy.unravel_index. "continuous": a float from -1 to 1 for each action, as in `Box(-1, 1, (6,))`. The values of an
    action divide that range into equal parts: -1 is the lowest value and 1 the highest, and with two values the upper
    one begins at 0. It is the value that is simulated, recorded and replayed.

    Attributes:
        kind: One of KINDS.
        keys: The name of each action.
        sizes: Number of values of each action, (actions,).
        zeros: The value of each that does nothing, (actions,).
        noop: The action that does nothing, in the learner's form: integers (actions,), or () for kind "joint";
            for kind "continuous" the middle of its parts, float32 (actions,).
        mask_size: The length of an agent's mask. Kind "multi": all values of the first action, then those of the
            second, and so on; "joint": all joint actions; "continuous": 0, as without masks.
    """

    def __init__(self, worlds: Worlds, kind: str, masked: bool = False) -> None:
        """Raise ValueError for another kind, more joint actions than MOST, or `masked` for a kind without masks."""
        check_choice("actions", kind, KINDS)
        columns = published(worlds, Action)
        self.kind, self.keys = kind, [key for key, *_ in columns]
        self.sizes = np.array([int(column.high - column.low) + 1 for *_, column in columns])
        self._worlds, self.zeros = worlds, np.array([-int(column.low) for *_, column in columns])
        self._readers = [  # the mechanics whose running systems read each
            {system.module for system in worlds.schedule.systems if system.touches(component, "read", "write", "add")}
            for _, component, *_ in columns
        ]
        self._masking = [each for each in worlds.modules if isinstance(each, MasksActions)]
        brought = {each.name: [type(part) for part in each.singletons()] for each in worlds.modules}
        self._idle = {name: [part for part in parts if issubclass(part, Idle)] for name, parts in brought.items()}
        self._table: Array | None = None  # the actions of each joint action, integers (joint actions, actions)
        self.mask_size = int(self.sizes.sum())
        if kind == "joint":
            self.mask_size = math.prod(self.sizes.tolist())
            if self.mask_size > MOST:
                raise ValueError(
                    f"actions = 'joint': there are {self.mask_size:,} joint actions here, at most {MOST:,} can be; "
                    "take actions='multi'"
                )
            digits = np.unravel_index(np.arange(self.mask_size), tuple(self.sizes))
            self._table = np.stack(digits, 1)
        if kind == "continuous":
            self.mask_size = 0
        if masked:
            self.check_masked()
        self.noop = self.given(self.zeros).copy()
        self.noop.flags.writeable = self.zeros.flags.writeable = self.sizes.flags.writeable = False

    @property
    def single(self) -> spaces.Space[Any]:
        """Return the space of one agent, a new object: MultiDiscrete (actions,), Discrete or Box (actions,)."""
        if self.kind == "continuous":
            return spaces.Box(-1, 1, self.sizes.shape, np.float32)
        return MaskedMultiDiscrete(self.sizes) if self.kind == "multi" else spaces.Discrete(self.mask_size)

    def batched(self, agents: int) -> spaces.Space[Any]:
        """Return the space of a world's agents, a new object: MultiDiscrete or Box (agents, actions), or (agents,)."""
        if self.kind == "continuous":
            return spaces.Box(-1, 1, (agents, *self.sizes.shape), np.float32)
        return spaces.MultiDiscrete(
            np.tile(self.sizes, (agents, 1)) if self.kind == "multi" else np.full(agents, self.mask_size)
        )

    def checked(
        self,
        given: Any,
        shape: tuple[int, ...],
        ranges: bool = True,
        *,
        axes: str = "",
        who: str = "agent {1} in world {0}",
        what: str = "actions",
    ) -> Array:
        """Return the actions that a learner passed, checked but not converted; see validation.checked_actions.

        given: For kind "multi" integers (*shape, actions), for "joint" (*shape); for "continuous" floats (*shape,
        actions), whose range is always checked. shape, axes: Those of the agents, such as "worlds, agents".
        """
        if self.kind == "joint":
            axes = f"({axes})" if axes else "a single one"
            given = as_array(given)
            if given.shape != shape:
                wanted = f"{axes} = {shape}" if shape else axes
                raise ActionError(f"{what} have shape {given.shape}: {wanted} is needed, as each is a joint action")
            count = np.array([self.mask_size])
            return checked_actions(given[..., None], (*shape, 1), count, who=who, what=what)[..., 0]
        axes = f"({axes}, actions)" if axes else "(actions,)"
        shape = (*shape, len(self.keys))
        if self.kind == "continuous":
            return checked_fractions(given, shape, what=what, axes=axes, who=who, keys=self.keys)
        return checked_actions(given, shape, self.sizes, ranges, what=what, axes=axes, who=who, keys=self.keys)

    def rows(self, given: Any, shape: tuple[int, ...], ranges: bool = True, **named: str) -> Array:
        """Return the actions that a learner passed, as integers (*shape, actions). For the arguments see `checked`."""
        checked = self.checked(given, shape, ranges, **named)
        if self.kind == "continuous":
            checked = np.clip((checked + 1) * self.sizes / 2, 0, self.sizes - 1).astype(np.int64)
        return checked if self._table is None else self._table[checked]

    def given(self, rows: Array) -> Array:
        """Return the learner's form of actions (the middle of a value's part, if continuous): the inverse of `rows`.

        rows: integers (..., actions).
        """
        given: Array = rows
        if self.kind == "continuous":
            given = ((2 * rows + 1) / self.sizes - 1).astype(np.float32)
        elif self.kind == "joint":
            given = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(rows, -1, 0)), tuple(self.sizes)))
        return given

    def write(self, given: Any, actions: Array, ranges: bool = False) -> None:
        """Write a learner's actions into `actions`, integers (worlds, agents, actions), unless they are refused."""
        plain = self.kind == "multi" and not ranges and isinstance(given, np.ndarray)
        # the usual actions are written without conversion
        if not (plain and given.shape == actions.shape and given.dtype.kind in "iu"):
            given = self.rows(given, actions.shape[:2], ranges, axes="worlds, agents")
        actions[...] = given

    def check_masked(self) -> None:
        """UsageError, which is a ValueError, without masks."""
        if self.kind == "continuous":
            raise UsageError(
                "actions = 'continuous': action masks exist for discrete actions only; take 'multi' or 'joint'"
            )

    def masks(self) -> Array:
        """Return bool (worlds, agents, mask_size), a new array; see SurvivalVectorEnv.action_masks."""
        self.check_masked()
        return self._by_idle[self.idle() @ (1 << np.arange(len(self.keys)))]

    def idle(self) -> Array:
        """Return whether each action has no effect in the next tick, for any value: bool (worlds, agents, actions)."""
        roles = self._worlds.layout.roles
        idle = {module.name: _idle(module, self._worlds, self.keys) for module in self._masking}
        for name, parts in self._idle.items():
            for part in parts:
                idle[name] = idle.get(name, {}) | self._worlds[part]._asdict()
        found = np.ones((self._worlds.count, self._worlds.dims["agents"], len(self.keys)), bool)
        for k, (key, readers) in enumerate(zip(self.keys, self._readers, strict=True)):
            for name in readers:
                found[..., k] &= np.asarray(idle.get(name, {}).get(key, False), bool)
            if roles and any(lacking := without(roles, key)):
                role = self._worlds[AgentRoles].role
                found[..., k] |= (role >= 0) & np.array(lacking)[role]
        return found

    @cached_property
    def _by_idle(self) -> Array:
        """Return a mask for each set of idle actions, bool (sets, mask_size). Raises DeclarationError for too many."""
        if len(self.keys) > MASKED:
            raise DeclarationError(f"masks of {len(self.keys)} actions: at most {MASKED} are possible; leave masks out")
        # whether each set has each action, (sets, actions)
        sets = np.arange(1 << len(self.keys))[:, None] >> np.arange(len(self.keys)) & 1
        allowed = [(sets[:, [k]] == 0) | (np.arange(size) == self.zeros[k]) for k, size in enumerate(self.sizes)]
        if self._table is None:
            return np.concatenate(allowed, 1)
        return np.logical_and.reduce([own[:, self._table[:, k]] for k, own in enumerate(allowed)])


def _idle(module: Module, worlds: Worlds, known: Sequence[str]) -> dict[str, Array]:
    """Return the result of a module's idle_actions(). Raises DeclarationError if it has another form."""
    given, shape = cast("Any", module).idle_actions(worlds), (worlds.count, worlds.dims["agents"])
    if not isinstance(given, Mapping):
        raise DeclarationError(f"{module.name}.idle_actions() returned {type(given).__name__}: a dict is needed")
    found = {key: np.asarray(idle) for key, idle in given.items()}
    for key, idle in found.items():
        # it may be an action that the scenario lacks; all actions are listed only in this case
        if key not in known and not {key} & Action.keys():
            hint = did_you_mean(key, known) or f"there are: {', '.join(sorted(known))}"
            raise DeclarationError(f"{module.name}.idle_actions() names the action {key!r}, which is none; {hint}")
        if idle.shape != shape:
            raise DeclarationError(
                f"{module.name}.idle_actions() has {key!r} of the shape {idle.shape}: (worlds, agents), which is "
                f"{shape} here, is needed"
            )
    return found
