"""The frame: all that a tick is told, as one row of int64 words, so that its functions hand on a single address.

An array takes WIDTH words: [address, stride from world to world in bytes, shape in one world ...]; a number takes one.
Which word holds what is decided once for a scenario's structure (`Plan`), while the source of its tick is written; the
words themselves (`Frame`) are those of one batch of worlds and one thread.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .component import Component
from .module import Module

DIMENSIONS = 4  # at most, of a column in one world
WIDTH = 2 + DIMENSIONS  # words of an array
STRIDE, BLOCK, MODE = 0, 1, 1 + WIDTH  # bytes of a world's block; the blocks as uint64; SKIP, STEP or RESET by world


@dataclass
class Plan:
    """What goes where: each method gives its argument the next free words and returns the first of them."""

    size: int = MODE + WIDTH
    columns: dict[int, tuple[type[Component], str]] = field(default_factory=dict)
    constants: dict[int, np.ndarray[Any, Any]] = field(default_factory=dict)
    memory: dict[int, tuple[Module, str]] = field(default_factory=dict)
    numbers: dict[int, int | float] = field(default_factory=dict)

    def column(self, component: type[Component], name: str) -> int:
        """A column, of which a kernel gets one world's share."""
        return self._take(self.columns, (component, name), WIDTH)

    def constant(self, array: np.ndarray[Any, Any]) -> int:
        """An array that is the same for all worlds."""
        return self._take(self.constants, np.ascontiguousarray(array), WIDTH)

    def scratch(self, module: Module, name: str) -> int:
        """The thread's own memory."""
        return self._take(self.memory, (module, name), WIDTH)

    def number(self, value: int | float) -> int:
        """An int, or a float that will be read as float32."""
        return self._take(self.numbers, value, 1)

    def _take(self, kind: dict[int, Any], content: Any, words: int) -> int:
        place = self.size
        kind[place] = content
        self.size += words
        return place


class Frame:
    """The words of one batch of worlds and one thread, and what they point to.

    words: int64, at `address`. objects: the thread's own memory by its first word, for kernels that run as Python.
    """

    def __init__(self, plan: Plan, worlds: Any, compiled: bool) -> None:
        self.words = np.zeros(plan.size, np.int64)
        self.words[STRIDE] = worlds.layout.world_bytes
        self._describe(BLOCK, worlds.block.view(np.uint64), 1)
        self._describe(MODE, worlds.mode, 0)
        for place, (component, name) in plan.columns.items():
            self._describe(place, getattr(worlds[component], name), 1)
        self.kept = plan.constants
        for place, array in plan.constants.items():
            self._describe(place, array, 0)
        self.objects = {place: module.scratch(name, worlds.dims) for place, (module, name) in plan.memory.items()}
        for place, array in self.objects.items() if compiled else ():
            self._describe(place, array, 0)
        for place, value in plan.numbers.items():
            self.words[place] = np.float32(value).view(np.int32) if isinstance(value, float) else value
        self.address = int(self.words.ctypes.data)

    def _describe(self, place: int, array: np.ndarray[Any, Any], axes: int) -> None:
        """axes: 1 if the first axis is the worlds, 0 if the array is the same for all."""
        shape = array.shape[axes:]
        stride = array.strides[0] if axes else 0
        self.words[place : place + 2 + len(shape)] = [array.ctypes.data, stride, *shape]
