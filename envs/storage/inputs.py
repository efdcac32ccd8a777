"""Files from elsewhere: with limits, so that none can take all memory, without pickle, and without ambiguous JSON."""

import io
import json
import lzma
import math
import os
import re
import struct
import zipfile
from collections.abc import Collection
from typing import Any, BinaryIO

import numpy as np

from ..errors import ScenarioError

LARGEST_TEXT = 2**24  # bytes; as JSON, they take about 30 times as much memory
CHUNK = 2**20  # bytes that are read at once
MEMORY = 2**27  # bytes that xz may take to unpack a file; the highest preset takes half of it
START = b"\x93NUMPY\x01\x00"  # of an .npy file; then follow the length of its header, and the header
NUMBERS = re.compile(rb"{'descr': '([<>|][biuf][1248])', 'fortran_order': False, 'shape': \(([0-9, ]*)\), } *\n")
# the errors that reading JSON of another form may raise: they are about the file, not about this process
BROKEN_JSON = (ValueError, KeyError, TypeError, AttributeError, RecursionError, MemoryError)
# and those that reading a broken file of arrays may raise
BROKEN_ZIP = (*BROKEN_JSON, zipfile.BadZipFile, EOFError, OSError, OverflowError, struct.error, RuntimeError)


def read_bytes(path: str | os.PathLike[str], most: int = LARGEST_TEXT) -> bytes:
    """Return the content of a file. Raises ValueError if it has more than `most` bytes, or OSError."""
    content = bytearray()
    with open(path, "rb") as file:
        while chunk := file.read(CHUNK):
            content += chunk
            if len(content) > most:
                raise ValueError(f"it has more than {most:,} bytes")
    return bytes(content)


def read_text(path: str | os.PathLike[str], most: int = LARGEST_TEXT) -> str:
    """Return the text of a file in UTF-8, in which every line break is a line feed.

    Raises ValueError if it has more than `most` bytes or is not UTF-8 (UnicodeDecodeError), or OSError.
    """
    return io.TextIOWrapper(io.BytesIO(read_bytes(path, most)), encoding="utf-8").read()


def unpack_xz(content: bytes, most: int = LARGEST_TEXT) -> bytes:
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


def parse_json(text: str) -> Any:
    """Return what JSON holds. Raises ValueError: not JSON, a number too long, or a name twice in an object."""

    def once(items: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict[str, Any]()
        for name, value in items:
            if name in found:
                raise ScenarioError(f"it has {name!r:.60} twice")
            found[name] = value
        return found

    return json.loads(text, object_pairs_hook=once)


def check_version(given: Any, version: int) -> None:
    """Raise ScenarioError unless `given` is an object with that "version"."""
    found = given.get("version") if isinstance(given, dict) else None
    if type(found) is not int or found != version:
        raise ScenarioError(f"it has version {found!r:.20} of the format: this outlast reads version {version}")


def check_keys(given: Any, needed: Collection[str], optional: Collection[str] = ()) -> None:
    """Raise ScenarioError unless `given` is an object with all needed keys, and no others except optional ones."""
    known = ", ".join((*needed, *optional))
    if not isinstance(given, dict):
        raise ScenarioError(f"it has {given!r:.60} where an object with {known} is needed")
    if missing := sorted({*needed} - given.keys()):
        raise ScenarioError(f"it lacks {missing[0]!r:.60}; its keys are {known}")
    if unknown := sorted(given.keys() - {*needed, *optional}):
        raise ScenarioError(f"it has {unknown[0]!r:.60}; its keys are {known}")


def zip_entries(file: BinaryIO, only: Collection[str] = (), most: float = math.inf) -> dict[str, bytes]:
    """Return the entries of a zip file by name; with `only`, just these.

    Raises one of BROKEN_ZIP if the file has more than `most` bytes, or if entries are compressed, or together larger
    than the file. So reading never takes more memory than the file has bytes.
    """
    size = file.seek(0, io.SEEK_END)
    if not size:  # endless devices have no size
        raise ValueError("it is empty")
    if size > most:
        raise ValueError(f"it has more than {most:,} bytes")
    with zipfile.ZipFile(file) as archive:
        infos = archive.infolist()
        for info in infos:
            if info.compress_type != zipfile.ZIP_STORED or info.flag_bits & 1:
                raise ValueError(f"{info.filename!r} is compressed or encrypted")
        if sum(max(info.file_size, info.compress_size) for info in infos) > size:
            raise ValueError("its entries are larger than the file")
        names = [info.filename for info in infos]
        if len(set(names)) < len(names):
            raise ValueError("two of its entries have the same name")
        if missing := sorted(set(only) - set(names)):
            raise ValueError(f"it has no {missing[0]}")
        return {name: archive.read(name) for name in only or names}


def npy_array(content: bytes) -> np.ndarray[Any, Any]:
    """Return the array of an .npy file, if it has numbers in C order and a header as numpy writes it; or ValueError."""
    begin = len(START) + 2
    end = begin + int.from_bytes(content[len(START) : begin], "little")
    found = NUMBERS.fullmatch(content[begin:end])
    if not content.startswith(START) or not found:
        raise ValueError(f"no array of numbers: {content[:80]!r}")
    dtype, shape = np.dtype(found[1].decode()), tuple(int(size) for size in found[2].split(b",") if size.strip())
    if math.prod(shape) * dtype.itemsize != len(content) - end:
        raise ValueError(f"{dtype} of shape {shape} in {len(content)} bytes")
    return np.frombuffer(content, dtype, offset=end).reshape(shape).copy()
