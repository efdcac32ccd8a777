"""Tick records as bytes: the mode of each world in a tick, the joint actions of stepped ones, and a digest."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs import STEP, Action, Worlds

from ..core.spaces import published
from ..core.validation import Array
from ..errors import RecordingError
from .container import unpack

KEY_SIZE = 4  # numbers in a row of TickRecord.keys, apart from given numbers
MAX_JOINT_ACTIONS = 2**32


@dataclass(frozen=True)
class TickFormat:
    """The common part of all tick records of a recording."""

    worlds: int
    agents: int
    joint_actions: int  # number of joint actions of an agent
    digest_size: int  # count of numbers in a digest
    digest_period: int  # ticks until a digest is made of the same worlds again
    policy: np.dtype[Any] | None = None  # the record of a policy's probabilities, see policy_record; None: not recorded
    given: int = 0  # count of words of given numbers, see ecs.memory.numbers.Given

    @property
    def key_size(self) -> int:
        """Return the number of columns of TickRecord.keys."""
        return KEY_SIZE + self.given

    @property
    def code(self) -> np.dtype[Any]:
        """The smallest unsigned type that holds all joint actions."""
        return np.min_scalar_type(self.joint_actions - 1)

    @property
    def max_bytes(self) -> int:
        """Return the maximum bytes of a tick record."""
        each = self.code.itemsize + (self.policy.itemsize if self.policy else 0)
        return self.worlds * (1 + self.agents * each + 8 * self.key_size) + 2 * self.digest_size + 4


@dataclass(frozen=True)
class TickRecord:
    """Inputs of one tick of all worlds.

    mode: int8 (worlds,), SKIP, STEP or RESET. codes: joint actions (worlds that took a STEP, agents).
    keys: uint64 (n, 4 + given), worlds with new keys or other numbers right before the tick, as (row, seed, world,
        episode, words of numbers); see ecs.Clock and ecs.memory.numbers.Given.
    digest: uint16 (digest_size,), digest of the state after the tick; see digests.
    policy: TickFormat.policy (worlds that took a STEP, agents), the record of the policy; None: not recorded.
    """

    mode: Array
    codes: Array
    keys: Array
    digest: Array
    policy: Array | None = None

    @property
    def nbytes(self) -> int:
        """Return its bytes before packing."""
        thought = 0 if self.policy is None else self.policy.nbytes
        return self.mode.nbytes + self.codes.nbytes + self.keys.nbytes + self.digest.nbytes + 4 + thought


def encode_policies(records: Sequence[TickRecord]) -> bytes:
    """Return the bytes of the records of the policy in these ticks."""
    return b"".join(record.policy.tobytes() for record in records if record.policy is not None)


def encode_ticks(records: Sequence[TickRecord], form: TickFormat) -> bytes:
    """Return the bytes of `records` without `policy`; `decode_ticks` reads them."""
    digests = np.array([record.digest for record in records], "<u2").reshape(len(records), form.digest_size)
    changes = digests.copy()  # in differences, components that never change are zeros
    changes[form.digest_period :] -= digests[: -form.digest_period]
    parts = [record.mode for record in records]
    parts.append(np.array([len(record.keys) for record in records], "<u4"))
    parts += [record.keys.astype("<u8") for record in records if len(record.keys)]
    parts.append(np.ascontiguousarray(changes.T))
    parts += [record.codes.astype(form.code.newbyteorder("<")) for record in records]
    return b"".join(part.tobytes() for part in parts)


def decode_ticks(content: bytes, count: int, form: TickFormat, behind: bytes = b"") -> Iterator[TickRecord]:
    """Return the `count` tick records in `content`. Raises ValueError if it does not hold `count` in that format.

    behind: the packed result of encode_policies, if the format has a policy.
    """
    take = _ArrayReader(content)
    modes = take("i1", count, form.worlds)
    if ((modes < 0) | (modes > 2)).any():
        raise ValueError("modes")
    keyed = take("<u4", count).astype(np.int64)
    keys = take("<u8", int(keyed.sum()), form.key_size)
    if (keys[:, 0] >= form.worlds).any():
        raise ValueError("rows of worlds")
    digests = take("<u2", form.digest_size, count).T.copy()
    for start in range(min(form.digest_period, count)):
        np.cumsum(
            digests[start :: form.digest_period], axis=0, dtype=np.uint16, out=digests[start :: form.digest_period]
        )
    steps = (modes == STEP).sum(1)
    codes = take(form.code.newbyteorder("<").str, int(steps.sum()), form.agents)
    take.end()
    thoughts = _policies(behind, codes.shape, form)
    row, key = 0, 0
    for mode, step, many, digest in zip(modes, steps, keyed, digests, strict=True):
        thought = None if thoughts is None else thoughts[row : row + step]
        yield TickRecord(mode, codes[row : row + step], keys[key : key + many], digest, thought)
        row, key = row + int(step), key + int(many)


def _policies(behind: bytes, shape: tuple[int, ...], form: TickFormat) -> Array | None:
    """Return what the policy thought in each step, for all ticks one after the other. shape: (worlds, agents)."""
    if form.policy is None:
        return None
    size = form.policy.itemsize * math.prod(shape)
    content, _ = unpack(behind, size) if size else (b"", b"")
    return np.frombuffer(content, form.policy).reshape(shape)


class _ArrayReader:
    """A reader of arrays from the front of some bytes."""

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


class JointActions:
    """All actions of an agent as one number, 0 to 215 in the paper: mixed radix, in which the first action counts most.

    columns: (key, low, size) of each action. count: how many joint actions there are.
    """

    def __init__(self, worlds: Worlds) -> None:
        found = published(worlds, Action)
        self.columns = [(key, int(column.low), int(column.high - column.low) + 1) for key, _, _, column in found]
        self._sizes = [size for _, _, size in self.columns]
        self.count = math.prod(self._sizes)
        if self.count > MAX_JOINT_ACTIONS:
            raise RecordingError(f"{self.count} joint actions an agent: at most 2**32 can be recorded")
        code = np.min_scalar_type(self.count - 1)
        self._lows = np.array([low for _, low, _ in self.columns], np.int64).reshape(-1, 1, 1)
        radix = [math.prod(self._sizes[k + 1 :]) % 2**32 for k in range(len(self._sizes))]
        zero = sum(number * low for number, (_, low, _) in zip(radix, self.columns, strict=True)) % 2**32
        self._radix, self._zero = np.array(radix, np.uint32).astype(code), np.uint32(zero).astype(code)

    def encode(self, actions: Array) -> Array:
        """Return numbers (worlds, agents) for actions (actions, worlds, agents) as in the tables, from low to high.

        Computed modulo 2 to the power of the type's bits, so lows may be negative.
        """
        codes: Array = np.einsum("kwi,k->wi", actions.astype(self._radix.dtype), self._radix)
        codes -= self._zero
        return codes

    def decode(self, codes: Array) -> Array:
        """Return actions (actions, worlds, agents) for numbers (worlds, agents). ValueError if one stands for none."""
        if codes.size and int(codes.max()) >= self.count:
            raise ValueError(f"joint action {int(codes.max())} of {self.count}")
        if not self._sizes:
            return np.zeros((0, *codes.shape), np.int64)
        return np.stack(np.unravel_index(codes.astype(np.intp), self._sizes)) + self._lows
