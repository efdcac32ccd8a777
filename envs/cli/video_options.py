"""Options of the commands that draw worlds: what is drawn, and where it goes."""

import argparse
import logging
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from outlast.ecs import Worlds

from .grammar import Parser
from .options import add_number, path, printable

LOGGER = logging.getLogger(__name__)
DEFAULTS: dict[str, Any] = {"size": 512, "mosaic": None, "views": "", "every": 1, "fps": 30}


def add(command: Parser, required: bool) -> None:
    """--out and, for it, --size, --mosaic, --views, --every and --fps; `write_frames` reads them, and --quiet."""
    command = command.group("pictures")
    text = "where to write: a folder for pictures, or a film, .mp4, .webm, .gif or .apng"
    command.add_argument("--out", type=path, required=required, metavar="PATH", help=text)
    add_number(command, "--size", DEFAULTS["size"], "pixels along a side of one world's picture")
    text = "rows and columns of worlds in a frame (default: nearly a square)"
    command.add_argument("--mosaic", type=grid, metavar="RxC", help=text)
    text = "what else to draw, and what not: +vision,-ids (default: no change)"
    command.add_argument("--views", default=DEFAULTS["views"], metavar="NAMES", help=text)
    add_number(command, "--every", DEFAULTS["every"], "draw every Nth step only")
    add_number(command, "--fps", DEFAULTS["fps"], "frames a second of a film")


def grid(text: str) -> tuple[int, int]:
    """Rows and columns, as in 4x4."""
    rows, _, columns = text.lower().partition("x")
    if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns)):
        raise argparse.ArgumentTypeError(f"{text}: rows x columns are needed, as in 4x4")
    return int(rows), int(columns)


def given(options: argparse.Namespace) -> list[str]:
    """Those of the options for --out that are not at their defaults."""
    return [f"--{name}" for name, default in DEFAULTS.items() if getattr(options, name) != default]


def write_frames(
    options: argparse.Namespace,
    worlds: Worlds,
    ticks: Iterable[object],
    total: int,
    shown: Sequence[int] | None = None,
) -> int:
    """Write what the options ask for, of `total` ticks after the reset; the exit status. Raises FilmError.

    shown: numbers of the worlds to draw; None: all, or as many as the mosaic has room for.
    """
    from ..rendering.layers import select
    from ..rendering.video import footage, write_film

    room = worlds.count if options.mosaic is None else options.mosaic[0] * options.mosaic[1]
    chosen = range(min(room, worlds.count)) if shown is None else shown
    looks = {"size": options.size, "layers": select(options.views), "mosaic": options.mosaic, "every": options.every}
    frames, count = footage(worlds, ticks, chosen, **looks), total // options.every + 1
    try:
        with tqdm(frames, total=count, unit="frame", disable=options.quiet) as bar:
            count = write_film(options.out, bar, options.fps)
    except KeyboardInterrupt:
        LOGGER.warning("stopped; %s was not written", options.out)
        return 130
    print(f"{printable(options.out)}: {count:,} frames, {_size(Path(options.out)) / 1e6:.1f} MB")
    return 0


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.glob("frame_*.png")) if path.is_dir() else path.stat().st_size
