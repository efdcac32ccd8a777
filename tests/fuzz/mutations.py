"""Random mutations of bytes, zip files, arrays and JSON, which make a file hostile."""

import contextlib
import functools
import io
import json
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from random import Random
from typing import Any

import numpy as np

INTEGERS = (0, 1, 2, 7, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
STRINGS = ("", "x", "\x1b[31m", "\ud800", "../../x", "$\\frac", "<script>", "nan", "1e9", "\0", "é" * 300)
STRANGE: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 17, 2**16, 2**31 - 1, 2**31, -(2**31) - 1, 2**53, 2**63, 2**64, 10**30, 10**4000),
    *(0.5, -0.5, 1e-45, 1e-7, 1e6, 1e30, 3e38, 1e308, -1e308, float("inf"), -float("inf"), float("nan")),
    *(None, True, False, [], {}, [0], [[]], {"": {}}, [1e9] * 9, *STRINGS),
)
DTYPES = ("|O", "<U9", "|V0", "|V99999999", "<M8[s]", "(9,)<i4", "<c16", "<f2", "|b1", ">i8", "<i4")
BOMB = 2**28  # bytes that a zip bomb unpacks to


@contextlib.contextmanager
def memory_limit(limit: int) -> Iterator[None]:
    """Assert that Python and numpy allocate less than `limit` bytes."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit
    finally:
        tracemalloc.stop()


# ---- bytes


def mutated(content: bytes, rng: Random) -> bytes:
    """A few random changes of bytes."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at, few = _position(content, rng), rng.choice((1, 4, 40, 400))
        match rng.randrange(7):
            case 0 if content:
                content = _overwrite(content, at, bytes([content[at] ^ 1 << rng.randrange(8)]))
            case 1:
                content = _overwrite(content, at, bytes([rng.choice((0, 1, 127, 128, 255, rng.randrange(256)))]))
            case 2:
                size, order = rng.choice((2, 4, 8)), rng.choice(("little", "little", "big"))
                content = _overwrite(content, at, (rng.choice(INTEGERS) % 256**size).to_bytes(size, order))
            case 3:
                content = content[:at]
            case 4:
                content = content[:at] + content[at + few :]
            case 5:
                content = content[:at] + content[at : at + rng.choice((few, len(content)))] + content[at:]
            case _:
                content = content[:at] + rng.randbytes(rng.choice((1, 2, 8, 64, 1000))) + content[at:]
    return content


def _position(content: bytes, rng: Random) -> int:
    """Anywhere, but more often near the two ends, where headers and directories are."""
    size = len(content)
    offset = rng.randrange(min(size, 300) + 1)
    return rng.choice((rng.randrange(size + 1), offset, size - offset)) % max(1, size)


def _overwrite(content: bytes, at: int, piece: bytes) -> bytes:
    return content[:at] + piece + content[at + len(piece) :]


# ---- JSON


def mutated_json(value: Any, rng: Random, strange: tuple[Any, ...] = STRANGE) -> Any:
    """A copy with one value (possibly the root) replaced, deleted, repeated, nested, or with a key added."""
    value = json.loads(json.dumps(value))
    container, key = rng.choice([*_slots(value), *_slots(value), (None, None)])
    if container is None:
        return rng.choice(strange)
    match rng.randrange(8):
        case 0 if isinstance(container, dict):
            del container[key]
        case 1 if isinstance(container, list):
            container *= rng.choice((0, 2, 50))
        case 2 if isinstance(container, dict):
            container[str(rng.choice(strange))[:99]] = rng.choice(strange)
        case 3:
            container[key] = _nested(rng.choice((10, 900, 5000)))
        case 4 if isinstance(container[key], int):
            container[key] = container[key] + rng.choice((-1, 1, 7, 2**20))
        case _:
            container[key] = rng.choice(strange)
    return value


def to_json(value: Any) -> bytes:
    """JSON, also of values that nest too deep for the json module."""
    try:
        return json.dumps(value).encode()
    except RecursionError:
        return b'{"x": ' + b"[" * 5000 + b"]" * 5000 + b"}"


def _slots(value: Any) -> list[tuple[Any, Any]]:
    """(container, key) of every value in it."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [slot for key in keys for slot in ((value, key), *_slots(value[key]))]


def _nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


# ---- zip files, and arrays in them


def unzipped(content: bytes) -> dict[str, bytes]:
    """The entries of a zip file."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(files: dict[str, bytes] | list[tuple[str, bytes]], packed: int = zipfile.ZIP_STORED) -> bytes:
    """A zip file; names may repeat."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items() if isinstance(files, dict) else files:
            with warnings.catch_warnings(action="ignore"):  # about repeated names
                archive.writestr(zipfile.ZipInfo(name), content, packed)
    return buffer.getvalue()


def mutated_zip(content: bytes, rng: Random) -> bytes:
    """Entries changed, renamed, repeated, dropped, swapped, compressed, made bombs, or with absurd header fields."""
    files = list(unzipped(content).items())
    k, other = rng.randrange(len(files)), rng.randrange(len(files))
    name, inner = files[k]
    match rng.randrange(9):
        case 0:
            files[k] = (rng.choice(("../x", "", "x" * 3000, name + "/", name.upper(), "\x1b", name[:-1])), inner)
        case 1:
            files = [*files[:k], (name, rng.choice((inner, mutated(inner, rng)))), *files[k:]]
        case 2:
            del files[k]
        case 3:
            return zipped(files, zipfile.ZIP_DEFLATED)
        case 4:
            files[k] = (name, bomb()[0])
            return with_entry_headers(zipped(files), k, method=zipfile.ZIP_DEFLATED, crc=bomb()[1], unpacked=BOMB)
        case 5 | 6:
            fields = rng.sample(("method", "flags", "crc", "packed", "unpacked"), 2)
            return with_entry_headers(zipped(files), k, **{field: rng.choice(INTEGERS) for field in fields})
        case 7:
            files[k], files[other] = (name, files[other][1]), (files[other][0], inner)
        case _:
            files[k] = (name, mutated(inner, rng))
    return zipped(files)


@functools.cache
def bomb() -> tuple[bytes, int]:
    """The deflated content of a zip bomb, BOMB zeros, and its CRC."""
    packer, total, crc = zlib.compressobj(9, zlib.DEFLATED, -15), b"", 0
    for _ in range(BOMB >> 20):
        total, crc = total + packer.compress(bytes(2**20)), zlib.crc32(bytes(2**20), crc)
    return total + packer.flush(), crc


def with_entry_headers(content: bytes, k: int, **fields: int) -> bytes:
    """The zip file with other fields in the local and the central header of entry `k`."""
    for mark, start in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = -1
        for _ in range(k + 1):
            at = content.find(mark, at + 1)
        names, form = ("flags", "method", "time", "date", "crc", "packed", "unpacked"), "<HHHHIII"
        now = dict(zip(names, struct.unpack_from(form, content, at + start), strict=True))
        now |= {name: value % 2 ** (32 if name in names[4:] else 16) for name, value in fields.items()}
        content = _overwrite(content, at + start, struct.pack(form, *now.values()))
    return content


def npy(array: Any) -> bytes:
    """The .npy file of an array."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def mutated_npy(content: bytes, rng: Random) -> bytes:
    """A .npy file with another header (objects, Fortran order, negative or huge shapes, no Python at all) or length."""
    length = int.from_bytes(content[8:10], "little")
    header, rest = content[10 : 10 + length].decode("latin-1"), content[10 + length :]
    shape = header[header.index("'shape': ") + 9 : header.rindex(", }")]
    size = rng.choice((*STRANGE[:12], -8, 2**40, 2**61))
    match rng.randrange(6):
        case 0:
            header = header.replace(header.split("'")[3], rng.choice(DTYPES))
        case 1:
            shapes = (f"({size},)", f"({size}, {size})", "()", "(-1, -8)", "(0, 9**9)")
            header = header.replace(shape, rng.choice(shapes))
        case 2:
            header = header.replace("False", rng.choice(("True", "None", "1", "__import__('os')")))
        case 3:
            header = rng.choice(
                ("(" * 5000, "-" * 9000 + "1", "{}", "[" * 900 + "]" * 900, "{'descr': [('a', '<i4')]}")
            )
        case 4:
            rest = rng.choice((rest[:-1], rest + b"x", b"\x80\x04cos\nsystem\n(S'true'\ntR."))
        case _:
            return _overwrite(content, rng.randrange(10), bytes([rng.randrange(256)]))
    return content[:8] + len(header).to_bytes(2, "little") + header.encode("latin-1") + rest
