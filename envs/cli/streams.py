"""Standard streams of commands: open, for text of any language, and with readers that may go away."""

import contextlib
import errno
import io
import os
import sys
from collections.abc import Iterator
from typing import Any, TextIO

from ..progress import CLOSED, Messages

# the errors of a stream whose reader is gone: a pipe, also that of Windows, or the terminal of a lost connection
GONE = (errno.EPIPE, errno.EIO, *([errno.EINVAL] if os.name == "nt" else []))


@contextlib.contextmanager
def standard_streams() -> Iterator[None]:
    """Yield a context in which no reader of standard output or standard error can stop a command by going away.

    The command does its work and returns its status, and the rest of its text is dropped. Text for standard error is
    also dropped after any other error; what cannot be written to standard output for another reason, such as a full
    disk, raises OSError with the file name "stdout".
    """
    _open_closed()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    out: Any = _Standard(sys.stdout, raises=True)
    err: Any = _Standard(sys.stderr)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


class _Standard(Messages):
    """A standard stream. raises: whether errors other than those in GONE are raised."""

    def __init__(self, stream: TextIO, raises: bool = False) -> None:
        super().__init__(stream)
        self.raises = raises

    def attempt(self, name: str, *arguments: str) -> Any:
        try:
            return getattr(self.stream, name)(*arguments)
        except CLOSED as error:
            with contextlib.suppress(*CLOSED):  # it is not a file
                _plug(self.stream.fileno())
            if self.raises and isinstance(error, OSError) and error.errno not in GONE:
                self.raises = False  # once is enough
                raise OSError(error.errno, error.strerror, "stdout") from error


def _open_closed() -> None:
    """Open the standard streams that are closed, as by 2>&-: the next file would else get the number of one."""
    for fd, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w" if fd else "r", encoding="utf-8"))  # noqa: SIM115
            try:
                os.fstat(fd)
            except OSError:
                _plug(fd)


def _plug(fd: int) -> None:
    """Let a descriptor lead nowhere, so that nothing is tried again, in another language or when Python ends."""
    null = os.open(os.devnull, os.O_RDWR)
    if null != fd:
        os.dup2(null, fd)
        os.close(null)
