"""Runs of the tick as bytes: what each world did, the joint actions of those that took a step, and digests."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs import STEP

Array = np.ndarray[Any, Any]

KEY = 4  # numbers in a row of Run.keys


@dataclass(frozen=True)
class Shape:
    """What all runs of a recording have in common. code: the type of a joint action (see joint)."""

    worlds: int
    agents: int
    code: np.dtype[Any]
    digests: int  # numbers in a digest
    repeat: int  # runs until a digest is made in the same way again

    @property
    def most(self) -> int:
        """Bytes that a run takes, at most."""
        return self.worlds * (1 + self.agents * self.code.itemsize + 8 * KEY) + 2 * self.digests + 4


@dataclass(frozen=True)
class Run:
    """One run of the tick.

    mode: int8 (worlds,), SKIP, STEP or RESET. codes: joint actions (worlds that took a STEP, agents).
    keys: uint64 (n, 4), worlds that were keyed anew just before, as (row, seed, world, episode); see ecs.Clock.
    digest: uint16 (digests,), of the state after it; see digests.
    """

    mode: Array
    codes: Array
    keys: Array
    digest: Array

    @property
    def nbytes(self) -> int:
        """Bytes that it takes, before they are packed."""
        return self.mode.nbytes + self.codes.nbytes + self.keys.nbytes + self.digest.nbytes + 4


def pack(runs: Sequence[Run], shape: Shape) -> bytes:
    """The bytes of `runs`; `unpack` reads them."""
    digests = np.array([run.digest for run in runs], "<u2").reshape(len(runs), shape.digests)
    changes = digests.copy()  # components that never change become zeros
    changes[shape.repeat :] -= digests[: -shape.repeat]
    parts = [run.mode for run in runs]
    parts.append(np.array([len(run.keys) for run in runs], "<u4"))
    parts += [run.keys.astype("<u8") for run in runs if len(run.keys)]
    parts.append(np.ascontiguousarray(changes.T))
    parts += [run.codes.astype(shape.code.newbyteorder("<")) for run in runs]
    return b"".join(part.tobytes() for part in parts)


def unpack(content: bytes, count: int, shape: Shape) -> Iterator[Run]:
    """The `count` runs of `content`. Raises ValueError if it is not `count` runs of that shape."""
    take = _Reader(content)
    modes = take("i1", count, shape.worlds)
    if ((modes < 0) | (modes > 2)).any():
        raise ValueError("modes")
    keyed = take("<u4", count).astype(np.int64)
    keys = take("<u8", int(keyed.sum()), KEY)
    if (keys[:, 0] >= shape.worlds).any():
        raise ValueError("rows of worlds")
    digests = take("<u2", shape.digests, count).T.copy()
    for start in range(min(shape.repeat, count)):
        np.cumsum(digests[start :: shape.repeat], axis=0, dtype=np.uint16, out=digests[start :: shape.repeat])
    steps = (modes == STEP).sum(1)
    codes = take(shape.code.newbyteorder("<").str, int(steps.sum()), shape.agents)
    take.end()
    row, key = 0, 0
    for mode, step, many, digest in zip(modes, steps, keyed, digests, strict=True):
        yield Run(mode, codes[row : row + step], keys[key : key + many], digest)
        row, key = row + int(step), key + int(many)


class _Reader:
    """Takes arrays off the front of some bytes."""

    def __init__(self, content: bytes) -> None:
        self.content, self.offset = content, 0

    def __call__(self, dtype: str, *shape: int) -> Array:
        kind, count = np.dtype(dtype), int(np.prod(shape, dtype=object))
        if count * kind.itemsize > len(self.content) - self.offset:
            raise ValueError("too short")
        array: Array = np.frombuffer(self.content, kind, count, self.offset).reshape(shape)
        self.offset += array.nbytes
        return array

    def end(self) -> None:
        if self.offset != len(self.content):
            raise ValueError("too long")
