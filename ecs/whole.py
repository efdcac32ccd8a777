"""What is a whole number where somebody gives one."""

import math
from numbers import Integral
from typing import Any, TypeGuard


def is_whole(value: Any, least: float = -math.inf, most: float = math.inf) -> TypeGuard[int]:
    """Whether it is an integer of Python or numpy from `least` to `most`; a truth value is none."""
    return not isinstance(value, bool) and isinstance(value, Integral) and least <= int(value) <= most
