"""Distributions from which the numbers of a mechanic can be drawn, anew in every episode of every world."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..kernels.errors import NumberError
from ..kernels.integers import is_whole

UNIFORM, LOG_UNIFORM, INTEGERS, CHOICE, FREE = range(5)
MOST = 2**16  # maximum values of a choice
LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True, repr=False)
class Distribution:
    """A distribution from which a number is drawn; made by `uniform`, `log_uniform`, `integers`, `choice` or `free`.

    Attributes:
        kind: UNIFORM, LOG_UNIFORM, INTEGERS, CHOICE or FREE.
        values: The lowest and the highest value; for a choice, all values; for a free number, its default.
    """

    kind: int
    values: tuple[Any, ...]

    def __repr__(self) -> str:
        return f"{NAMES[self.kind]}({', '.join(map(repr, self.values))})"

    def __contains__(self, value: Any) -> bool:
        """Return whether `value` could be drawn."""
        if self.kind == CHOICE:
            given = tuple(value) if isinstance(value, (list, np.ndarray)) else value
            return any(_same(given, each) for each in self.values)
        if self.kind == FREE:
            listed = isinstance(value, (tuple, list, np.ndarray)) and len(value) == len(self.values[0])
            return listed and all(map(_is_real, value))
        real = _is_real(value)
        if self.kind == INTEGERS:
            return bool(real and float(value).is_integer() and self.values[0] <= value <= self.values[1])
        return bool(real and np.float32(self.values[0]) <= value <= np.float32(self.values[1]))

    def check(self, name: str, value: Any) -> None:
        """Raise NumberError unless the number of that name could be drawn as `value`."""
        if value not in self:
            what = f"{len(self.values[0])} finite numbers are needed" if self.kind == FREE else "take a value of that"
            raise NumberError(f"{name} = {value!r:.60}: it varies as {self!r:.80}; {what}")

    def sample(self, rng: np.random.Generator) -> Any:
        """Draw a value with numpy's generator, for levels that are made outside of worlds."""
        if self.kind in (CHOICE, FREE):
            return self.values[int(rng.integers(len(self.values)))]
        low, high = self.values
        if self.kind == INTEGERS:
            return int(rng.integers(low, high, endpoint=True))
        if self.kind == LOG_UNIFORM:
            return min(max(math.exp(rng.uniform(math.log(low), math.log(high))), low), high)
        return float(rng.uniform(low, high))

    def extremes(self) -> tuple[Any, ...]:
        """Return the lowest and the highest value; all values of a choice that is not among numbers; a free value."""
        plain = self.kind == CHOICE and all(isinstance(each, (int, float)) for each in self.values)
        return (min(self.values), max(self.values)) if plain else self.values

    def between(self) -> tuple[Any, ...]:
        """Return a value in the middle of a range; () for a choice and for a free number."""
        if self.kind in (CHOICE, FREE):
            return ()
        low, high = self.values
        return ((low + high) // 2 if self.kind == INTEGERS else low + (high - low) / 2,)


def uniform(low: float, high: float) -> Distribution:
    """Draw every value from `low` to `high` with equal probability. For numbers that are floats.

    Args:
        low: The lowest value, in the number's unit.
        high: The highest value.

    Raises:
        NumberError: The values are not finite numbers, or `low` is not below `high`.
    """
    return Distribution(UNIFORM, _ends("uniform", low, high))


def log_uniform(low: float, high: float) -> Distribution:
    """Draw uniformly on a log scale: 1 to 10 is as likely as 10 to 100. For numbers that are floats.

    Args:
        low: The lowest value, in the number's unit, above 0.
        high: The highest value.

    Raises:
        NumberError: The values are not finite numbers, or `low` is not below `high` or not above 0.
    """
    ends = _ends("log_uniform", low, high)
    if ends[0] <= 0:
        raise NumberError(f"log_uniform({low!r}, {high!r}): the lower end must be above 0")
    return Distribution(LOG_UNIFORM, ends)


def integers(low: int, high: int) -> Distribution:
    """Draw every integer from `low` to `high`, both included, with equal probability. For numbers that are integers.

    Args:
        low: The lowest value, in the number's unit.
        high: The highest value.

    Raises:
        NumberError: The values are not integers, or `low` is not below `high`.
    """
    if not (is_whole(low) and is_whole(high)):
        raise NumberError(f"integers({low!r}, {high!r}): two integers are needed")
    ends = _ends("integers", low, high)
    return Distribution(INTEGERS, (int(ends[0]), int(ends[1])))


def choice(*values: Any) -> Distribution:
    """Draw each of the values with equal probability; a value listed twice is twice as likely. For numbers of any type.

    Args:
        *values: Values that the number can have, at least two.

    Raises:
        NumberError: The number of values is too small or too large.
    """
    if not 2 <= len(values) <= MOST:
        raise NumberError(
            f"choice{values!r:.60} has {len(values)} values: 2 to {MOST} are needed, as in choice(1, 2, 3)"
        )
    return Distribution(CHOICE, tuple(map(in_python, values)))


def free(value: Any) -> Distribution:
    """Declare no draw: the number is `value` unless a world is given another value of the same length.

    For tuples that are declared as free, such as the floor plan of Walls: with env.set_numbers and levels, worlds can
    have any value that the mechanic accepts, not only one of a fixed list.

    Args:
        value: A tuple of finite numbers.

    Raises:
        NumberError: `value` is of another type.
    """
    if isinstance(value, str) or not np.ndim(value) or not all(map(_is_real, value)):
        raise NumberError(f"free({value!r:.60}): a tuple of finite numbers is needed")
    return Distribution(FREE, (tuple(map(float, value)),))


NAMES = ("uniform", "log_uniform", "integers", "choice", "free")


def _ends(name: str, low: Any, high: Any) -> tuple[float, float]:
    """Return both ends as Python's numbers. NumberError, which names `name`, unless they are finite and in order."""
    for each in (low, high):
        if not _is_real(each):
            raise NumberError(f"{name}({low!r}, {high!r}): two finite numbers are needed")
    if not low < high:
        raise NumberError(f"{name}({low!r}, {high!r}): the first must be below the second")
    return in_python(low), in_python(high)


def in_python(value: Any) -> Any:
    """Return a value without numpy's types, which JSON lacks; several values become a tuple."""
    found = value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
    return tuple(map(in_python, found)) if isinstance(found, (list, tuple)) else found


def _same(given: Any, value: Any) -> bool:
    """Return whether `given` is `value`, or both are the same float32, the type of floats in worlds."""
    if isinstance(value, tuple):
        return isinstance(given, tuple) and len(given) == len(value) and all(map(_same, given, value))
    if isinstance(given, bool) or isinstance(value, (bool, str)):
        return type(given) is type(value) and given == value
    return _is_real(given) and (given == value or (isinstance(value, float) and np.float32(given) == np.float32(value)))


def _is_real(value: Any) -> bool:
    """Return whether `value` is a number, and finite also as a float32."""
    real = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return real and bool(abs(value) <= LARGEST)
