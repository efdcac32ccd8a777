"""Files that are whole or not there: written beside their target, which they replace when they are done.

A process that is killed leaves its temporary file, `.NAME-XXXXXXXX.tmp` with eight hexadecimal digits: nothing reads
it, and it can be deleted.
"""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

TEMPORARY = re.compile(r"\..+-[0-9a-f]{8}\.tmp")


def temporary_path(target: Path) -> Path:
    """A new path beside the target, for a temporary file that takes its place."""
    return target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")


def is_temporary(path: Path) -> bool:
    """Whether it is a temporary file: one that another process is writing, or that a killed one left."""
    return TEMPORARY.fullmatch(path.name) is not None


def remove(path: Path) -> None:
    """Delete a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_write(target: Path) -> Iterator[Path]:
    """A path beside the target, for a file or a folder that takes its place if all goes well, and else vanishes.

    Of a link, what it leads to is replaced. What is neither a file nor a folder, such as a device, is written to.
    """
    if target.exists() and not target.is_file() and not target.is_dir():
        yield target
        return
    target = Path(os.path.realpath(target))
    path = temporary_path(target)
    try:
        yield path
        os.replace(path, target)
    finally:
        remove(path)
