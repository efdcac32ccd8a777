"""A call in the background: one at a time, whose result is fetched later."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from .errors import PendingError


class Background:
    """A thread that starts with the first call."""

    def __init__(self) -> None:
        self._thread: ThreadPoolExecutor | None = None
        self._pending: Future[Any] | None = None

    @property
    def busy(self) -> bool:
        """Whether a call has begun whose result nobody has fetched."""
        return self._pending is not None

    def begin(self, call: Callable[..., Any], *arguments: Any) -> None:
        """Begin a call; the one before must have been fetched."""
        self._thread = self._thread or ThreadPoolExecutor(1, "outlast")
        self._pending = self._thread.submit(call, *arguments)

    def fetch(self) -> Any:
        """Wait for the call, and return or raise what it did. Raises PendingError if none has begun."""
        if self._pending is None:
            raise PendingError("recv() without send()")
        try:
            return self._pending.result()
        finally:
            if self._pending.done():  # it is not after Ctrl-C: then it can be fetched again
                self._pending = None

    def close(self) -> None:
        """Let the thread go, after its call."""
        if self._thread:
            self._thread.shutdown()
