"""Readers for untrusted .zip and .npy files: no pickle, no compression, bounded memory."""

import io
import math
import re
import struct
import zipfile
from collections.abc import Collection
from typing import Any, BinaryIO

import numpy as np

from . import strict_json

Array = np.ndarray[Any, Any]
BROKEN = (  # the errors that reading a broken file may raise
    *(*strict_json.BROKEN, zipfile.BadZipFile, EOFError, OSError, OverflowError, struct.error),
    *(NotImplementedError, RuntimeError),
)
START = b"\x93NUMPY\x01\x00"
NUMBERS = re.compile(rb"{'descr': '([<>|][biuf][1248])', 'fortran_order': False, 'shape': \(([0-9, ]*)\), } *\n")


def entries(file: BinaryIO, only: Collection[str] = (), most: float = math.inf) -> dict[str, bytes]:
    """Return the entries of a zip file by name; with `only`, just these.

    Raises one of BROKEN if the file has more than `most` bytes, or if entries are compressed, or together larger than
    the file. So reading never takes more memory than the file has bytes.
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


def array(content: bytes) -> Array:
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
