"""Ways to make a file hostile: bytes, zip files, arrays and JSON, changed at random. All take dice."""

import contextlib
import functools
import io
import json
import struct
import tracemalloc
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from random import Random as Dice
from typing import Any

import numpy as np

INTEGERS = (0, 1, 2, 7, 127, 255, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1)
WORDS = ("", "x", "\x1b[31m", "\ud800", "../../x", "$\\frac", "<script>", "nan", "1e9", "\0", "é" * 300)
STRANGE: tuple[Any, ...] = (
    *(0, 1, -1, 2, 3, 17, 2**16, 2**31 - 1, 2**31, -(2**31) - 1, 2**53, 2**63, 2**64, 10**30, 10**4000),
    *(0.5, -0.5, 1e-45, 1e-7, 1e6, 1e30, 3e38, 1e308, -1e308, float("inf"), -float("inf"), float("nan")),
    *(None, True, False, [], {}, [0], [[]], {"": {}}, [1e9] * 9, *WORDS),
)
BOMB = 2**28  # bytes that a bomb unpacks to


@contextlib.contextmanager
def within(most: int) -> Iterator[None]:
    """See that Python and numpy never hold so many bytes more than at first."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()


# ---- bytes


def mutated(content: bytes, dice: Dice) -> bytes:
    """A few changes anywhere."""
    for _ in range(dice.choice((1, 1, 1, 2, 4))):
        content = dice.choice(EDITS)(content, dice)
    return content


def _flip(content: bytes, dice: Dice) -> bytes:
    at = _place(content, dice)
    return _put(content, at, bytes([content[at] ^ 1 << dice.randrange(8)])) if content else b"x"


def _byte(content: bytes, dice: Dice) -> bytes:
    return _put(content, _place(content, dice), bytes([dice.choice((0, 1, 127, 128, 255, dice.randrange(256)))]))


def _number(content: bytes, dice: Dice) -> bytes:
    size = dice.choice((2, 4, 8))
    order = dice.choice(("little", "little", "big"))
    return _put(content, _place(content, dice), (dice.choice(INTEGERS) % 256**size).to_bytes(size, order))


def _cut(content: bytes, dice: Dice) -> bytes:
    return content[: _place(content, dice)]


def _insert(content: bytes, dice: Dice) -> bytes:
    at, size = _place(content, dice), dice.choice((1, 2, 8, 64, 1000))
    return content[:at] + dice.randbytes(size) + content[at:]


def _double(content: bytes, dice: Dice) -> bytes:
    at, size = _place(content, dice), dice.choice((1, 4, 40, 400, len(content)))
    return content[:at] + content[at : at + size] + content[at:]


def _drop(content: bytes, dice: Dice) -> bytes:
    at = _place(content, dice)
    return content[:at] + content[at + dice.choice((1, 4, 40, 400)) :]


EDITS: tuple[Callable[[bytes, Dice], bytes], ...] = (_flip, _byte, _number, _cut, _insert, _double, _drop)


def _place(content: bytes, dice: Dice) -> int:
    """Anywhere, ends of files more often: there is what they say of themselves."""
    size = len(content)
    near = dice.randrange(min(size, 300) + 1)
    return dice.choice((dice.randrange(size + 1), near, size - near)) % max(1, size)


def _put(content: bytes, at: int, piece: bytes) -> bytes:
    return content[:at] + piece + content[at + len(piece) :]


# ---- JSON


def mutated_json(value: Any, dice: Dice) -> Any:
    """One place of it, which may be all, is something else, is gone, is there twice, or has something beside it."""
    value = json.loads(json.dumps(value))
    holder, key = dice.choice([*_places(value), *_places(value), (None, None)])
    if holder is None:
        return dice.choice(STRANGE)
    match dice.randrange(8):
        case 0 if isinstance(holder, dict):
            del holder[key]
        case 1 if isinstance(holder, list):
            holder *= dice.choice((0, 2, 50))
        case 2 if isinstance(holder, dict):
            holder[str(dice.choice(STRANGE))[:99]] = dice.choice(STRANGE)
        case 3:
            holder[key] = _deep(dice.choice((10, 900, 5000)))
        case 4 if isinstance(holder[key], int):
            holder[key] = holder[key] + dice.choice((-1, 1, 7, 2**20))
        case _:
            holder[key] = dice.choice(STRANGE)
    return value


def text(value: Any) -> bytes:
    """JSON of it, also of what nests too deep for the json module."""
    try:
        return json.dumps(value).encode()
    except RecursionError:
        return b'{"x": ' + b"[" * 5000 + b"]" * 5000 + b"}"


def _places(value: Any) -> list[tuple[Any, Any]]:
    """(holder, key) of everything in it."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [place for key in keys for place in ((value, key), *_places(value[key]))]


def _deep(depth: int) -> Any:
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
    """A zip file; names may be there twice."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in files.items() if isinstance(files, dict) else files:
            with warnings.catch_warnings(action="ignore"):  # of names that are there twice
                archive.writestr(zipfile.ZipInfo(name), content, packed)
    return buffer.getvalue()


def mutated_zip(content: bytes, dice: Dice) -> bytes:
    """Entries changed, renamed, doubled, left out, packed, made bombs of, or announced with absurd sizes."""
    files = list(unzipped(content).items())
    k, other = dice.randrange(len(files)), dice.randrange(len(files))
    name, inner = files[k]
    match dice.randrange(9):
        case 0:
            files[k] = (dice.choice(("../x", "", "x" * 3000, name + "/", name.upper(), "\x1b", name[:-1])), inner)
        case 1:
            files = [*files[:k], (name, dice.choice((inner, mutated(inner, dice)))), *files[k:]]
        case 2:
            del files[k]
        case 3:
            return zipped(files, zipfile.ZIP_DEFLATED)
        case 4:
            files[k] = (name, bomb()[0])
            return announced(zipped(files), k, method=zipfile.ZIP_DEFLATED, crc=bomb()[1], unpacked=BOMB)
        case 5 | 6:
            fields = dice.sample(("method", "flags", "crc", "packed", "unpacked"), 2)
            return announced(zipped(files), k, **{field: dice.choice(INTEGERS) for field in fields})
        case 7:
            files[k], files[other] = (name, files[other][1]), (files[other][0], inner)
        case _:
            files[k] = (name, mutated(inner, dice))
    return zipped(files)


@functools.cache
def bomb() -> tuple[bytes, int]:
    """Very many zeros in few bytes, as an entry holds them, and their checksum."""
    packer, total, crc = zlib.compressobj(9, zlib.DEFLATED, -15), b"", 0
    for _ in range(BOMB >> 20):
        total, crc = total + packer.compress(bytes(2**20)), zlib.crc32(bytes(2**20), crc)
    return total + packer.flush(), crc


def announced(content: bytes, k: int, **fields: int) -> bytes:
    """The zip file with other fields in both headers of entry `k`, whatever is in it."""
    for mark, start in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = -1
        for _ in range(k + 1):
            at = content.find(mark, at + 1)
        names, form = ("flags", "method", "time", "date", "crc", "packed", "unpacked"), "<HHHHIII"
        now = dict(zip(names, struct.unpack_from(form, content, at + start), strict=True))
        now |= {name: value % 2 ** (32 if name in names[4:] else 16) for name, value in fields.items()}
        content = _put(content, at + start, struct.pack(form, *now.values()))
    return content


def npy(array: Any) -> bytes:
    """A file of an array."""
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


def mutated_npy(content: bytes, dice: Dice) -> bytes:
    """The header of an array says something else: objects, Fortran order, negative or huge shapes, nonsense."""
    length = int.from_bytes(content[8:10], "little")
    header, rest = content[10 : 10 + length].decode("latin-1"), content[10 + length :]
    shape = header[header.index("'shape': ") + 9 : header.rindex(", }")]
    size = dice.choice((*STRANGE[:12], -8, 2**40, 2**61))
    match dice.randrange(6):
        case 0:
            kind = dice.choice(
                ("|O", "<U9", "|V0", "|V99999999", "<M8[s]", "(9,)<i4", "<c16", "<f2", "|b1", ">i8", "<i4")
            )
            header = header.replace(header.split("'")[3], kind)
        case 1:
            header = header.replace(
                shape, dice.choice((f"({size},)", f"({size}, {size})", "()", "(-1, -8)", "(0, 9**9)"))
            )
        case 2:
            header = header.replace("False", dice.choice(("True", "None", "1", "__import__('os')")))
        case 3:
            header = dice.choice(
                ("(" * 5000, "-" * 9000 + "1", "{}", "[" * 900 + "]" * 900, "{'descr': [('a', '<i4')]}")
            )
        case 4:
            rest = dice.choice((rest[:-1], rest + b"x", b"\x80\x04cos\nsystem\n(S'true'\ntR."))
        case _:
            return _put(content, dice.randrange(10), bytes([dice.randrange(256)]))
    return content[:8] + len(header).to_bytes(2, "little") + header.encode("latin-1") + rest
