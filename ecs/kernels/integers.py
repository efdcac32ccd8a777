"""Integers among users' values."""

import math
from numbers import Integral
from typing import Any, TypeGuard


def as_whole(value: Any) -> Any:
    """Return the integer that a float without a fraction, such as 1e6, stands for; anything else unchanged."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def is_whole(value: Any, least: float = -math.inf, most: float = math.inf) -> TypeGuard[int]:
    """Return whether `value` is an integer of Python or numpy from `least` to `most`; bools are not."""
    return not isinstance(value, bool) and isinstance(value, Integral) and least <= int(value) <= most
