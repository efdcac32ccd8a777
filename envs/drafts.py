"""Files that are whole or not there: written beside their place, and moved to it when they are done."""

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def draft(target: Path) -> Iterator[Path]:
    """A path beside the target, for a file or a folder that takes its place if all goes well, and else vanishes."""
    path = target.with_name(f".{target.name}-{secrets.token_hex(4)}.tmp")
    try:
        yield path
        os.replace(path, target)
    finally:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
