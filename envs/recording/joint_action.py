"""Joint actions: all of an agent's actions as one number, 216 of them in the paper."""

import math
from typing import Any

import numpy as np

from outlast.ecs import Action, Worlds

from ..core.spaces import published
from ..errors import RecordingError

Array = np.ndarray[Any, Any]


class Joint:
    """Mixed-radix numbers of actions; the first action counts most.

    columns: (key, low, size) of each action. dtype: the smallest unsigned type that holds all joint actions.
    """

    def __init__(self, worlds: Worlds) -> None:
        found = published(worlds, Action)
        self.columns = [(key, int(column.low), int(column.high - column.low) + 1) for key, _, _, column in found]
        self.sizes = [size for _, _, size in self.columns]
        self.count = math.prod(self.sizes)
        if self.count > 2**32:
            raise RecordingError(f"{self.count} joint actions an agent: at most 2**32 can be recorded")
        self.dtype = np.min_scalar_type(self.count - 1)
        self._lows = np.array([low for _, low, _ in self.columns], np.int64).reshape(-1, 1, 1)
        radix = [math.prod(self.sizes[k + 1 :]) % 2**32 for k in range(len(self.sizes))]
        zero = sum(number * low for number, (_, low, _) in zip(radix, self.columns, strict=True)) % 2**32
        self._radix, self._zero = np.array(radix, np.uint32).astype(self.dtype), np.uint32(zero).astype(self.dtype)

    def encode(self, actions: Array) -> Array:
        """Numbers (worlds, agents) of actions (actions, worlds, agents) as the tables hold them, from low to high.

        All is modulo 2 to the bits of the type, so lows may be negative.
        """
        codes: Array = np.einsum("kwi,k->wi", actions.astype(self.dtype), self._radix)
        codes -= self._zero
        return codes

    def decode(self, codes: Array) -> Array:
        """Actions (actions, worlds, agents) from their numbers (worlds, agents). ValueError for one that is none."""
        if codes.size and int(codes.max()) >= self.count:
            raise ValueError(f"joint action {int(codes.max())} of {self.count}")
        if not self.sizes:
            return np.zeros((0, *codes.shape), np.int64)
        return np.stack(np.unravel_index(codes.astype(np.intp), self.sizes)) + self._lows
