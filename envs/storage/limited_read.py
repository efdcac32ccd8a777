"""Files from elsewhere, read up to a limit: neither a huge file nor one that never ends takes all memory."""

import gzip
import io
import os
import zlib
from typing import BinaryIO

LARGEST_TEXT = 2**24  # bytes; as JSON, they take about 30 times as much memory
CHUNK = 2**20  # bytes that are read at once


def read_bytes(path: str | os.PathLike[str], most: int = LARGEST_TEXT) -> bytes:
    """Return the content of a file.

    Raises:
        ValueError: It has more than `most` bytes.
        OSError: It cannot be read.
    """
    content = bytearray()
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            content += chunk
            if len(content) > most:
                raise ValueError(f"it has more than {most:,} bytes")
    return bytes(content)


def read_text(path: str | os.PathLike[str], most: int = LARGEST_TEXT) -> str:
    """Return the text of a file in UTF-8, in which every line break is a line feed.

    Raises:
        ValueError: It has more than `most` bytes, or is no UTF-8 (then it is a UnicodeDecodeError).
        OSError: It cannot be read.
    """
    return io.TextIOWrapper(io.BytesIO(read_bytes(path, most)), encoding="utf-8").read()


def read_gzip(path: str | os.PathLike[str] | BinaryIO, most: int = LARGEST_TEXT) -> bytes:
    """Return what a gzip file holds, which may be open.

    Raises:
        ValueError: It holds more than `most` bytes, or is no gzip file.
        OSError: It cannot be read.
    """
    try:
        with gzip.open(path) as file:
            content = file.read(most + 1)
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise ValueError(f"it is no gzip file: {error}") from error
    if len(content) > most:
        raise ValueError(f"it holds more than {most:,} bytes")
    return content
