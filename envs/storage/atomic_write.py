"""Files that are whole or not there: written beside their place, and moved to it when they are done.

A process that is killed leaves its draft, `.NAME-XXXXXXXX.tmp` with eight hexadecimal digits: nothing reads it, nothing
minds it, and it can be deleted.
"""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

DRAFT = re.compile(r"\..+-[0-9a-f]{8}\.tmp")


def name(target: Path) -> Path:
    """A new path beside the target, for a draft of it."""
    return target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")


def is_draft(path: Path) -> bool:
    """Whether that is what a killed process left, or another one is writing."""
    return DRAFT.fullmatch(path.name) is not None


def discard(path: Path) -> None:
    """Delete a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def draft(target: Path) -> Iterator[Path]:
    """A path beside the target, for a file or a folder that takes its place if all goes well, and else vanishes."""
    path = name(target)
    try:
        yield path
        os.replace(path, target)
    finally:
        discard(path)
