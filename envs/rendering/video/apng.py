"""Animated PNG, written frame by frame: each holds only the rectangle that differs from the frame before.

Source: Portable Network Graphics (PNG) Specification (Third Edition), W3C 2025, chapter 11.3.5 on animation.
"""

import struct
import zlib
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np

from .. import opencv as cv2
from ..canvas import Image

SIGNATURE = b"\x89PNG\r\n\x1a\n"
COMPRESSION = 6  # level of zlib's compression
LOOPS = 0  # 0: it plays for ever
KEEP, OVER = 0, 0  # a frame stays where the next one does not cover it; where it does, pixels are replaced


def write_apng(path: Path, frames: Iterator[Image], fps: int) -> None:
    """Write frames, uint8 (height, width, 3) RGB of one size, as they come; only two of them are in memory."""
    with path.open("wb") as file:
        numbers, before, total = count(), None, 0
        for frame in frames:
            top, left, part = _changed(before, frame)
            height, width = part.shape[:2]
            if before is None:
                file.write(SIGNATURE)
                _chunk(file, b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
                start = file.tell()
                _control(file, 0)
            box = struct.pack(">IIII", width, height, left, top)
            _chunk(file, b"fcTL", struct.pack(">I", next(numbers)) + box + struct.pack(">HHBB", 1, fps, KEEP, OVER))
            for data in _pixels(part):
                if before is None:
                    _chunk(file, b"IDAT", data)
                else:
                    _chunk(file, b"fdAT", struct.pack(">I", next(numbers)) + data)
            before, total = frame.copy(), total + 1
        _chunk(file, b"IEND", b"")
        file.seek(start)
        _control(file, total)


def _changed(before: Image | None, frame: Image) -> tuple[int, int, Image]:
    """Return top, left and pixels of the smallest rectangle with all that is new; one pixel if nothing is new."""
    if before is None:
        return 0, 0, frame
    differs = (before != frame).any(2)
    rows, columns = np.flatnonzero(differs.any(1)), np.flatnonzero(differs.any(0))
    if not len(rows):
        return 0, 0, frame[:1, :1]
    return int(rows[0]), int(columns[0]), frame[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _pixels(part: Image) -> Iterator[bytes]:
    """Yield the compressed pixels: the contents of the IDAT chunks of the PNG that OpenCV makes of this part."""
    _, encoded = cv2.imencode(".png", np.ascontiguousarray(part[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, COMPRESSION])
    content, at = encoded.tobytes(), len(SIGNATURE)
    while at < len(content):
        (length,), kind = struct.unpack(">I", content[at : at + 4]), content[at + 4 : at + 8]
        if kind == b"IDAT":
            yield content[at + 8 : at + 8 + length]
        at += 12 + length


def _control(file: IO[bytes], total: int) -> None:
    _chunk(file, b"acTL", struct.pack(">II", total, LOOPS))


def _chunk(file: IO[bytes], kind: bytes, data: bytes) -> None:
    file.write(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))
