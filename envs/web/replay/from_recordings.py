"""Pages of recordings, in one call, as `outlast replay --html` makes them; and in frames of notebooks."""

import contextlib
import html
import os
from collections.abc import Sequence
from pathlib import Path

from ...errors import PageError
from ...progress import Progress
from ...recording import Recording, Replay
from ...recording.reader import last_tick, rows_of
from .pack import PageRoom
from .write import checked, page_html, record_ticks, save

MOST = 2000  # ticks in a notebook, which take about a megabyte in its file
HEIGHT = 780  # pixels of a page in a notebook
Source = Recording | str | os.PathLike[str]


def replay_page(
    recording: Source,
    out: str | os.PathLike[str],
    *,
    beside: Source | None = None,
    worlds: Sequence[int] | None = None,
    first: int = 0,
    last: int | None = None,
    title: str | None = None,
    verify: bool = True,
    threads: int = 1,
    quiet: bool = True,
) -> Path:
    """Write a page that plays a recording in a browser, without a network; or two of them side by side.

    >>> outlast.replay_page("fights.rec", "fights.html", worlds=[0, 3], last=400)

    Args:
        recording: A Recording or its path; for a game of your own, Recording.open(path, scenario).
        out: The page, an HTML file; an existing one is replaced.
        beside: Another recording, of the same scenario or of another, which is played next to it in step.
        worlds: Numbers of the worlds to show, as in tables of events; None: the first world. If the worlds of `beside`
            begin at another number, those in the same positions are shown.
        first: First tick to show, counted from the beginning of the recording.
        last: Last tick to show; None: the last one of each recording.
        title: Title of the page; None: the names of the scenario and the file.
        verify: Whether to compare every tick with its recorded digest.
        threads: Number of threads among which the worlds of a recording are divided.
        quiet: Whether to show no progress.

    Returns:
        The path of the complete page.

    Raises:
        RecordingError: A file is not a recording, is damaged, or has no such worlds or ticks.
        ReplayError: A replay differs from what was recorded.
        PageError: The page cannot be written.
        OSError: A recording cannot be read.
    """
    if not isinstance(title, str | None):
        raise PageError(f"title = {title!r}: a text is needed")
    opened = [
        source if isinstance(source, Recording) else Recording.open(source)
        for source in (recording, beside)
        if source is not None
    ]
    target = checked(out, *(Path(each.path) for each in opened))
    ends = [last_tick(each, first, last) for each in opened]
    shown = [0] if worlds is None else rows_of(opened[0], worlds)
    for each in opened[1:]:
        rows_of(each, [each.first_world + row for row in shown])  # raises if it lacks one of these worlds
    rooms = []
    for each, end in zip(opened, ends, strict=True):
        progress = Progress(end - first + 1, "ticks", quiet=quiet)
        with contextlib.closing(Replay(each, threads)) as replay, progress:
            ticks = progress.over(replay.ticks(verify, first=first, last=end, worlds=shown))
            rooms.append(PageRoom(title_of(each), record_ticks(replay.worlds, ticks, shown, replay)))
    save(target, rooms, title or " beside ".join(room.title for room in rooms))
    return target


def title_of(recording: Recording) -> str:
    """Return a title from the scenario and the file, printable for any name of the file."""
    return f"{recording.scenario.name}: {os.fsencode(Path(recording.path).name).decode(errors='backslashreplace')}"


def frame(recording: Recording) -> str:
    """Return HTML that plays the first `MOST` ticks of the first world; it needs no network and no other file.

    Raises:
        RecordingError: The file is damaged.
        ReplayError: The replay differs from what was recorded.
    """
    if not len(recording):
        return f"<p>{html.escape(repr(recording))}</p>"
    end = last_tick(recording, 0, None)
    shown = min(end, MOST)
    with contextlib.closing(Replay(recording)) as replay:
        ticks = replay.ticks(last=shown, worlds=[0])
        room = PageRoom(title_of(recording), record_ticks(replay.worlds, ticks, [0], replay))
    page = html.escape(page_html([room], room.title))
    cut = f"<p>The first {shown:,} of {end:,} ticks; outlast.replay_page shows others.</p>" if shown < end else ""
    attributes = f'width="100%" height="{HEIGHT}" style="border: 0" sandbox="allow-scripts"'
    return f'<iframe srcdoc="{page}" {attributes}></iframe>{cut}'
