"""The compile cache's files: numba's machine code on disk, verified by checksums before it is loaded.

Numba loads whatever it finds: a damaged file raises an error of pickle's, or is executed. Here a file beside them has
their checksums. Files that do not match (of an interrupted process, of two that wrote at once) are deleted, and the
function is compiled again. This protects from accidents, not from attacks: who may write to the folder may run code.
"""

import errno
import hashlib
import json
import os
import tempfile
import warnings
from pathlib import Path
from typing import Any

from numba.core.caching import FunctionCache

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # other errors of the disk are raised


class ChecksummedCache(FunctionCache):  # type: ignore[misc]
    """Numba's cache of one function of one signature, with checksums. Where the disk is full, nothing is cached."""

    def is_valid(self) -> bool:
        """Whether there is machine code, and it matches its checksums."""
        try:
            return bool(json.loads(self._checksum_file.read_text()) == self._checksums() != {})
        except (OSError, ValueError):
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function, or None if it must be compiled."""
        if self.is_valid():
            try:
                return super().load_overload(sig, target_context)
            except Exception as error:  # of any type, from pickle; also where another process writes at the same time
                warnings.warn(f"machine code in {self.cache_path} is of no use: {error!r}", stacklevel=2)
        self._delete()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled function and its checksums."""
        try:
            super().save_overload(sig, data)
            atomic_write(self._checksum_file, json.dumps(self._checksums()))
        except OSError as error:
            warn_not_cached(error)

    @property
    def _checksum_file(self) -> Path:
        return Path(self.cache_path) / f"{self._impl.filename_base}.json"

    def _code_files(self) -> list[Path]:
        return sorted(Path(self.cache_path).glob(f"{self._impl.filename_base}.*nb[ic]"))

    def _checksums(self) -> dict[str, str]:
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in self._code_files()}

    def _delete(self) -> None:
        try:
            for path in [self._checksum_file, *self._code_files()]:
                path.unlink(missing_ok=True)
        except OSError as error:
            warn_not_cached(error)


def enable_disk_cache(function: Any) -> None:
    """Let `function`, which is compiled at its first call, load its machine code from disk and save it there."""
    try:
        function._cache = ChecksummedCache(function.py_func)
    except RuntimeError as error:  # numba found no folder that it may write to
        warn_not_cached(error)


def atomic_write(path: Path, text: str) -> None:
    """Write a whole file or none, and make its folder. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "w") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def warn_not_cached(error: Exception) -> None:
    """Warn that the next process will compile again, and why."""
    warnings.warn(f"compiled code is not kept for later processes: {error}", RuntimeWarning, stacklevel=3)
