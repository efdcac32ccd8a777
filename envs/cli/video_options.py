"""Options of the commands that draw worlds: what is drawn, and where it goes."""

import argparse
import contextlib
import dataclasses
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..api.film import Count
from ..api.options import PICTURES, Looks
from ..progress import Progress
from ..rendering.video.writer import check_film
from .grammar import Parser
from .options import STOPPED, add_options, given_options, output, printable

LOGGER = logging.getLogger(__name__)
DEFAULTS: dict[str, Any] = dataclasses.asdict(Looks())


def add(command: Parser, required: bool) -> None:
    """Add --out and, for it, --size, --mosaic, --views, --every and --fps; `looks` reads them."""
    pictures = command.group(PICTURES)
    text = "what to write: a film, NAME.mp4, NAME.webm, NAME.gif or NAME.apng; or, by any name without an ending, a "
    text += "folder of numbered PNG pictures"
    pictures.add_argument("--out", type=output(check_film), required=required, metavar="PATH", help=text)
    add_options(command, Looks, mosaic={"type": grid})


def grid(text: str) -> tuple[int, int]:
    """Return rows and columns, as in 4x4."""
    rows, _, columns = text.lower().partition("x")
    if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns)):
        raise argparse.ArgumentTypeError(f"{text}: rows x columns are needed, as in 4x4")
    return int(rows), int(columns)


def given(options: argparse.Namespace) -> list[str]:
    """Return those of the options for --out that are not at their defaults."""
    return [f"--{name}" for name, default in DEFAULTS.items() if getattr(options, name) != default]


def looks(options: argparse.Namespace) -> Looks:
    """Return how the film looks that the options ask for."""
    return Looks(**given_options(options, Looks))


def report(options: argparse.Namespace, total: int, made: Callable[[Count], object]) -> int:
    """Make a film of `total` ticks after the first one with a progress bar, and describe it. Return the exit status.

    The bar begins with the first frame: until then, something may be refused.
    """
    begun, frames = contextlib.ExitStack(), 0
    progress: Progress | None = None

    def show(count: int) -> None:
        nonlocal frames, progress
        frames = count
        if progress is None:
            progress = begun.enter_context(Progress(total // options.every + 1, "frames", quiet=options.quiet))
        progress.show(count, max(progress.total, count))  # the ends of episodes add some

    try:
        with begun:
            made(show)
    except KeyboardInterrupt:
        LOGGER.warning("stopped; %s was not written", options.out)
        return STOPPED
    print(f"{printable(options.out)}: {frames:,} frames, {_size(Path(options.out)) / 1e6:.1f} MB")
    return 0


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.glob("frame_*.png")) if path.is_dir() else path.stat().st_size
