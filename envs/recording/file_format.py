"""The file of a recording: a line of text, then chunks, each with its length and checksums.

======== =========================================================================================
part     holds
======== =========================================================================================
MAGIC    the line "outlast recording 1"
chunk    a header of 40 bytes, then the content: tag, bytes of the content stored and unpacked, tick records in it,
         number of the first of them, blake2b-8 of the stored content, blake2b-8 of the 32 bytes before
HEAD     the first chunk: JSON with a description of the recording (see `read_header`)
RECORDS  many chunks: tick records (see `encode_ticks`); after them, packed separately, what the policy thought in
         these ticks, if the header has a policy. Earlier readers do not look beyond the tick records.
DONE     the last chunk, without content: it marks a recording that was closed and is complete
======== =========================================================================================

Everything is little-endian; contents are packed with zlib. Chunks are written one after the other, so if a writer was
killed, the file ends within a chunk or without DONE, and all chunks before that are complete.
"""

import contextlib
import hashlib
import json
import math
import os
import struct
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from outlast.ecs import STEP, Action, Worlds

from ..core.spaces import published
from ..core.validation import Array
from ..errors import RecordingError
from ..scenarios.fingerprint import is_fingerprint, is_word
from ..storage import inputs
from ..storage.interrupts import interrupts_held
from ..storage.outputs import add, check_file, remove, temporary_path

MAGIC = b"outlast recording 1\n"
HEAD, RECORDS, DONE = b"HEAD", b"RUNS", b"DONE"
FIELDS = struct.Struct("<4sIIIQ8s")  # tag, stored, unpacked, ticks, first, checksum of the content
CHECKSUM_SIZE = 8
HEADER_SIZE = FIELDS.size + CHECKSUM_SIZE
LARGEST_CHUNK = 2**30  # bytes of the stored content; those of a million worlds are some megabytes
MAX_COUNT = 2**31  # worlds or agents
MAX_HEADER = 2**20  # bytes of the header's JSON
MAX_POLICY_ENTRIES = 2**16  # probabilities, or rows of attention, of an agent
MAX_JOINT_ACTIONS = 2**32
MAX_PENDING_BYTES = 2**19  # of waiting tick records; a killed process loses them
MAX_PENDING_SECONDS = 5.0  # maximum wait of tick records, which are then written with the next tick
FLAGS = os.O_WRONLY | getattr(os, "O_BINARY", 0)
KEY_SIZE = 4  # numbers in a row of TickRecord.keys, apart from given numbers


@dataclass(frozen=True)
class Chunk:
    """The header of a chunk.

    offset: position of the chunk in the file. stored, unpacked: size of its content in bytes. ticks: how many tick
    records it holds. first: the number of the first of them.
    """

    offset: int
    tag: bytes
    stored: int
    unpacked: int
    ticks: int
    first: int
    checksum: bytes

    @property
    def end(self) -> int:
        """Offset of the next chunk."""
        return self.offset + HEADER_SIZE + self.stored


def encode_chunk(tag: bytes, content: bytes, ticks: int, first: int, behind: bytes = b"") -> bytes:
    """Return the bytes of a chunk. behind: more content, which is packed separately and may be left unread.

    zlib only looks for matches at distance one (Z_RLE): random actions have no others, and otherwise it is fastest.
    """
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    stored = packer.compress(content) + packer.flush() + (zlib.compress(behind, 1) if behind else b"")
    fields = FIELDS.pack(tag, len(stored), len(content), ticks, first, _checksum(stored))
    return fields + _checksum(fields) + stored


def read_chunks(file: BinaryIO, path: str, size: int) -> Iterator[Chunk]:
    """Return the complete chunks in the `size` bytes of a file, after checking their contents. Ignores a cut-off end.

    Raises RecordingError if the file is damaged, not a recording, or a chunk does not follow the previous one.
    """
    found, name = file.read(len(MAGIC)), MAGIC.rsplit(b" ", 1)[0]
    if found != MAGIC and found.startswith(name) and found.endswith(b"\n"):
        version = found[len(name) :].strip().decode(errors="replace")
        raise RecordingError(f"{path} has version {version} of the format: this outlast reads version 1")
    if found != MAGIC:
        raise RecordingError(f"{path} is not a recording: it does not begin with {MAGIC.decode().strip()!r}")
    offset, ticks = len(MAGIC), 0
    while offset + HEADER_SIZE <= size:
        file.seek(offset)
        header = file.read(HEADER_SIZE)
        if len(header) < HEADER_SIZE or _checksum(header[: FIELDS.size]) != header[FIELDS.size :]:
            raise damaged(path, offset)
        chunk = Chunk(offset, *FIELDS.unpack(header[: FIELDS.size]))
        if chunk.stored > LARGEST_CHUNK:
            most = f"at most {LARGEST_CHUNK:,} are possible"
            raise RecordingError(f"{path}: the chunk at byte {offset} has {chunk.stored:,} bytes; {most}")
        if chunk.end > size:
            break
        read_stored(file, path, chunk)
        allowed = (HEAD, RECORDS, DONE) if offset == len(MAGIC) else (RECORDS, DONE)
        if chunk.tag not in allowed or chunk.first != ticks or (chunk.ticks > 0) != (chunk.tag == RECORDS):
            raise RecordingError(f"{path}: the chunk at byte {offset} does not follow the previous one")
        yield chunk
        offset, ticks = chunk.end, ticks + chunk.ticks
        if chunk.tag == DONE and offset < size:
            raise RecordingError(f"{path}: {size - offset} bytes follow its end at byte {offset}")


def read_stored(file: BinaryIO, path: str, chunk: Chunk) -> bytes:
    """Return the content of a chunk, still packed. Raises RecordingError if it is damaged."""
    file.seek(chunk.offset + HEADER_SIZE)
    stored = file.read(chunk.stored)
    if _checksum(stored) != chunk.checksum:
        raise damaged(path, chunk.offset)
    return stored


def read_content(file: BinaryIO, path: str, chunk: Chunk, max_bytes: int) -> tuple[bytes, bytes]:
    """Return the content of a chunk, unpacked, and the content after it, still packed; see `unpack`.

    Raises RecordingError if it is damaged or larger than `max_bytes`.
    """
    stored = read_stored(file, path, chunk)
    if chunk.unpacked > max_bytes:
        raise RecordingError(f"{path}: the chunk at byte {chunk.offset} claims to hold {chunk.unpacked} bytes")
    try:
        return unpack(stored, chunk.unpacked)
    except ValueError:
        raise damaged(path, chunk.offset) from None


def unpack(stored: bytes, size: int) -> tuple[bytes, bytes]:
    """Return `size` bytes of content, and the content after it. ValueError if there are more or fewer bytes."""
    packer = zlib.decompressobj()
    try:
        content = packer.decompress(stored, size + 1)
    except zlib.error as error:
        raise ValueError(str(error)) from None
    if len(content) != size or not packer.eof:
        raise ValueError(f"it is not {size} bytes")
    return content, packer.unused_data


def damaged(path: str, offset: int) -> RecordingError:
    """Return the error for a chunk with other bytes than were written."""
    return RecordingError(
        f"{path} is damaged at byte {offset}: a checksum does not fit. Everything before that byte is complete: "
        "a copy that ends there can be replayed, if it has ticks"
    )


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=CHECKSUM_SIZE).digest()


def read_header(file: BinaryIO, path: str, chunk: Chunk) -> dict[str, Any]:
    """Return the description of a recording, in which all values have valid types. Raises RecordingError otherwise."""
    content, _ = read_content(file, path, chunk, MAX_HEADER)
    with contextlib.suppress(*inputs.BROKEN_JSON):
        header = json.loads(content)
        if _is_header(header):
            return dict(header)
    raise RecordingError(f"{path} is not a recording: its header does not describe a recording")


def _is_header(header: Any) -> bool:
    digests, actions = header["digests"], header["actions"]
    numbers = [header["worlds"], header["agents"], header["first_world"], digests["worlds"], digests["repeat"]]
    numbers += [header["given"], header.get("episodes", 0)]  # the latter is missing in some recordings
    names = [header["outlast"], header["machine"], *header["modules"], *digests["components"]]
    return bool(
        all(type(number) is int and number >= 0 for number in numbers)
        and 1 <= header["worlds"] <= MAX_COUNT
        and 1 <= header["agents"] <= MAX_COUNT
        and header["first_world"] < 2**62
        and all(map(is_word, names))
        and type(header["modules"]) is type(digests["components"]) is list
        and is_fingerprint(header["scenario"])
        and all(is_word(key) and type(low) is type(size) is int and size >= 1 for key, low, size in actions)
        and math.prod(size for _, _, size in actions) <= MAX_JOINT_ACTIONS
        and ("policy" not in header or _is_policy(actions, header["policy"]))
        and ("played" not in header or _is_played(header["played"], header["agents"]))
        and digests["worlds"] >= 1
        and digests["repeat"] >= 1
        and header["given"] <= MAX_HEADER
        and header.get("episodes", 0) <= MAX_COUNT
        and len(digests["components"]) <= MAX_HEADER
    )


def _is_policy(actions: Any, policy: Any) -> bool:
    counts = [count for key, count in policy["entities"] if is_word(key) and type(count) is int and count >= 0]
    values = sum(size for _, _, size in actions)
    return len(counts) == len(policy["entities"]) and max(values, sum(counts)) <= MAX_POLICY_ENTRIES


def _is_played(given: Any, agents: int) -> bool:
    return given.keys() == {"agent", "others"} and is_word(given["others"]) and given["agent"] in range(agents)


def policy_dtype(actions: Any, policy: Any) -> np.dtype[Any]:
    """Return the type of the record of a policy's choice. actions, policy: as in the header of a recording.

    There is a row for each agent and tick. It is about the agent's observation before the tick:

    ============= ======= =========================================================================================
    value         float32 the critic's estimate, in the units that it was trained in; NaN: it has none
    probabilities float16 of each value of each action, one action after the other; NaN: not an agent of this policy
    attention     float16 share of each row of `entities`, kind after kind; together at most 1; NaN: it has none
    ============= ======= =========================================================================================
    """
    values, rows = sum(size for _, _, size in actions), sum(count for _, count in policy["entities"])
    return np.dtype([("value", "<f4"), ("probabilities", "<f2", (values,)), ("attention", "<f2", (rows,))])


class TickFormat:
    """The common part of all tick records of a recording, as its header determines it.

    code: the smallest unsigned type that holds all joint actions. digest_size: count of numbers in a digest.
    digest_period: ticks until a digest is made of the same worlds again. policy: see policy_dtype; None: not recorded.
    key_size: columns of TickRecord.keys. max_bytes: of a tick record, at most.
    """

    def __init__(self, header: dict[str, Any]) -> None:
        actions, digests = header["actions"], header["digests"]
        self.worlds, self.agents, self.key_size = header["worlds"], header["agents"], KEY_SIZE + header["given"]
        self.code = np.min_scalar_type(math.prod(size for _, _, size in actions) - 1)
        self.digest_size, self.digest_period = len(digests["components"]), digests["repeat"]
        self.policy = policy_dtype(actions, header["policy"]) if "policy" in header else None
        each = self.code.itemsize + (self.policy.itemsize if self.policy else 0)
        self.max_bytes = self.worlds * (1 + self.agents * each + 8 * self.key_size) + 2 * self.digest_size + 4


@dataclass(frozen=True)
class TickRecord:
    """Inputs of one tick of all worlds.

    mode: int8 (worlds,), SKIP, STEP or RESET. codes: joint actions (worlds that took a STEP, agents).
    keys: uint64 (n, 4 + given), worlds with new keys or other numbers right before the tick, as (row, seed, world,
        episode, words of numbers); see ecs.Clock and ecs.memory.numbers.Given.
    digest: uint16 (digest_size,), digest of the state after the tick; see recorder.
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
        parts = self.mode, self.codes, self.keys, self.digest, self.policy
        return sum(part.nbytes for part in parts if part is not None) + 4


def encode_ticks(records: Sequence[TickRecord], form: TickFormat) -> tuple[bytes, bytes]:
    """Return the bytes of `records` without `policy`, which `decode_ticks` reads, and those of `policy`."""
    digests = np.array([record.digest for record in records], "<u2").reshape(len(records), form.digest_size)
    changes = digests.copy()  # in differences, components that never change are zeros
    changes[form.digest_period :] -= digests[: -form.digest_period]
    parts = [record.mode for record in records]
    parts.append(np.array([len(record.keys) for record in records], "<u4"))
    parts += [record.keys.astype("<u8") for record in records if len(record.keys)]
    parts.append(np.ascontiguousarray(changes.T))
    parts += [record.codes.astype(form.code.newbyteorder("<")) for record in records]
    thoughts = [record.policy for record in records if record.policy is not None]
    return b"".join(part.tobytes() for part in parts), b"".join(thought.tobytes() for thought in thoughts)


def decode_ticks(content: bytes, count: int, form: TickFormat, behind: bytes = b"") -> Iterator[TickRecord]:
    """Return the `count` tick records in `content`. Raises ValueError if it does not hold `count` in that format.

    behind: the packed bytes of `policy`, if the format has a policy.
    """
    offset = 0

    def take(dtype: str, *shape: int) -> Array:
        nonlocal offset
        kind, size = np.dtype(dtype), math.prod(shape)
        if size * kind.itemsize > len(content) - offset:
            raise ValueError("too short")
        array: Array = np.frombuffer(content, kind, size, offset).reshape(shape)
        offset += array.nbytes
        return array

    modes = take("i1", count, form.worlds)
    if ((modes < 0) | (modes > 2)).any():
        raise ValueError("modes")
    keyed = take("<u4", count).astype(np.int64)
    keys = take("<u8", int(keyed.sum()), form.key_size)
    if (keys[:, 0] >= form.worlds).any():
        raise ValueError("rows of worlds")
    digests, period = take("<u2", form.digest_size, count).T.copy(), form.digest_period
    for start in range(min(period, count)):
        np.cumsum(digests[start::period], axis=0, dtype=np.uint16, out=digests[start::period])
    steps = (modes == STEP).sum(1)
    codes = take(form.code.newbyteorder("<").str, int(steps.sum()), form.agents)
    if offset != len(content):
        raise ValueError("too long")
    thoughts: Array | None = None
    if form.policy is not None:
        size = form.policy.itemsize * math.prod(codes.shape)
        thoughts = np.frombuffer(unpack(behind, size)[0] if size else b"", form.policy).reshape(codes.shape)
    row, key = 0, 0
    for mode, step, many, digest in zip(modes, steps, keyed, digests, strict=True):
        thought = None if thoughts is None else thoughts[row : row + step]
        yield TickRecord(mode, codes[row : row + step], keys[key : key + many], digest, thought)
        row, key = row + int(step), key + int(many)


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


class RecordingWriter:
    """A file to which chunks of tick records are appended. Chunks that were written are never touched again.

    Its state is replaced at once when a chunk is in the file. So Ctrl-C, at any time, neither loses ticks nor writes
    them twice: an incomplete chunk is written again from its beginning. It is a temporary file until the first tick is
    in it, which is written at once: so no file without ticks is in the way of the next command.
    """

    def __init__(self, path: Path, header: dict[str, Any]) -> None:
        self._form, self._owner, self._since = TickFormat(header), os.getpid(), -math.inf
        target = Path(os.path.realpath(check_file(path, "recordings", RecordingError, new=True)))
        self._target: Path | None = target  # where the file goes; None: it exists
        self._place = temporary_path(target)
        # offset of the end, ticks in the file, tick records that wait
        self._state: tuple[int, int, list[TickRecord]] = (0, 0, [])
        self._pending_bytes, self._descriptor = 0, -1
        try:
            self._descriptor = os.open(self._place, FLAGS | os.O_CREAT | os.O_EXCL, 0o666)
            self._write(MAGIC + encode_chunk(HEAD, json.dumps(header).encode(), 0, 0), 0)
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from None
        finally:
            if not self._state[0]:
                self.abandon()

    @property
    def written(self) -> int:
        """Ticks in the file, if it exists."""
        return self._state[1] if self._target is None else 0

    @property
    def ticks(self) -> int:
        """Ticks in the file and waiting ones."""
        return self._state[1] + len(self._state[2])

    def append(self, record: TickRecord) -> None:
        """Append a tick. Raises OSError if the file cannot be written."""
        self._state[2].append(record)
        self._pending_bytes += record.nbytes
        if self._pending_bytes >= MAX_PENDING_BYTES or time.monotonic() - self._since > MAX_PENDING_SECONDS:
            self._flush()

    def close(self) -> None:
        """Write waiting ticks and DONE, and close the file. Raises OSError, after closing, if it cannot be written."""
        if os.getpid() != self._owner:
            os.close(self._descriptor)
            return
        try:
            self._flush()
            self._write(encode_chunk(DONE, b"", 0, self.ticks), 0)
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file, and leave only complete chunks in it; without ticks, leave no file."""
        if self._descriptor >= 0:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._state[0])
            os.close(self._descriptor)
        if self._target is not None:
            remove(self._place)

    def _flush(self) -> None:
        _, first, pending = self._state
        if pending:
            content, thoughts = encode_ticks(pending, self._form)
            self._write(encode_chunk(RECORDS, content, len(pending), first, thoughts), len(pending))
            if self._target is not None:
                with interrupts_held():  # the file gets its name, or OSError, as if another process has written it
                    os.close(self._descriptor)  # on Windows, files that are open cannot be renamed
                    self._descriptor = -1
                    add(self._place, self._target)
                    self._descriptor, self._target = os.open(self._target, FLAGS), None
        self._pending_bytes, self._since = 0, time.monotonic()

    def _write(self, content: bytes, ticks: int) -> None:
        offset, first, _ = self._state
        os.lseek(self._descriptor, offset, os.SEEK_SET)
        rest = memoryview(content)
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
        self._state = (offset + len(content), first + ticks, [])
