"""Files from elsewhere, read up to a limit, so that huge and endless files cannot take all memory."""

import io
import lzma
import os

LARGEST_TEXT = 2**24  # bytes; as JSON, they take about 30 times as much memory
CHUNK = 2**20  # bytes that are read at once
MEMORY = 2**27  # bytes that xz may take to unpack a file; the highest preset takes half of it


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
        ValueError: It has more than `most` bytes, or is not UTF-8 (then it is a UnicodeDecodeError).
        OSError: It cannot be read.
    """
    return io.TextIOWrapper(io.BytesIO(read_bytes(path, most)), encoding="utf-8").read()


def unpack(content: bytes, most: int = LARGEST_TEXT) -> bytes:
    """Return the unpacked content of an xz file. ValueError if it is not one, or takes more than `most` or MEMORY."""
    unpacking = lzma.LZMADecompressor(lzma.FORMAT_XZ, MEMORY)
    try:
        found = unpacking.decompress(content, most + 1)
    except lzma.LZMAError as error:
        raise ValueError(f"it is not an xz file: {error}") from error
    if len(found) > most:
        raise ValueError(f"it holds more than {most:,} bytes")
    if not unpacking.eof:
        raise ValueError("it is not an xz file: it ends too soon")
    return found
