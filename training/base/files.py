"""Reading and writing files, with errors that name the file."""

import lzma
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TypeVar

from outlast.envs.storage import inputs
from outlast.envs.storage.outputs import atomic_write, check_file, check_folder, written_to

from .errors import TrainingError

LARGEST = 2**30  # maximum bytes of a text, such as the log of a long run
LARGEST_PACKED = 2**26  # maximum bytes of a text that was compressed
T = TypeVar("T")


def read_text(path: Path) -> str:
    """Return the content of a text file. Raises TrainingError if it cannot be read."""
    return _read(inputs.read_text, path, LARGEST)


def read_bytes(path: Path, most: int = 0) -> bytes:
    """Return the content of a file of at most `most` bytes; 0: LARGEST. Raises TrainingError."""
    return _read(inputs.read_bytes, path, most or LARGEST)


def _read(read: Callable[[Path, int], T], path: Path, most: int) -> T:
    try:
        return read(path, most)
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        wrong = "it is not UTF-8 text" if isinstance(error, UnicodeDecodeError) else error
        raise TrainingError(f"{path} cannot be read: {wrong}") from error


def packed(text: str) -> bytes:
    """Return a text compressed by xz; equal texts give equal bytes."""
    return lzma.compress(text.encode(), preset=9 | lzma.PRESET_EXTREME)


def unpacked(content: bytes) -> str:
    """Return the text that `packed` has compressed. Raises ValueError for other content."""
    return inputs.unpack_xz(content, LARGEST_PACKED).decode()


def check_out(folder: str | os.PathLike[str]) -> Path:
    """Return the path of a folder for results. Raises TrainingError if it is not writable."""
    return check_folder(folder, TrainingError)


def check_results(paths: Iterable[Path]) -> None:
    """Raise TrainingError unless all of these files can be written. Writes nothing."""
    for path in paths:
        check_out(path.parent)
        if path.parent.exists():
            check_file(path, "results", TrainingError)


def write_files(contents: Mapping[Path, bytes]) -> list[Path]:
    """Write files, each completely; none if one of them cannot be written. Return their paths. Raises TrainingError."""
    check_results(contents)
    for path, content in contents.items():
        with written_to(path, TrainingError):
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as place:
                place.write_bytes(content)
    return list(contents)
