"""Files from elsewhere, read up to a limit: neither a huge file nor one that never ends takes all memory."""

import io
import os

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
