"""outlast replay: run a recording again and see that it is the same; to films, to a page, to data for learners."""

import argparse
import contextlib
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ..errors import RecordingError, ReplayError
from ..recording import Recording, Replay
from . import video_options
from .options import positive, seed

FRAMES, PAGES = 16, 1  # worlds that are shown if none are named


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = commands.add_parser("replay", help="run a recording again: verify it, film it, make data of it")
    command.add_argument("file", help="what `outlast rollout VARIANT --record FILE` wrote")
    video_options.add(command, required=False)
    command.add_argument("--html", metavar="PATH", help="a web page that plays it")
    command.add_argument(
        "--data",
        metavar="PATH",
        help="samples for learners: a folder of .npz files, a .parquet file, or minari:NAME-v0",
    )
    command.add_argument(
        "--worlds", type=numbers, metavar="W,W", help="which worlds (default: 16 in frames, 1 in a page, all in data)"
    )
    command.add_argument(
        "--from", type=seed, default=0, dest="first", metavar="N", help="begin with this run (default 0)"
    )
    command.add_argument("--to", type=seed, dest="last", metavar="N", help="end with this run (default: the last)")
    command.add_argument("--threads", type=positive, default=1)
    command.add_argument("--no-verify", action="store_false", dest="verify", help="do not compare with the digests")
    command.add_argument("--quiet", action="store_true", help="no progress bar")
    command.set_defaults(run=run)


def numbers(text: str) -> list[int]:
    """Numbers with commas between them."""
    return [seed(part) for part in text.split(",")]


def run(options: argparse.Namespace) -> int:
    """Replay, and write what is asked for; the exit status, which is 1 if the replay is not what was recorded."""
    recording = _opened(options)
    with contextlib.closing(Replay(recording, options.threads)) as replay:
        try:
            products = [write for name, write in PRODUCTS.items() if getattr(options, name) is not None]
            return max(write(options, replay) for write in products or [_verify])
        except ReplayError as error:
            print(f"outlast: {error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("stopped", file=sys.stderr)
            return 130


def _opened(options: argparse.Namespace) -> Recording:
    """The recording, if it has what the options ask for."""
    try:
        recording = Recording.open(options.file)
    except OSError as error:
        raise RecordingError(f"{options.file}: {error.strerror}") from None
    if recording.cut:
        print(f"outlast: {recording.cut}", file=sys.stderr)
    if not len(recording):
        raise RecordingError(f"{options.file}: there is no run of the tick in it")
    last = len(recording) - 1
    if not options.first <= (last if options.last is None else options.last) <= last:
        raise RecordingError(f"--from and --to: 0 <= from <= to <= {last} is needed, the last run of {options.file}")
    if options.worlds is not None and max(options.worlds) >= recording.num_worlds:
        last = recording.num_worlds - 1
        raise RecordingError(f"--worlds: there is no world {max(options.worlds)}; they are 0 to {last}")
    return recording


def _verify(options: argparse.Namespace, replay: Replay) -> int:
    """Replay everything, and tell the statistics that the recorded rollout told."""
    recording = replay.recording
    for _ in tqdm(replay.ticks(options.verify), total=len(recording), unit="run", disable=options.quiet):
        pass
    same = "every digest is the same" if options.verify else "not verified"
    what = f"{recording.scenario.name}, {recording.num_worlds} worlds, {len(recording):,} runs of the tick"
    print(f"{options.file}: {what}; {same}")
    print(replay.summary)
    return 0


def _film(options: argparse.Namespace, replay: Replay) -> int:
    most = math.prod(options.mosaic) if options.mosaic else FRAMES
    chosen, last = _chosen(options, replay, most), _last(options, replay)
    return video_options.shoot(options, replay.worlds, _shown(options, replay, chosen), last - options.first, chosen)


def _page(options: argparse.Namespace, replay: Replay) -> int:
    from ..web.replay import write_page

    chosen, recording = _chosen(options, replay, PAGES), replay.recording
    count = _last(options, replay) - options.first + 1
    ticks = tqdm(_shown(options, replay, chosen), total=count, unit="run", disable=options.quiet)
    write_page(
        options.html, replay.worlds, ticks, chosen, title=f"{recording.scenario.name}: {Path(options.file).name}"
    )
    print(options.html)
    return 0


def _data(options: argparse.Namespace, replay: Replay) -> int:
    from ..datasets.export import write
    from ..datasets.samples import Wish

    last, chosen = _last(options, replay), _chosen(options, replay, replay.worlds.count)
    with tqdm(total=last + 1, unit="run", disable=options.quiet) as bar:
        wish = Wish(chosen, options.first, last, options.verify, lambda run: bar.update(1))
        count = write(options.data, replay, wish)
    print(f"{options.data}: {count:,} agent-steps")
    return 0


PRODUCTS = {"out": _film, "html": _page, "data": _data}


def _chosen(options: argparse.Namespace, replay: Replay, most: int) -> Sequence[int]:
    return list(range(min(most, replay.worlds.count))) if options.worlds is None else list(options.worlds)


def _last(options: argparse.Namespace, replay: Replay) -> int:
    return len(replay.recording) - 1 if options.last is None else int(options.last)


def _shown(options: argparse.Namespace, replay: Replay, chosen: Sequence[int]) -> Iterator[int]:
    """Runs from the first to the last that is asked for, without those in which none of the chosen worlds took part."""
    last = _last(options, replay)
    for number in replay.ticks(options.verify):
        if number == options.first or (number > options.first and np.any(replay.worlds.mode[chosen])):
            yield number
        if number == last:
            return
