"""The file of a recording: a line of text, then frames, each with its length and checksums.

======== =========================================================================================
part     holds
======== =========================================================================================
MAGIC    the line "outlast recording 1"
frame    40 bytes ahead of its content: tag, bytes of the content stored and unpacked, runs in it, number of the first
         of them, blake2b-8 of the stored content, blake2b-8 of the 32 bytes before
HEAD     the first frame: JSON that says what was recorded (see reader)
RUNS     many: runs of the tick (see runs)
DONE     the last frame, without content: the recording was closed, and nothing is missing
======== =========================================================================================

Everything is little-endian; contents are packed with zlib. A frame goes into the file in one piece, so a file whose
writer was killed ends inside of a frame, or without DONE: all frames before are whole.
"""

import hashlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from ..errors import RecordingError

MAGIC = b"outlast recording 1\n"
HEAD, RUNS, DONE = b"HEAD", b"RUNS", b"DONE"
FIELDS = struct.Struct("<4sIIIQ8s")  # tag, stored, unpacked, runs, first, checksum of the content
CHECK = 8  # bytes of a checksum
AHEAD = FIELDS.size + CHECK


@dataclass(frozen=True)
class Frame:
    """A frame as its first bytes tell it. offset: of the frame in the file. stored, unpacked: bytes of its content."""

    offset: int
    tag: bytes
    stored: int
    unpacked: int
    runs: int
    first: int
    checksum: bytes

    @property
    def end(self) -> int:
        """Offset of the next frame."""
        return self.offset + AHEAD + self.stored


def frame(tag: bytes, content: bytes, runs: int, first: int) -> bytes:
    """The bytes of a frame.

    Matches of a distance of one only (Z_RLE): random actions have no others, and it is the fastest for those that do.
    """
    packer = zlib.compressobj(1, strategy=zlib.Z_RLE)
    stored = packer.compress(content) + packer.flush()
    fields = FIELDS.pack(tag, len(stored), len(content), runs, first, _checksum(stored))
    return fields + _checksum(fields) + stored


def frames(file: BinaryIO, path: str, size: int) -> Iterator[Frame]:
    """The whole frames of the `size` bytes of a file, their contents checked; what was cut off at its end is left out.

    Raises RecordingError where the file is damaged, and where it is no recording.
    """
    offset = _check_magic(file, path)
    while offset + AHEAD <= size:
        found = _ahead(file, path, offset)
        if found.end > size:
            break
        content(file, path, found)
        yield found
        offset = found.end
        if found.tag == DONE and offset < size:
            raise RecordingError(f"{path}: {size - offset} bytes follow its end at byte {offset}")


def content(file: BinaryIO, path: str, found: Frame) -> bytes:
    """The stored content of a frame. Raises RecordingError if it is damaged."""
    file.seek(found.offset + AHEAD)
    stored = file.read(found.stored)
    if _checksum(stored) != found.checksum:
        raise damaged(path, found.offset)
    return stored


def unpack(stored: bytes, path: str, found: Frame, most: int) -> bytes:
    """The content of a frame as it was before it was packed: at most `most` bytes. Raises RecordingError."""
    if found.unpacked > most:
        raise RecordingError(f"{path}: the frame at byte {found.offset} says that it holds {found.unpacked} bytes")
    packer = zlib.decompressobj()
    try:
        whole = packer.decompress(stored, found.unpacked + 1)
    except zlib.error:
        raise damaged(path, found.offset) from None
    if len(whole) != found.unpacked or not packer.eof:
        raise damaged(path, found.offset)
    return whole


def damaged(path: str, offset: int) -> RecordingError:
    """The error for a frame whose bytes are not those that were written."""
    return RecordingError(
        f"{path} is damaged at byte {offset}: a checksum does not fit. What lies before that byte is whole: "
        "a copy that ends there can be replayed"
    )


def _check_magic(file: BinaryIO, path: str) -> int:
    """The offset behind MAGIC, if the file begins with it."""
    found = file.read(len(MAGIC))
    name = MAGIC.rsplit(b" ", 1)[0]
    if found != MAGIC and found.startswith(name) and found.endswith(b"\n"):
        version = found[len(name) :].strip().decode(errors="replace")
        raise RecordingError(f"{path} has version {version} of the format: this outlast reads version 1")
    if found != MAGIC:
        raise RecordingError(f"{path} is not a recording: it does not begin with {MAGIC.decode().strip()!r}")
    return len(MAGIC)


def _ahead(file: BinaryIO, path: str, offset: int) -> Frame:
    file.seek(offset)
    ahead = file.read(AHEAD)
    if len(ahead) < AHEAD or _checksum(ahead[: FIELDS.size]) != ahead[FIELDS.size :]:
        raise damaged(path, offset)
    return Frame(offset, *FIELDS.unpack(ahead[: FIELDS.size]))


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=CHECK).digest()
