"""What is a whole number where somebody gives one."""

import math
from numbers import Integral
from typing import Any, TypeGuard


def as_whole(value: Any) -> Any:
    """The integer that a float without a fraction stands for, as 1e6 does; anything else as it is."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def is_whole(value: Any, least: float = -math.inf, most: float = math.inf) -> TypeGuard[int]:
    """Whether it is an integer of Python or numpy from `least` to `most`; a truth value is none."""
    return not isinstance(value, bool) and isinstance(value, Integral) and least <= int(value) <= most
