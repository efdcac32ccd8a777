"""Options of the commands that draw worlds: what is drawn, and where it goes."""

import argparse
import contextlib
import dataclasses
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..films import Count, Looks
from ..progress import Progress
from ..rendering.layers import FILM_LAYERS_BY_NAME, FILM_OPTIONAL
from ..rendering.video.writer import check_film
from .grammar import Parser
from .options import STOPPED, add_number, output, printable

LOGGER = logging.getLogger(__name__)
DEFAULTS: dict[str, Any] = dataclasses.asdict(Looks())


def add(command: Parser, required: bool) -> None:
    """Add --out and, for it, --size, --mosaic, --views, --every and --fps; `looks` reads them."""
    command = command.group("pictures")
    text = "what to write: a film, NAME.mp4, NAME.webm, NAME.gif or NAME.apng; or, by any name without an ending, a "
    text += "folder of numbered PNG pictures"
    command.add_argument("--out", type=output(check_film), required=required, metavar="PATH", help=text)
    add_number(command, "--size", DEFAULTS["size"], "side of each world's picture in pixels, 64 to 4096")
    text = "rows and columns of worlds in a frame, such as 2x3 (default: nearly a square)"
    command.add_argument("--mosaic", type=grid, metavar="RxC", help=text)
    text = f"layers to add or to leave out, as in +vision,-ids,+FILE.py:LAYER: {', '.join(FILM_LAYERS_BY_NAME)} "
    text += f"(default: all but {', '.join(FILM_OPTIONAL)})"
    command.add_argument("--views", default=DEFAULTS["views"], metavar="NAMES", help=text)
    add_number(command, "--every", DEFAULTS["every"], "draw only every Nth step, and the ends of episodes")
    add_number(command, "--fps", DEFAULTS["fps"], "frames per second; for films only")


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
    return Looks(**{name: getattr(options, name) for name in DEFAULTS})


def report(options: argparse.Namespace, total: int, made: Callable[[Count], object]) -> int:
    """Make a film of `total` ticks after the first one behind a progress bar, and say what it is; the exit status.

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
