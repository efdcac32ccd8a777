"""Machine code on disk, used only while it is what was written.

Numba believes the files that it finds: a damaged one raises whatever pickle makes of it, or runs. Here their checksums
stand in a file beside them. Files without one that fits (of an interrupted process, of two that wrote at once) are
deleted, and the function is compiled again. It guards against accidents; whoever may write there may run code.
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

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # no room; other errors of the disk are for the user to cure


class StoredCode(FunctionCache):  # type: ignore[misc]
    """Numba's cache of one function of one signature, with checksums. A full disk costs no more than it."""

    def whole(self) -> bool:
        """Whether there is machine code, and it is what was written."""
        try:
            return bool(json.loads(self._sums.read_text()) == self._digests() != {})
        except (OSError, ValueError):
            return False

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function, or None: compile it."""
        if self.whole():
            try:
                return super().load_overload(sig, target_context)
            except Exception as error:  # pickle raises any; a process that writes at the same time may cause some
                warnings.warn(f"machine code in {self.cache_path} is of no use: {error!r}", stacklevel=2)
        self._clear()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled function and its checksums."""
        try:
            super().save_overload(sig, data)
            write(self._sums, json.dumps(self._digests()))
        except OSError as error:
            warn_not_kept(error)

    @property
    def _sums(self) -> Path:
        return Path(self.cache_path) / f"{self._impl.filename_base}.json"

    def _files(self) -> list[Path]:
        return sorted(Path(self.cache_path).glob(f"{self._impl.filename_base}.*nb[ic]"))

    def _digests(self) -> dict[str, str]:
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in self._files()}

    def _clear(self) -> None:
        try:
            for path in [self._sums, *self._files()]:
                path.unlink(missing_ok=True)
        except OSError as error:
            warn_not_kept(error)


def keep(function: Any) -> None:
    """Have a function that is compiled at its first call look for machine code on disk first, and leave it there."""
    try:
        function._cache = StoredCode(function.py_func)
    except RuntimeError as error:  # numba found no folder that it may write to
        warn_not_kept(error)


def write(path: Path, text: str) -> None:
    """Write a file at once or not at all; its folder is made. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
    try:
        with os.fdopen(handle, "w") as file:
            file.write(text)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def warn_not_kept(error: Exception) -> None:
    """Say that the next process will have to compile again, and why."""
    warnings.warn(f"compiled code is not kept for later processes: {error}", RuntimeWarning, stacklevel=3)
