"""outlast replay: run a recording again and see that it is the same; to films, to a page, to data for learners."""

import argparse
import contextlib
import logging
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from outlast.ecs import SKIP

from ..api.film import REPLAYED, Count, write_film_of
from ..core.options import MACHINE, OUTPUT
from ..errors import RecordingError, ReplayError
from ..progress import Progress
from ..recording import Recording, Replay
from ..recording.reader import last_tick, rows_of
from ..rollout.table_file import check_table, event_file
from . import video_options
from .options import add_import, add_number, add_quiet, import_files, nonnegative, path, printable
from .options import output as written

LOGGER = logging.getLogger(__name__)


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("replay fights.rec", "play it again, compare every tick, and print its statistics"),
        ("replay fights.rec --html fights.html", "a page that plays it"),
        ("replay fights.rec --worlds 3 --from 100 --to 400 --out fight.webm", "a film of world 3, ticks 100 to 400"),
    ]
    description = (
        "Play a recording again, bit for bit, and check that every tick is what was recorded. Print the statistics of "
        "its episodes, or make a film of it (--out), a web page (--html), samples for learners (--data) or a table of "
        "events (--events)."
    )
    text = "replay a recording: verify it, or make a film, page or data of it"
    command = commands.add_parser("replay", help=text, description=description, examples=examples, run=run)
    command.add_argument("file", type=path, help="the recording, made by `outlast rollout VARIANT --record FILE`")
    add_import(command, "the recording uses")
    text = "let the recorded worlds take as much memory as they need; otherwise 1 GiB is the limit, and more for a "
    text += "long file"
    command.add_argument("--trust", action="store_true", help=text)
    video_options.add(command, required=False)
    output, part = command.group(OUTPUT), command.group("which part")
    text = "write a web page that plays the recording"
    output.add_argument("--html", type=written(_check_page), metavar="PATH", help=text)
    text = "with --html: another recording, which the page plays side by side with this one"
    output.add_argument("--beside", type=path, metavar="FILE", help=text)
    text = "write samples to learn from: to a folder of .npz files, to NAME.parquet, or to the Minari dataset "
    text += "minari:NAME-v0"
    output.add_argument("--data", type=written(_check_data), metavar="PATH", help=text)
    text = "with --data NAME.parquet: a column for each number that agents observe, own_health, others_0_x ..., in "
    text += "place of a list for each kind"
    output.add_argument("--flat", action="store_true", help=text)
    text = "write a table of what happened to a new file, NAME.csv or NAME.parquet"
    output.add_argument("--events", type=written(partial(check_table, what="events")), metavar="FILE", help=text)
    text = "numbers of the worlds to write, such as 0,3 (default: for --out the first 16, or as many as --mosaic has "
    text += "room for; for --html the first; otherwise all)"
    part.add_argument("--worlds", type=numbers, metavar="W,W", help=text)
    add_number(part, "--from", 0, "first tick to write", least=0, dest="first")
    add_number(part, "--to", "the last of the recording", "last tick to write", least=0, dest="last")
    text = "do not compare the ticks with the recorded digests"
    part.add_argument("--no-verify", action="store_false", dest="verify", help=text)
    add_number(command.group(MACHINE), "--threads", 1, "threads that share the worlds, with the same results")
    add_quiet(command)


def _check_page(path: str) -> None:
    from ..web.replay.write import checked  # here, as the command loads the page only where it writes one

    checked(path)


def _check_data(path: str) -> None:
    from ..datasets.export import check_new

    check_new(path)


def numbers(text: str) -> list[int]:
    """Return numbers with commas between them."""
    return [nonnegative(part) for part in text.split(",")]


def run(options: argparse.Namespace) -> int:
    """Replay, and write what is asked for; the exit status, which is 1 if the replay is not what was recorded."""
    products = [write for name, write in PRODUCTS.items() if getattr(options, name) is not None]
    _check(options, bool(products))
    recording = _open(options)
    with contextlib.closing(Replay(recording, options.threads)) as replay:
        try:
            for write in products or [_verify]:
                if status := write(options, replay):
                    return status  # stopped, or not what was recorded: the others would be no better
            return 0
        except ReplayError as error:
            LOGGER.error("%s", error)
            return 1


def _check(options: argparse.Namespace, products: bool) -> None:
    """Refuse options that would have no effect."""
    if options.out is None and (unused := video_options.given(options)):
        raise RecordingError(f"{', '.join(unused)}: for pictures and films only; give --out PATH")
    if options.beside is not None and options.html is None:
        raise RecordingError("--beside is for pages: give --html PATH, too")
    if options.flat and not (options.data or "").endswith(".parquet"):
        raise RecordingError("--flat is for tables of samples: give --data NAME.parquet, too")
    if not products and (options.first or options.last is not None or options.worlds is not None):
        raise RecordingError(
            "--from, --to and --worlds select what is written; give --out, --html, --data or --events, too"
        )


def _open(options: argparse.Namespace) -> Recording:
    """Return the recording, if it has what the options ask for, and the number of its last tick."""
    import_files(options)
    recording = _recording(options.file, options.trust)
    options.to, options.last = options.last, last_tick(recording, options.first, options.last)
    if options.worlds is not None:
        rows_of(recording, options.worlds)  # which refuses those that there are not
    return recording


def _recording(path: str, trust: bool) -> Recording:
    try:
        recording = Recording.open(path, trust=trust)
    except (OSError, ValueError) as error:
        if isinstance(error, RecordingError):
            raise
        raise RecordingError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if recording.cut:
        LOGGER.warning("%s", recording.cut)
    return recording


def _verify(options: argparse.Namespace, replay: Replay) -> int:
    """Replay everything, and print the statistics that the recorded rollout printed."""
    with Progress(len(replay.recording), "ticks", quiet=options.quiet) as progress:
        for _ in progress.over(replay.ticks(options.verify)):
            pass
    same = "every digest is the same" if options.verify else "not verified"
    print(f"{printable(options.file)}: {replay.recording.contents}; {same}")
    print(replay.summary)
    return 0


def _film(options: argparse.Namespace, replay: Replay) -> int:
    shown, ticks = _selected(options, replay, math.prod(options.mosaic) if options.mosaic else REPLAYED)
    looks, name = video_options.looks(options), replay.recording.scenario.name

    def made(progress: Count) -> None:
        write_film_of(options.out, replay.worlds, ticks, shown, looks, name, progress)

    return video_options.report(options, options.last - options.first, made)


def _page(options: argparse.Namespace, replay: Replay) -> int:
    from ..web.replay import replay_page

    beside = None if options.beside is None else _recording(options.beside, options.trust)
    chosen = {"worlds": options.worlds, "first": options.first, "last": options.to}
    how = {"verify": options.verify, "threads": options.threads, "quiet": options.quiet}
    replay_page(replay.recording, options.html, beside=beside, **chosen, **how)
    print(printable(options.html))
    return 0


def _data(options: argparse.Namespace, replay: Replay) -> int:
    from ..datasets.export import export_dataset
    from ..datasets.samples import Selection

    worlds, _ = _selected(options, replay, replay.worlds.count)
    with Progress(options.last + 1, "ticks", quiet=options.quiet) as progress:
        selection = Selection(worlds, options.first, options.last, options.verify, lambda tick: progress.add())
        count = export_dataset(options.data, replay, selection, options.flat)
    print(f"{printable(options.data)}: {count:,} agent-steps")
    return 0


def _events(options: argparse.Namespace, replay: Replay) -> int:
    shown, ticks = _selected(options, replay, replay.worlds.count)
    worlds = replay.worlds
    chosen = np.isin(np.arange(worlds.count), shown)
    progress = Progress(options.last - options.first + 1, "ticks", quiet=options.quiet)
    with event_file(options.events, worlds.layout, replay.recording.first_world) as add, progress:
        for _ in progress.over(ticks):
            add(replay.events(), chosen & (worlds.mode != SKIP))
    print(printable(options.events))
    return 0


PRODUCTS = {"out": _film, "html": _page, "data": _data, "events": _events}


def _selected(options: argparse.Namespace, replay: Replay, most: int) -> tuple[Sequence[int], Iterator[int]]:
    """Return the worlds that are asked for, or the first `most`, and the ticks, if these are among them."""
    asked, count = options.worlds, min(most, replay.worlds.count)
    worlds = list(range(count)) if asked is None else rows_of(replay.recording, asked)
    return worlds, replay.ticks(options.verify, first=options.first, last=options.last, worlds=worlds)
