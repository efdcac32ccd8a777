"""Mixtures: policies with weights, one of which is drawn for each world and episode."""

import math
import os
import weakref
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from outlast.ecs import Clock, Worlds
from outlast.ecs.kernels.errors import did_you_mean

from ..core.described import Actions, Arrays
from ..core.validation import checked_actions
from ..core.vector_env import SurvivalVectorEnv
from ..errors import UsageError
from .memory import has_memory, tell
from .models import models
from .policies import POLICIES, Policy, hashed, others_policy
from .saved import SAVED_AS, is_saved, load_saved, policy_file, text_of

Array = np.ndarray[Any, Any]
Entries = list[tuple[str | Policy, float]]  # a name, a path or a function, with its weight

# the mixture that plays a policy with a memory, by the policy's id
OWNERS = weakref.WeakValueDictionary[int, "Mixture"]()

# the text "mixture"; makes these draws differ from others in the same world and episode
STREAM = np.uint64(0x6D697874757265)


def parse_mixture(text: str, names: Collection[str] = tuple(POLICIES)) -> dict[str, float]:
    """Return the weights in a text such as "scripted:0.5,runs/a.zip:0.3,random".

    Args:
        text: Names of policies or models, or saved policies (FILE.zip, FILE.safetensors or the folder of a run), each
            followed by a colon and its weight; without these, the weight is 1.
        names: The names that are allowed.

    Returns:
        Weights by name or path of a file, in the order of the text.

    Raises:
        UsageError: A name is unknown or given twice, or a weight is not a finite number above 0.
    """
    pairs = []
    for part in text.split(","):
        name, weight = part.strip(), "1"
        # C:/runs may be a folder, whose colon is not that of a weight
        if ":" in name and not is_saved(name) and not Path(name).is_dir():
            name, _, weight = (piece.strip() for piece in name.rpartition(":"))
        pairs.append((name, weight))
    return {str(name): weight for name, weight in checked_entries(pairs, names)}


def checked_entries(pairs: Iterable[tuple[Any, Any]], names: Collection[str] = tuple(POLICIES)) -> Entries:
    """Check policies with their weights, and return them.

    Args:
        pairs: Pairs of a policy and its weight, a finite number above 0. A policy is a name, also of a model, the path
            of a saved policy, the folder of a run, whose newest one is taken, or a function (observations) -> actions.
        names: The names that are allowed.

    Raises:
        UsageError: There are no pairs, one of them is something else, or a policy is given twice.
    """
    entries: Entries = []
    for given, weight in pairs:
        policy = text_of(given) if isinstance(given, os.PathLike) else given
        if isinstance(policy, str):
            policy = _named(policy, names)
        elif not callable(policy):
            raise UsageError(f"{policy!r} is no policy: {_needed(names)}, or a function (observations) -> actions")
        if _same(policy) in [_same(other) for other, _ in entries]:
            raise UsageError(f"{policy} is there twice: give it once, with the sum of its weights")
        entries.append((policy, _checked_weight(policy, weight)))
    if not entries:
        raise UsageError(f"a mixture of nothing: {_needed(names)}")
    return entries


def draw(weights: Sequence[float] | Array, seeds: Any, worlds: Any, episodes: Any) -> Array:
    """Draw an entry for each world: a function of the weights and (seed, world, episode), the same in any batch.

    Args:
        weights: Finite numbers >= 0, at least one above 0: (entries,), or a row for each world, (worlds, entries). An
            entry with twice the weight is drawn twice as often.
        seeds: The seed that keys each world, integers (worlds,).
        worlds: The number of each world, integers (worlds,).
        episodes: The number of the episode of each world, integers (worlds,). `key_of` returns all three.

    Returns:
        The index of an entry for each world, int64 (worlds,).

    Raises:
        ValueError: The weights are not valid.
    """
    weights = np.asarray(weights, np.float64)
    if not (np.isfinite(weights).all() and (weights >= 0).all() and (weights > 0).any(-1).all()):
        raise ValueError(f"weights = {weights.tolist()}: finite numbers >= 0 are needed, in each row one above 0")
    # scaled, so that the sum neither vanishes nor overflows
    sums = np.cumsum(weights / weights.max(-1, keepdims=True), -1)
    words = hashed(STREAM, *(np.asarray(part).astype(np.uint64) for part in (seeds, worlds, episodes)))
    uniform = (words >> np.uint64(11)) * 2.0**-53
    return np.asarray((sums <= uniform[:, None] * sums[..., -1:]).sum(-1))


def key_of(worlds: Worlds, where: Any = slice(None)) -> tuple[Array, Array, Array]:
    """Return the present seeds, world numbers and episode numbers of the worlds `where`, uint64 (worlds,) each."""
    clock = worlds[Clock]
    return clock.seed[where, 0], clock.world[where, 0], clock.episode[where, 0]


class Mixture:
    """Several policies as one policy with a memory: at the beginning of each episode, it draws which of them plays.

    Each is called for all worlds at once, but not while it plays in none of them.

    Attributes:
        names: The names of the policies.
        drawn: Index of the policy that plays in each world, int (worlds,).

    Args:
        entries: The policies with their weights; see `checked_entries` and `draw`. If a policy has a method `check`,
            that is called with `env`, and raises if the policy cannot play there.
        env: The worlds.
        agents: Indices of the agents of a world that they play, and whose observations they get.
        names: What the policies are called in errors and results; by default their names or paths.
        what: What their actions are called in errors, with {0} for the name.
        axes: What the shape of the actions is called in errors.
    """

    def __init__(
        self,
        entries: Entries,
        env: SurvivalVectorEnv,
        agents: Sequence[int],
        names: Sequence[str] = (),
        what: str = "the actions that {0} returned",
        axes: str = "(worlds, agents, actions)",
    ) -> None:
        given, self._weights = zip(*entries, strict=True)
        self.names = tuple(names) or tuple(getattr(policy, "__name__", str(policy)) for policy in given)
        self._policies = [self._playing(policy, env, agents) for policy in given]
        self._whats, self._axes = [what.format(name) for name in self.names], axes
        self._env, self._shape = env, (env.num_worlds, len(agents), len(env.action_sizes))
        self.drawn = np.zeros(env.num_worlds, int)

    @staticmethod
    def _playing(policy: str | Policy, env: SurvivalVectorEnv, agents: Sequence[int]) -> Policy:
        """Return the function that plays for an entry."""
        if isinstance(policy, str) and policy in POLICIES:
            return others_policy(policy, env, agents)
        playing: Any = load_saved(policy) if isinstance(policy, str) else policy
        if isinstance(policy, str):
            playing.key_by(env, agents)
        if callable(check := getattr(playing, "check", None)):
            check(env)
        return cast(Policy, playing)

    @property
    def forgetful(self) -> bool:
        """Whether nothing is drawn and no policy has a memory, so that `reset` need not be called."""
        return len(self.names) == 1 and not has_memory(self._policies[0])

    def reset(self, where: Array) -> None:
        """Draw who plays in the worlds `where`, bool (worlds,), as episodes begin there."""
        self.drawn[where] = draw(self._weights, *key_of(self._env.worlds, where))
        for policy in self._policies:
            if has_memory(policy) and where.all():
                OWNERS[id(policy)] = self
            tell(policy, where)

    def __call__(self, observations: Arrays) -> Actions:
        """The actions, integers (worlds, agents, actions). Raises ActionError."""
        if len(self.names) == 1:
            return self._actions(0, observations)
        joint = np.empty(self._shape, np.int64)
        for k in range(len(self.names)):
            if (here := self.drawn == k).any():
                joint[here] = self._actions(k, observations)[here]
        return joint

    def _actions(self, k: int, observations: Arrays) -> Actions:
        if has_memory(self._policies[k]) and OWNERS.get(id(self._policies[k])) is not self:
            raise UsageError(
                f"{self.names[k]} has a memory (a method reset), and has played in other worlds since it began to play "
                "here: give each environment a policy of its own"
            )
        actions, sizes = self._policies[k](observations), self._env.action_sizes
        return checked_actions(actions, self._shape, sizes, False, what=self._whats[k], axes=self._axes)


def _named(name: str, names: Collection[str]) -> str:
    """Return the name, or the path of a saved policy. Raises UsageError if it is neither."""
    name = policy_file(name, names)
    if name in names or is_saved(name):
        return name
    raise UsageError(f"{name or 'nothing'}: {did_you_mean(name, [*names, *models()], after=' ')}{_needed(names)}")


def _needed(names: Collection[str]) -> str:
    return f"{', '.join(names)} or a saved policy ({SAVED_AS}) is needed"


def _checked_weight(policy: object, weight: Any) -> float:
    try:
        number = math.nan if isinstance(weight, bool) else float(weight)
    except (TypeError, ValueError):
        number = math.nan
    if not 0 < number < math.inf:
        raise UsageError(
            f"the weight of {policy} is {weight!r}: a finite number above 0 is needed; leave out who has 0"
        )
    return number


def _same(policy: str | Policy) -> object:
    """Return a value that is equal for two spellings of the same path."""
    if isinstance(policy, str) and is_saved(policy) and policy not in models():
        return os.path.realpath(policy)
    return policy
