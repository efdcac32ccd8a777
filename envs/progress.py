"""The progress of work that takes long, on standard error: a bar on a terminal, an occasional line in a log."""

import contextlib
import math
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Self, TextIO, TypeVar

from tqdm import tqdm

EVERY = 30.0  # seconds between the lines of a log
BAR = "{percentage:3.0f}% |{bar}| {n_fmt} of {total_fmt} [{elapsed}, {remaining} left, {rate_fmt}{postfix}]"
NARROW = "{percentage:3.0f}% {n_fmt} of {total_fmt}, {remaining} left{postfix}"
WIDE = 72  # columns from which on there is room for a bar
BESIDE = 2  # rows of the terminal that the bar and the shell's prompt take

CLOSED = (OSError, ValueError, AttributeError)  # errors of a stream that is closed, or is none

T = TypeVar("T")


class Messages:
    """A text stream for messages, on which no result depends: text that cannot be written is dropped.

    So work continues without standard error, with a pipe that is not read, or after its terminal is closed.
    """

    def __init__(self, stream: TextIO | None) -> None:
        """Write to `stream`, or nowhere if it is None."""
        self.stream: Any = stream

    def write(self, text: str) -> int:
        """Write text, or drop it."""
        self.attempt("write", text)
        return len(text)

    def flush(self) -> None:
        """Write what is buffered, or drop it."""
        self.attempt("flush")

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return bool(Messages.attempt(self, "isatty"))

    def attempt(self, name: str, *arguments: str) -> Any:
        """Call a method of the stream, and return its result; None if it cannot do that."""
        with contextlib.suppress(*CLOSED):
            return getattr(self.stream, name)(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def __eq__(self, other: object) -> bool:
        return _innermost(self) is _innermost(other)

    def __hash__(self) -> int:
        return hash(_innermost(self))


def _innermost(stream: object) -> object:
    return _innermost(stream.stream) if isinstance(stream, Messages) else stream


class Progress:
    """Progress of work: a bar on a terminal; in a log a line at the beginning, at the end, and every EVERY seconds.

    >>> with Progress(len(files), "files") as progress:
    ...     for file in progress.over(files):
    ...         read(file)
    """

    def __init__(
        self, total: int, unit: str, *, done: int = 0, quiet: bool = False, file: TextIO | None = None, about: str = ""
    ) -> None:
        """Show that the work begins.

        total: how much there is to do; 0: that is not known. unit: what is counted, in the plural. done: how much was
        done before. file: where it is written; None: standard error, if there is one. about: a line to begin with.
        """
        self.file: Any = Messages(sys.stderr if file is None else file)
        self.done, self.total, self.unit = done, total, unit
        shown = not quiet and self.file.stream is not None
        if about and shown:
            print(about, file=self.file, flush=True)
        self.plain = shown and not self.file.isatty()
        self.bar = _Bar(self.file, done, total, unit, self.below) if shown and not self.plain else None
        self._begun, self._start = done, time.monotonic()
        self._printed, self._printed_at = done, -math.inf  # the last line of a log: how much was done, and when

    def show(self, done: int, total: int | None = None, note: str = "") -> None:
        """Show how much is done, what was done before included; how much there is to do now; and a note beside it."""
        self.done, self.total = done, self.total if total is None else total
        if self.bar is not None:
            self.bar.total = self.total or None
            if note:
                self.bar.set_postfix_str(note, refresh=False)
            self.bar.update(done - self.bar.n)
        elif self.plain and time.monotonic() - self._printed_at >= EVERY:
            self._print(note)

    def now(self, text: str) -> None:
        """Show what is being done, on a terminal: "collecting", "epoch 3"."""
        if self.bar is not None:
            self.bar.set_postfix_str(text)

    def add(self, count: int = 1, note: str = "") -> None:
        """Show that more is done."""
        self.show(self.done + count, note=note)

    def over(self, items: Iterable[T]) -> Iterator[T]:
        """Yield items, and show how many of them are done."""
        for item in items:
            yield item
            self.add()

    def close(self) -> None:
        """Show how much is done in the end, and leave it there; calling this again does no harm."""
        if self.bar is not None:
            self.bar.close()
        elif self.plain and self.done != self._printed:
            self._print("")
        self.bar, self.plain = None, False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def below(self, columns: int) -> list[str]:
        """Return the lines below the bar, of at most `columns` columns."""
        return []

    def beside(self) -> list[str]:
        """Return what follows in the line of a log."""
        return []

    def _print(self, note: str) -> None:
        """Print the line of a log."""
        self._printed, self._printed_at = self.done, time.monotonic()
        seconds, count = self._printed_at - self._start, self.done - self._begun
        parts = [f"{large(self.done)}{f' of {large(self.total)}' if self.total else ''} {self.unit}"]
        if self.total and count > 0 and seconds > 0:
            left, rate = max(0, self.total - self.done) * seconds / count, count / seconds
            parts.append(f"{f'{large(rate)}/s, ' if rate >= 1 else ''}{duration(left)} left")
        print("; ".join([*parts, *([note] if note else []), *self.beside()]), file=self.file, flush=True)


def large(value: float) -> str:
    """Write a number with three digits and k, M or G: 36.5k."""
    return f"{value:.0f}" if abs(value) < 999.5 else str(tqdm.format_sizeof(value))


def duration(seconds: float) -> str:
    """Write a time as 01:30 or 2:01:30."""
    return str(tqdm.format_interval(seconds))


@contextlib.contextmanager
def above_bars(stream: Any) -> Iterator[None]:
    """Yield a context in which text that is written to this stream stands above the bars of the same terminal."""
    with tqdm.external_write_mode(file=stream):
        yield


class _Bar(tqdm):  # type: ignore[misc]  # mypy does not follow it
    """A bar of tqdm with lines below it. The cursor rests at its beginning, where messages can push it down."""

    monitor_interval = 0  # no thread, beside which nothing could be compiled in forks

    def __init__(self, file: Any, done: int, total: int, unit: str, below: Callable[[int], list[str]]) -> None:
        self.below = below
        self.height = 0  # lines that were drawn last
        self.closing = False
        unit = f" {unit.removeprefix('agent-')}"
        super().__init__(file=file, initial=done, total=total or None, unit=unit, unit_scale=True, miniters=0)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Draw everything, in as many rows and columns as the terminal has. tqdm calls it, too."""
        if self.closing:
            return False
        columns, rows = _size(self.fp)
        self.ncols, self.bar_format = columns - 1, BAR if columns >= WIDE else NARROW
        lines = [str(self)[: columns - 1], *self.below(columns - 1)[: max(0, rows - BESIDE)]]
        self.height = len(lines)
        up = f"\x1b[{self.height - 1}A" if self.height > 1 else ""
        self.fp.write("\r" + "\x1b[K\n".join(lines) + f"\x1b[J{up}\r")
        self.fp.flush()
        return True

    @staticmethod
    def status_printer(file: Any) -> Callable[[str], None]:
        """Return a function that does nothing, as `display` writes. That of tqdm would flush standard error."""
        return lambda text: None

    def clear(self, nolock: bool = False) -> None:
        """Make room for a message; tqdm calls it, and draws everything again below the message."""
        self.fp.write("\r\x1b[J")
        self.fp.flush()

    def close(self) -> None:
        """Draw it once more, without a note, and move the cursor below it."""
        if not self.closing:
            self.set_postfix_str("", refresh=False)
            self.display()
            self.fp.write("\n" * self.height)
            self.leave, self.closing = False, True
        super().close()


def _size(file: Any) -> tuple[int, int]:
    """Return the columns and rows of the terminal behind a file, at least one each."""
    usual = shutil.get_terminal_size()  # some terminals do not know their size
    with contextlib.suppress(*CLOSED):
        columns, rows = os.get_terminal_size(file.fileno())
        return columns or usual.columns, rows or usual.lines
    return usual.columns, usual.lines
