"""Observations scaled to about -1 to 1, for libraries whose networks do not scale them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from outlast.ecs.declarations.fields import Field, Fields

from .validation import Array

LIMIT = 10.0  # scaled values without a known range are clipped to it, as normalising wrappers do


@dataclass(frozen=True)
class Scale:
    """Scales of the columns of a row.

    Attributes:
        divisors: Divisors of the columns, float32 (columns,).
        angles: Indices of columns in radians, which are wrapped to -pi to pi first.
        unlimited: Indices of columns of unknown range, which are clipped to -LIMIT to LIMIT.
    """

    divisors: Array
    angles: Array
    unlimited: Array

    @classmethod
    def of(cls, fields: Mapping[str, Field], columns: int) -> "Scale":
        """Return the scale of a row with these fields, for any ranges; without fields, a row is not scaled."""
        divisors, angle = np.ones(columns, np.float32), np.zeros(columns, bool)
        for field in fields.values():
            divisors[field.columns], angle[field.columns] = field.scale, field.unit == "rad"
        return cls(divisors, np.flatnonzero(angle), np.zeros(0, int))

    def limited(self, low: Array, high: Array) -> tuple["Scale", Array, Array]:
        """Return the scale, clipped where one of the ends (..., columns) is infinite, and the ends of the result."""
        low, high = low.copy(), high.copy()
        low[..., self.angles], high[..., self.angles] = -np.float32(math.pi), np.float32(math.pi)
        endless = np.isinf(low) | np.isinf(high)
        scale = Scale(self.divisors, self.angles, np.flatnonzero(endless.any(axis=tuple(range(endless.ndim - 1)))))
        for ends, limit in ((low, -LIMIT), (high, LIMIT)):
            ends /= self.divisors
            at = ends[..., scale.unlimited]
            ends[..., scale.unlimited] = np.where(np.isinf(at), limit, np.clip(at, -LIMIT, LIMIT))
        return scale, low, high

    def apply(self, rows: Array) -> None:
        """Scale rows (..., columns) in place."""
        if len(self.angles):
            rows[..., self.angles] = np.remainder(rows[..., self.angles] + math.pi, math.tau) - math.pi
        rows /= self.divisors
        if len(self.unlimited):
            rows[..., self.unlimited] = np.clip(rows[..., self.unlimited], -LIMIT, LIMIT)


def joined(scales: list[Scale]) -> Scale:
    """Return the scale of rows that are concatenated into one."""
    starts = np.cumsum([0, *(len(scale.divisors) for scale in scales)])[:-1]
    shifted = [(scale.angles + at, scale.unlimited + at) for scale, at in zip(scales, starts, strict=True)]
    angles, unlimited = (np.concatenate(each) for each in zip(*shifted, strict=True))
    return Scale(np.concatenate([scale.divisors for scale in scales]), angles, unlimited)


def scaled(observations: Mapping[str, Array], fields: Fields) -> dict[str, Array]:
    """Divide observations by the scales of their fields; angles (rad) are wrapped to -pi to pi first.

    >>> seen = outlast.adapters.scaled(observations, env.fields)

    Environments with scaled=True do that themselves, and also clip columns without bounds.

    Args:
        observations: By key, float32 (..., length of a row), from any adapter.
        fields: `fields` of the environment that made them, or of its `base_env`.

    Returns:
        New arrays of the same shapes. Ids, masks and keys without fields are unchanged; rows of zeros stay zero.

    Raises:
        KeyError: `fields` has a key that is not among the observations.
    """
    found = dict(observations)
    for key, named in fields.items():
        row: Array = np.array(observations[key], np.float32)
        Scale.of(named, row.shape[-1]).apply(row)
        found[key] = row
    return found
