"""Options of the commands that draw worlds: what is drawn, and where it goes."""

import argparse
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from outlast.ecs import Worlds

from .options import positive

Grid = tuple[int, int]


def add(command: argparse.ArgumentParser, required: bool = True) -> None:
    """--out, --size, --mosaic, --views, --every and --fps, which `shoot` reads; it reads --quiet, too."""
    command.add_argument(
        "--out", required=required, metavar="PATH", help="a folder of pictures, or a film: .mp4, .webm, .gif or .apng"
    )
    command.add_argument("--size", type=positive, default=512, help="pixels of one world's picture (default 512)")
    command.add_argument(
        "--mosaic", type=grid, metavar="RxC", help="rows and columns of worlds in a frame (default: nearly a square)"
    )
    command.add_argument(
        "--views",
        default="",
        metavar="NAMES",
        help="what else to draw, and what not: +vision,-ids; with a minus first: --views=-ids",
    )
    command.add_argument("--every", type=positive, default=1, metavar="N", help="draw every Nth step (default 1)")
    command.add_argument("--fps", type=positive, default=30, help="frames a second of a film (default 30)")


def grid(text: str) -> Grid:
    """Rows and columns, as in 4x4."""
    rows, _, columns = text.lower().partition("x")
    if not (rows.isdecimal() and columns.isdecimal() and int(rows) * int(columns)):
        raise argparse.ArgumentTypeError(f"{text}: rows x columns are needed, as in 4x4")
    return int(rows), int(columns)


def shoot(
    options: argparse.Namespace,
    worlds: Worlds,
    ticks: Iterable[object],
    total: int,
    chosen: Sequence[int] | None = None,
) -> int:
    """Write what the options ask for, of `total` ticks after the reset; the exit status. Raises FilmError.

    chosen: numbers of the worlds to show; None: all, or as many as the mosaic has room for.
    """
    from ..rendering.layers import select
    from ..rendering.video import footage, write_film

    room = worlds.count if options.mosaic is None else options.mosaic[0] * options.mosaic[1]
    shown = range(min(room, worlds.count)) if chosen is None else chosen
    looks = {"size": options.size, "layers": select(options.views), "mosaic": options.mosaic, "every": options.every}
    frames = footage(worlds, ticks, shown, **looks)
    try:
        count = write_film(options.out, _watched(frames, total // options.every + 1, options.quiet), options.fps)
    except KeyboardInterrupt:
        print(f"stopped; {options.out} was not written", file=sys.stderr)
        return 130
    print(f"{options.out}: {count:,} frames, {_size(Path(options.out)) / 1e6:.1f} MB")
    return 0


def _watched(frames: Iterable[Any], total: int, quiet: bool) -> Iterator[Any]:
    with tqdm(frames, total=total, unit="frame", disable=quiet) as bar:
        yield from bar


def _size(path: Path) -> int:
    return sum(file.stat().st_size for file in path.glob("frame_*.png")) if path.is_dir() else path.stat().st_size
