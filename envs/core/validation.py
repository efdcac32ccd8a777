"""Checks of callers' arguments, before anything changes: counts, seeds, masks, actions; and tables of arrays."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.ecs.kernels.integers import is_whole

from ..errors import ActionError

Array = np.ndarray[Any, Any]

Seeds: TypeAlias = int | Sequence[int | None] | np.ndarray[Any, Any]
MAX_WORLDS = 10**12  # no memory holds more worlds, and their numbers fit into 64 bits
ROUNDING = 1e-6  # allowed error of continuous actions: scaling them to their range rounds


def check_count(name: str, value: Any, least: int, most: int | None = None) -> None:
    """Raise ValueError unless `value` is an integer of at least `least`, and at most `most`, if given."""
    if not is_whole(value, least):
        raise ValueError(f"{name} = {value!r}: an integer >= {least} is needed")
    if most is not None and int(value) > most:
        raise ValueError(f"{name} = {value!r}: an integer <= {most:,} is needed")


def check_choice(name: str, value: Any, allowed: tuple[Any, ...], cure: str = "") -> None:
    """Raise ValueError unless `value` is one of those allowed."""
    if not isinstance(value, (str, type(None))) or value not in allowed:
        raise ValueError(f"{name} = {value!r}: allowed are {', '.join(map(repr, allowed))}{cure}")


def check_flags(**flags: Any) -> None:
    """Raise ValueError unless all are True or False; a text such as "no" would count as True."""
    for name, value in flags.items():
        if not isinstance(value, (bool, np.bool_)):
            raise ValueError(f"{name} = {value!r}: allowed are True and False")


def autoreset_mode(mode: Any) -> AutoresetMode:
    """Return the mode, or the mode of that value. Raises ValueError for anything else."""
    try:
        return AutoresetMode(mode)
    except ValueError:
        known = ", ".join(f"AutoresetMode.{mode.name} ({mode.value!r})" for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode = {mode!r}: allowed are {known}") from None


def keys(seed: Any, count: int, first_world: int) -> tuple[Array, Array, Array]:
    """Return the keys of the worlds' random numbers; see SurvivalVectorEnv.reset.

    These are seeds and worlds, uint64 (count,), and whether worlds get them, bool (count,); the others continue.
    """
    given = np.asarray(seed, object)
    if given.ndim == 0:
        return np.full(count, _seed(seed)), (first_world + np.arange(count)).astype(np.uint64), np.ones(count, bool)
    if given.shape != (count,):
        raise ValueError(f"seed has shape {given.shape}: one integer, or one for each of {count} worlds")
    seeds = np.array([0 if each is None else _seed(each) for each in given], np.uint64)
    return seeds, np.zeros(count, np.uint64), np.array([each is not None for each in given], bool)


def _seed(value: Any) -> np.uint64:
    if not is_whole(value, 0, 2**64 - 1):
        raise ValueError(f"seed = {value!r}: an integer from 0 to 2**64 - 1 is needed")
    return np.uint64(int(value))


def reset_mask(options: Any, count: int) -> Array:
    """Return options["reset_mask"], bool (count,); all worlds without it. Other keys, such as a typo: ValueError."""
    if not isinstance(options, dict | None) or {*(options or ())} - {"reset_mask"}:
        raise ValueError(f"options = {options!r}: a dict with no other key than reset_mask is needed")
    return world_mask("reset_mask", (options or {}).get("reset_mask"), count)


def world_mask(name: str, given: Any, count: int) -> Array:
    """Return a mask of worlds, bool (count,); all if it is None. ValueError, which names it, for anything else."""
    if given is None:
        return np.ones(count, bool)
    mask: Array = as_array(given)
    if mask.dtype != bool or mask.shape != (count,) or not mask.any():
        raise ValueError(
            f"{name} must be bool, of shape ({count},), with at least one True; "
            f"got {mask.dtype} of shape {mask.shape} with {int(np.count_nonzero(mask))} true"
        )
    return mask


def checked_actions(
    given: Any,
    shape: tuple[int, ...],
    sizes: Array,
    ranges: bool = True,
    *,
    what: str = "actions",
    axes: str = "(worlds, agents, actions)",
    who: str = "agent {1} in world {0}",
    keys: Sequence[str] = (),
) -> Array:
    """Return the actions that a caller passed, integers of any type in an array or nested lists, as an array.

    The actions of one agent are the last axis; `sizes` has the number of values of each. Raises ActionError for the
    wrong shape or type or, with `ranges`, an action that is not from 0 to its size - 1. Names in errors: `what` of
    `given`, `axes` of its axes, `who` of an agent, a format with all indices but the last, and `keys` of its actions.
    """
    actions = _shaped(given, shape, "iu", "integers", what, axes)
    if not ranges:
        return actions
    if sizes.max() <= np.iinfo(actions.dtype).max:
        # read as unsigned, a negative number exceeds all sizes
        unsigned = np.dtype(actions.dtype.str.replace("i", "u"))
        bad = actions.view(unsigned) >= sizes.astype(unsigned)
    else:  # sizes do not fit into the type of the actions
        bad = (actions < 0) | (actions >= sizes)
    if bad.any():
        named, k, value = _first(bad, actions, who, keys)
        raise ActionError(f"{named} is {value}: 0 to {sizes[k] - 1} is allowed")
    return actions


def checked_fractions(
    given: Any, shape: tuple[int, ...], *, what: str, axes: str, who: str, keys: Sequence[str]
) -> Array:
    """Return the continuous actions that a caller passed, from -1 to 1, as float32; see `checked_actions`."""
    actions = _shaped(given, shape, "f", "floats", what, axes).astype(np.float32)
    bad = ~(np.abs(actions) <= 1 + ROUNDING)  # in this form it is also true for NaN
    if bad.any():
        named, _, value = _first(bad, actions, who, keys)
        raise ActionError(f"{named} is {value:.7g}: -1 to 1 is allowed; numpy.clip brings others there")
    return actions


def _shaped(given: Any, shape: tuple[int, ...], kinds: str, needed: str, what: str, axes: str) -> Array:
    """Return `given` as an array, if it has that shape and one of numpy's `kinds`. Raises ActionError otherwise."""
    actions: Array = as_array(given)
    if actions.shape != shape:
        raise ActionError(f"{what} have shape {actions.shape}: {axes} = {shape} is needed")
    if actions.dtype.kind not in kinds:
        raise ActionError(f"{what} are {actions.dtype}: {needed} are needed")
    return actions


def _first(bad: Array, actions: Array, who: str, keys: Sequence[str]) -> tuple[str, int, Any]:
    """Return the first bad action of (..., actions): its name, its index among an agent's actions, its value."""
    *agent, k = index = tuple(int(found[0]) for found in np.nonzero(bad))
    return f"action {k}{f' ({keys[k]})' if keys else ''} of {who.format(*agent)}", k, actions[index]


def joined(tables: Sequence[Mapping[str, Any]]) -> dict[str, Array]:
    """Concatenate tables, arrays by name, masked or not, that have the same names; {} without any."""
    masked = {name: isinstance(array, np.ma.MaskedArray) for name, array in (tables[0] if tables else {}).items()}
    return {name: (np.ma if m else np).concatenate([each[name] for each in tables]) for name, m in masked.items()}


def as_array(value: Any) -> Array:
    """Return `value` as an array; lists of unequal length become an array of objects, which shape or type will refuse.

    Raises ActionError for a tensor that numpy cannot read, such as one with a gradient or on a GPU.
    """
    try:
        return np.asarray(value)
    except ValueError:
        return np.empty(len(value), object)
    except (TypeError, RuntimeError) as error:
        raise ActionError(f"{type(value).__name__} cannot be read as an array: {error}") from error
