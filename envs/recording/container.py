"""The container of a recording: a line of text, then chunks, each with its length and checksums.

======== =========================================================================================
part     holds
======== =========================================================================================
MAGIC    the line "outlast recording 1"
chunk    a header of 40 bytes, then the content: tag, bytes of the content stored and unpacked, tick records in it,
         number of the first of them, blake2b-8 of the stored content, blake2b-8 of the 32 bytes before
HEAD     the first chunk: JSON with a description of the recording (see reader)
RECORDS  many chunks: tick records (see tick_records); after them, packed separately, what the policy thought in
         these ticks, if the header has a policy. Earlier readers do not look beyond the tick records.
DONE     the last chunk, without content: it marks a recording that was closed and is complete
======== =========================================================================================

Everything is little-endian; contents are packed with zlib. Chunks are written one after the other, so if a writer was
killed, the file ends within a chunk or without DONE, and all chunks before that are complete.
"""

import hashlib
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from ..errors import RecordingError

MAGIC = b"outlast recording 1\n"
HEAD, RECORDS, DONE = b"HEAD", b"RUNS", b"DONE"
FIELDS = struct.Struct("<4sIIIQ8s")  # tag, stored, unpacked, ticks, first, checksum of the content
CHECKSUM_SIZE = 8
LARGEST_CHUNK = 2**30  # bytes of the stored content; those of a million worlds are some megabytes
HEADER_SIZE = FIELDS.size + CHECKSUM_SIZE


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

    Raises RecordingError if the file is damaged or not a recording.
    """
    offset = _check_magic(file, path)
    while offset + HEADER_SIZE <= size:
        chunk = _read_header(file, path, offset)
        if chunk.end > size:
            break
        read_stored(file, path, chunk)
        yield chunk
        offset = chunk.end
        if chunk.tag == DONE and offset < size:
            raise RecordingError(f"{path}: {size - offset} bytes follow its end at byte {offset}")


def read_stored(file: BinaryIO, path: str, chunk: Chunk) -> bytes:
    """Return the stored content of a chunk. Raises RecordingError if it is damaged."""
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


def _check_magic(file: BinaryIO, path: str) -> int:
    """Return the offset after MAGIC. Raises RecordingError if the file does not begin with it."""
    found = file.read(len(MAGIC))
    name = MAGIC.rsplit(b" ", 1)[0]
    if found != MAGIC and found.startswith(name) and found.endswith(b"\n"):
        version = found[len(name) :].strip().decode(errors="replace")
        raise RecordingError(f"{path} has version {version} of the format: this outlast reads version 1")
    if found != MAGIC:
        raise RecordingError(f"{path} is not a recording: it does not begin with {MAGIC.decode().strip()!r}")
    return len(MAGIC)


def _read_header(file: BinaryIO, path: str, offset: int) -> Chunk:
    file.seek(offset)
    header = file.read(HEADER_SIZE)
    if len(header) < HEADER_SIZE or _checksum(header[: FIELDS.size]) != header[FIELDS.size :]:
        raise damaged(path, offset)
    chunk = Chunk(offset, *FIELDS.unpack(header[: FIELDS.size]))
    if chunk.stored > LARGEST_CHUNK:
        raise RecordingError(
            f"{path}: the chunk at byte {offset} has {chunk.stored:,} bytes; at most {LARGEST_CHUNK:,} are possible"
        )
    return chunk


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=CHECKSUM_SIZE).digest()
