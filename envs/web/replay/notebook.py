"""Recordings in notebooks: the replay page in a frame."""

import contextlib
import html

from ...recording import Recording, Replay
from ...recording.selection import last_tick
from .from_recordings import title_of
from .pack import PageRoom
from .write import page_html, record_ticks

MOST = 2000  # ticks, which take about a megabyte in the notebook's file
HEIGHT = 780  # pixels


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
