"""What the terminal shows while a run goes on: a bar and a few lines below it, or an occasional line in a log."""

import math
import os
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, TextIO

from tqdm import tqdm

from .headline import GROUPS, Figure, headline, large

EVERY = 30.0  # seconds between the lines of a log
NAME = max(map(len, GROUPS)) + 2  # characters that the name of a line takes
BESIDE, BETWEEN = 2, " · "  # rows of the terminal that the bar and the shell's prompt take; what separates figures
BAR = "{percentage:3.0f}% |{bar}| {n_fmt} of {total_fmt} [{elapsed}, {remaining} left, {rate_fmt}{postfix}]"
NARROW = "{percentage:3.0f}% {n_fmt} of {total_fmt}, {remaining} left{postfix}"
WIDE = 72  # columns from which on there is room for a bar


class LiveView:
    """The progress of a run, on a terminal or in a log.

    On a terminal: a bar with agent-steps, rate and time left, and below it a line for each group of figures (see
    `headline`), shortened to the terminal's width. Elsewhere: a line at the beginning, at the end, and every EVERY
    seconds, so that a log stays readable. Numbers that an update does not have stay as they were.

    >>> view = LiveView(done=0, total=10_000_000)
    >>> view.now("collecting")
    >>> view.update(16_384, 10_000_000, {"rollout/steps": 812.0, "wins/scripted": 0.12})
    >>> view.close()
    """

    def __init__(
        self,
        done: int,
        total: int,
        *,
        quiet: bool = False,
        file: TextIO | None = None,
        about: str = "",
        unit: str = "agent-steps",
    ) -> None:
        """Show that the run begins.

        Args:
            done: Agent-steps that were done before, if the run is resumed.
            total: Agent-steps at the end.
            quiet: Whether nothing at all is shown.
            file: Where the view is written; None: standard error.
            about: A line to begin with: what is going to be done.
            unit: What is counted, if it is something else than agent-steps.
        """
        self.file: TextIO = sys.stderr if file is None else file
        if about and not quiet:
            print(about, file=self.file, flush=True)
        self.done, self.total, self.tags, self.unit = done, total, dict[str, float](), unit
        self.plain = not quiet and not self.file.isatty()
        self.block = None if quiet or self.plain else _Block(self.file, done, total, unit)
        self.begun, self.start = done, time.monotonic()
        self.printed, self.printed_at = done, -math.inf  # the last line of a log: at which agent-steps, when

    def update(self, done: int, total: int, shown: Mapping[str, float]) -> None:
        """Show how far the run is, and its numbers.

        Args:
            done: Agent-steps that are done, including those of before.
            total: Agent-steps at the end.
            shown: Values by tag, as they are logged; tags that are never shown may be among them.
        """
        self.done, self.total = done, total
        self.tags |= shown
        if self.block is not None:
            self.block.total, self.block.groups = total, _grouped(headline(self.tags))
            self.block.update(done - self.block.n)
            self.block.refresh()
        elif self.plain and time.monotonic() - self.printed_at >= EVERY:
            self._print()

    def now(self, text: str) -> None:
        """Show what is being done: "collecting", "epoch 3"."""
        if self.block is not None:
            self.block.set_postfix_str(text)

    def close(self) -> None:
        """Show the last numbers, and leave them there."""
        if self.block is not None:
            self.block.close()
        elif self.plain and self.done != self.printed:
            self._print()
        self.block, self.plain = None, False

    def _print(self) -> None:
        """One line of a log."""
        self.printed, self.printed_at = self.done, time.monotonic()
        seconds, steps = self.printed_at - self.start, self.done - self.begun
        parts = [f"{large(self.done)} of {large(self.total)} {self.unit}"]
        if steps > 0 and seconds > 0:
            left = max(0, self.total - self.done) * seconds / steps
            parts.append(f"{large(steps / seconds)}/s, {tqdm.format_interval(left)} left")
        parts += [
            f"{name}: {', '.join(f'{figure.name} {figure.text}' for figure in figures)}"
            for name, figures in _grouped(headline(self.tags))
        ]
        print("; ".join(parts), file=self.file, flush=True)


class _Block(tqdm):  # type: ignore[misc]  # mypy does not follow it
    """A bar of tqdm with lines below it. The cursor rests at its beginning, where messages can push it down."""

    def __init__(self, file: TextIO, done: int, total: int, unit: str) -> None:
        self.groups: list[tuple[str, list[Figure]]] = []
        self.height = 0  # lines that were drawn last
        self.closing = False
        super().__init__(file=file, initial=done, total=total, unit=f" {unit.removeprefix('agent-')}", unit_scale=True)

    def display(self, msg: str | None = None, pos: int | None = None) -> bool:
        """Draw everything, in as many rows and columns as the terminal has. tqdm calls it, too."""
        if self.closing:
            return False
        columns, rows = _size(self.fp)
        self.ncols, self.bar_format = columns - 1, BAR if columns >= WIDE else NARROW
        lines = [str(self)[: columns - 1]]
        lines += [fitted(name, figures, columns - 1) for name, figures in self.groups[: max(0, rows - BESIDE)]]
        self.height = len(lines)
        up = f"\x1b[{self.height - 1}A" if self.height > 1 else ""
        self.fp.write("\r" + "\x1b[K\n".join(lines) + f"\x1b[J{up}\r")
        self.fp.flush()
        return True

    def clear(self, nolock: bool = False) -> None:
        """Make room for a message; tqdm calls it, and draws everything again below the message."""
        self.fp.write("\r\x1b[J")
        self.fp.flush()

    def close(self) -> None:
        """Draw it once more, without what is being done, and move the cursor below it."""
        if not self.closing:
            self.set_postfix_str("", refresh=False)
            self.display()
            self.fp.write("\n" * self.height)
            self.leave, self.closing = False, True
        super().close()


def _size(file: Any) -> tuple[int, int]:
    """Columns and rows of the terminal behind a file, at least one each."""
    try:
        columns, rows = os.get_terminal_size(file.fileno())
    except (OSError, ValueError):
        columns, rows = 0, 0
    usual = shutil.get_terminal_size()  # some terminals do not know their size
    return columns or usual.columns, rows or usual.lines


def fitted(name: str, figures: Sequence[Figure], width: int) -> str:
    """A line of as many figures as fit into `width` characters; at least a part of the first one."""
    text = name.ljust(NAME)
    for k, figure in enumerate(figures):
        more = f"{BETWEEN if k else ''}{figure.name} {figure.text}"
        if k and len(text) + len(more) > width:
            break
        text += more
    return text[: max(0, width)]


def _grouped(figures: Sequence[Figure]) -> list[tuple[str, list[Figure]]]:
    groups = [(group, [figure for figure in figures if figure.group == group]) for group in GROUPS]
    return [(name, members) for name, members in groups if members]
