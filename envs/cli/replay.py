"""outlast replay: run a recording again and see that it is the same; to films, to a page, to data for learners."""

import argparse
import contextlib
import logging
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from outlast.ecs import SKIP

from ..errors import RecordingError, ReplayError
from ..recording import Recording, Replay
from ..rollout.event_file import event_file
from . import video_options
from .options import add_common, add_number, nonnegative, printable

LOGGER = logging.getLogger(__name__)
FRAMES, PAGES = 16, 1  # worlds that are shown if none are named


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("replay", help="replay a recording: verify it, film it, make a page or data of it")
    command.add_argument("file", help="a recording, as of `outlast rollout VARIANT --record FILE`")
    text = "import this scenario, FILE.py:NAME, for the mechanics of the recording that are not outlast's own"
    command.add_argument("--scenario", metavar="NAME", help=text)
    video_options.add(command, required=False)
    command.add_argument("--html", metavar="PATH", help="write a web page that plays the recording")
    text = "write samples for learners: a folder of .npz files, a .parquet file, or minari:NAME-v0"
    command.add_argument("--data", metavar="PATH", help=text)
    text = "write what happened into a new table, NAME.csv or NAME.parquet"
    command.add_argument("--events", metavar="FILE", help=text)
    text = "numbers of the worlds to write (default: the first 16 for --out, the first for --html, else all)"
    command.add_argument("--worlds", type=numbers, metavar="W,W", help=text)
    add_number(command, "--from", 0, "first tick to write", least=0, dest="first")
    add_number(command, "--to", "the last there is", "last tick to write", least=0, dest="last")
    command.add_argument("--no-verify", action="store_false", dest="verify", help="do not compare with the digests")
    add_common(command, "--threads", "--quiet")
    command.set_defaults(run=run)


def numbers(text: str) -> list[int]:
    """Numbers with commas between them."""
    return [nonnegative(part) for part in text.split(",")]


def run(options: argparse.Namespace) -> int:
    """Replay, and write what is asked for; the exit status, which is 1 if the replay is not what was recorded."""
    products = [write for name, write in PRODUCTS.items() if getattr(options, name) is not None]
    _check(options, bool(products))
    recording = _open(options)
    with contextlib.closing(Replay(recording, options.threads)) as replay:
        try:
            return max(write(options, replay) for write in products or [_verify])
        except ReplayError as error:
            LOGGER.error("%s", error)
            return 1


def _check(options: argparse.Namespace, products: bool) -> None:
    """RecordingError for options that would have no effect."""
    if options.out is None and (unused := video_options.given(options)):
        raise RecordingError(f"{', '.join(unused)}: for pictures and films only; give --out PATH")
    if not products and (options.first or options.last is not None or options.worlds is not None):
        raise RecordingError(
            "--from, --to and --worlds select what is written; give --out, --html, --data or --events, too"
        )


def _open(options: argparse.Namespace) -> Recording:
    """The recording, if it has what the options ask for; `last` becomes the number of a tick."""
    try:
        recording = Recording.open(options.file, options.scenario)
    except (OSError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{options.file}: {getattr(error, 'strerror', error)}") from None
    if recording.cut:
        LOGGER.warning("%s", recording.cut)
    if not len(recording):
        raise RecordingError(f"{options.file}: there is no tick in it")
    last = len(recording) - 1
    if not options.first <= (last if options.last is None else options.last) <= last:
        raise RecordingError(f"--from and --to: 0 <= from <= to <= {last} is needed, the last tick of {options.file}")
    options.last = last if options.last is None else options.last
    if options.worlds is not None and max(options.worlds) >= recording.num_worlds:
        raise RecordingError(
            f"--worlds: there is no world {max(options.worlds)}; they are 0 to {recording.num_worlds - 1}"
        )
    return recording


def _verify(options: argparse.Namespace, replay: Replay) -> int:
    """Replay everything, and print the statistics that the recorded rollout printed."""
    for _ in tqdm(replay.ticks(options.verify), total=len(replay.recording), unit="tick", disable=options.quiet):
        pass
    same = "every digest is the same" if options.verify else "not verified"
    print(f"{printable(options.file)}: {replay.recording.contents}; {same}")
    print(replay.summary)
    return 0


def _film(options: argparse.Namespace, replay: Replay) -> int:
    shown, ticks = _selected(options, replay, math.prod(options.mosaic) if options.mosaic else FRAMES)
    return video_options.write_frames(options, replay.worlds, ticks, options.last - options.first, shown)


def _page(options: argparse.Namespace, replay: Replay) -> int:
    from ..web.replay import write_page

    shown, ticks = _selected(options, replay, PAGES)
    bar = tqdm(ticks, total=options.last - options.first + 1, unit="tick", disable=options.quiet)
    title = f"{replay.recording.scenario.name}: {printable(Path(options.file).name)}"
    write_page(options.html, replay.worlds, bar, shown, title=title)
    print(printable(options.html))
    return 0


def _data(options: argparse.Namespace, replay: Replay) -> int:
    from ..datasets.export import export_dataset
    from ..datasets.samples import Selection

    worlds, _ = _selected(options, replay, replay.worlds.count)
    with tqdm(total=options.last + 1, unit="tick", disable=options.quiet) as bar:
        selection = Selection(worlds, options.first, options.last, options.verify, lambda tick: bar.update(1))
        count = export_dataset(options.data, replay, selection)
    print(f"{printable(options.data)}: {count:,} agent-steps")
    return 0


def _events(options: argparse.Namespace, replay: Replay) -> int:
    shown, ticks = _selected(options, replay, replay.worlds.count)
    worlds = replay.worlds
    chosen = np.isin(np.arange(worlds.count), shown)
    with event_file(options.events, worlds.layout, replay.recording.first_world) as file:
        for _ in tqdm(ticks, total=options.last - options.first + 1, unit="tick", disable=options.quiet):
            file.add(worlds.events(), chosen & (worlds.mode != SKIP))
    print(printable(options.events))
    return 0


PRODUCTS = {"out": _film, "html": _page, "data": _data, "events": _events}


def _selected(options: argparse.Namespace, replay: Replay, most: int) -> tuple[Sequence[int], Iterator[int]]:
    """The worlds that are asked for, or the first `most`; and the ticks that are asked for, if they take part."""
    worlds = list(range(min(most, replay.worlds.count))) if options.worlds is None else options.worlds
    return worlds, replay.ticks(options.verify, first=options.first, last=options.last, worlds=worlds)
