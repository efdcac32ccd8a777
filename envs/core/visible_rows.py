"""The rows of observations that agents see, as lists: without the padding, and with who sees each of them."""

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.ecs import CompiledUnits
from outlast.ecs.kernels.jit import compiled, kernel, loader, storer

from .validation import Array

MASK, OWNER, INDEX, START = "_mask", "_owner", "_index", "_start"  # what follows the key of the rows
KIND = 15  # numbers of a key: see `list_rows`
word, read = loader("int64"), loader("float32")
write, write_word, write_half = storer("float32"), storer("int64"), storer("int32")


@kernel
def list_rows(kinds: int, count: int) -> int:
    """List the rows of all keys.

    kinds: Address of int64 (count, KIND), addresses and numbers of each key:

    * values, float32 (worlds, agents, rows, columns), and the bytes from one to the next along each of the first axes;
    * masks, float32 (worlds, agents, rows), not 0 where a row is seen, and the same of these;
    * worlds, agents, rows, columns;
    * what is written: rows, owners, indices and starts, as VisibleRows returns them.
    """
    for k in range(count):
        at = kinds + 8 * KIND * k
        values, by_world, by_agent, by_row = word(at), word(at + 8), word(at + 16), word(at + 24)
        masks, mask_by_world, mask_by_agent = word(at + 32), word(at + 40), word(at + 48)
        worlds, agents, rows, columns = word(at + 56), word(at + 64), word(at + 72), word(at + 80)
        listed, owner, index, start = word(at + 88), word(at + 96), word(at + 104), word(at + 112)
        seen = 0
        for w in range(worlds):
            for i in range(agents):
                write_word(start, seen)
                start += 8
                mask, row = masks + w * mask_by_world + i * mask_by_agent, values + w * by_world + i * by_agent
                for r in range(rows):
                    if read(mask + 4 * r) != 0:
                        for c in range(0, 4 * columns, 4):
                            write(listed + c, read(row + r * by_row + c))
                        write_half(owner + 4 * seen, w * agents + i)
                        write_half(index + 4 * seen, r)
                        listed, seen = listed + 4 * columns, seen + 1
        write_word(start, seen)
    return 0


@functools.cache
def called(*kernels: Any) -> tuple[Any, ...]:
    """Return kernels of int64 arguments for Python to call; compiled once, and then loaded from the disk."""
    if not compiled():
        return kernels
    units = CompiledUnits([], {each.__name__: each for each in kernels}, {})
    units.load()
    return tuple(units.function(each.__name__) for each in kernels)


class VisibleRows:
    """Lists the rows that agents see, in memory of its own, which the next call overwrites.

    Attributes:
        kinds: The keys of observations with rows, those that have a mask.
    """

    def __init__(self, observations: Mapping[str, Array]) -> None:
        """Keep the observations, float32 (worlds, agents, ...) by key; each call reads what is in them then."""
        self.kinds = [key for key in observations if key + MASK in observations]
        masks = {key + MASK for key in self.kinds}
        self._all = {key: None if key in self.kinds else each for key, each in observations.items() if key not in masks}
        self._read, table = [], []
        self._room: dict[str, tuple[Array, ...]] = {}
        for key in self.kinds:
            values, mask = (np.asarray(observations[name], np.float32) for name in (key, key + MASK))
            if values.strides[-1:] != (4,) or mask.strides[-1:] != (4,):  # as if only one is seen of several
                values, mask = np.ascontiguousarray(values), np.ascontiguousarray(mask)
            worlds, self._agents, rows, columns = values.shape
            most, starts = worlds * self._agents * rows, np.zeros(worlds * self._agents + 1, np.int64)
            room = np.empty((most, columns), np.float32), np.empty(most, np.int32), np.empty(most, np.int32), starts
            places = values.ctypes.data, *values.strides[:3], mask.ctypes.data, *mask.strides[:2]
            table.append((*places, *values.shape, *(each.ctypes.data for each in room)))
            for each in room:
                each.flags.writeable = False
            self._room[key] = room
            self._read += [values, mask]
        self._table = np.array(table, np.int64)

    def __call__(self) -> dict[str, Array]:
        """Return the observations with lists in place of rows and masks.

        A key with rows, as `heals`, becomes `heals`, float32 (n, columns); `heals_owner`, int32 (n,), the agent that
        sees each row, world * agents + agent, in ascending order; `heals_index`, int32 (n,), its place among the padded
        rows of that agent; and `heals_start`, int64 (worlds * agents + 1,), where each agent's rows begin. All other
        keys stay as they are. Lists are read-only.
        """
        called(list_rows)[0](self._table.ctypes.data, len(self._table))
        found = dict[str, Array]()
        for key, values in self._all.items():
            if values is not None:
                found[key] = values
                continue
            listed, owner, index, start = self._room[key]
            count = start[-1]
            found[key], found[key + OWNER], found[key + INDEX] = listed[:count], owner[:count], index[:count]
            found[key + START] = start
        return found

    def of_world(self, lists: Mapping[str, Array], w: int) -> dict[str, Array]:
        """Return a copy of what `__call__` returned for one world, as if it were the only one."""
        found = {key: lists[key][w].copy() for key, values in self._all.items() if values is not None}
        for key in self.kinds:
            start = lists[key + START][w * self._agents : (w + 1) * self._agents + 1]
            for name in (key, key + OWNER, key + INDEX):
                found[name] = lists[name][start[0] : start[-1]].copy()
            found[key + OWNER] -= w * self._agents
            found[key + START] = start - start[0]
        return found
