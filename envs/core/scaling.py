"""Observations brought to about -1 to 1, for libraries whose networks take them as they are."""

import math
from collections.abc import Mapping

import numpy as np

from outlast.ecs.fields import Fields

from .validation import Array


def scaled(observations: Mapping[str, Array], fields: Fields) -> dict[str, Array]:
    """Observations divided by the scales of their fields; angles (rad) are wrapped to -pi to pi first.

    >>> seen = outlast.scaled(observations, env.fields)

    Args:
        observations: By key, float32 (..., length of a row), of any adapter.
        fields: `fields` of the environment that made them, or of its `base_env`.

    Returns:
        New arrays of the same shapes. Ids, masks and keys without fields are as they were; rows of zeros stay zero.

    Raises:
        KeyError: `fields` has a key that is not among the observations.
    """
    found = dict(observations)
    for key, named in fields.items():
        row: Array = np.array(observations[key], np.float32)
        for field in named.values():
            own = row[..., field.columns]
            if field.unit == "rad":
                own[...] = np.remainder(own + math.pi, math.tau) - math.pi
            own /= np.float32(field.scale)
        found[key] = row
    return found
