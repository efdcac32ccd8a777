"""Writing a page: the ticks of some worlds, and all that it takes to play them, in one HTML file."""

import base64
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from outlast.components import Side
from outlast.ecs import Clock, Worlds

from ...errors import PageError
from ...inspect.events import events
from ...inspect.trace import describe, snapshot
from ...storage.atomic_write import atomic_write
from .assets import DRAWING, assemble
from .pack import Episode, pack

PARTS = ("recording.js", "panel.js", "story.js", "stage.js", "views.js", "timeline.js", "chronicle.js", "player.js")


def write(
    path: str | os.PathLike[str], worlds: Worlds, ticks: Iterable[object], chosen: Sequence[int], *, title: str
) -> None:
    """Run through `ticks` and write what happens in the `chosen` worlds as a page; whole or not at all.

    ticks: each pull runs the worlds once more; the first one has just reset them. The page holds everything it needs,
    so it opens without a server and without a network. Memory: a kilobyte for each tick of a world of 4 agents. Raises
    PageError for worlds or folders that are not there, if there are no ticks, and if the disk is full.
    """
    target = _checked(path)
    recorded = record(worlds, ticks, chosen)
    if not any(recorded.values()):
        raise PageError("there is nothing to show: not one tick")
    try:
        with atomic_write(target) as place:
            place.write_text(render(recorded, title), encoding="utf-8", newline="\n")
    except OSError as error:
        raise PageError(f"{target} cannot be written: {error.strerror}") from error


def render(recorded: dict[int, list[Episode]], title: str) -> str:
    """The page itself, as HTML."""
    return assemble("page.html", title, (*DRAWING, *PARTS), base64.b64encode(pack(title, recorded)).decode())


def record(worlds: Worlds, ticks: Iterable[object], chosen: Sequence[int]) -> dict[int, list[Episode]]:
    """The episodes of each of the `chosen` worlds, as far as the ticks go.

    A world whose clock stands still has not been run and is not recorded anew; where the clock jumps, an episode
    starts.
    """
    recorded: dict[int, list[Episode]] = {int(w): [] for w in chosen}
    _check(worlds, recorded)
    clocks: dict[int, tuple[int, ...]] = {}
    for _ in ticks:
        for w, episodes in recorded.items():
            clock = tuple(int(column[w, 0]) for column in worlds[Clock])
            before = clocks.get(w)
            if clock == before:
                continue
            if before is None or clock != (*before[:-1], before[-1] + 1):
                *_, number, tick = clock
                episodes.append(Episode(describe(worlds, w), number, tick))
            clocks[w] = clock
            episodes[-1].add(snapshot(worlds, w), events(worlds, w))
    return recorded


def _check(worlds: Worlds, chosen: Iterable[int]) -> None:
    strays = [w for w in chosen if not 0 <= w < worlds.count]
    if strays or not chosen:
        raise PageError(f"worlds {strays or 'to show: none'}; choose among 0 to {worlds.count - 1}")
    if Side not in worlds:
        raise PageError("there is nobody to show: this scenario has no agents")


def _checked(path: str | os.PathLike[str]) -> Path:
    """Refused before anything is run."""
    target = Path(path)
    if target.is_dir() or not target.parent.is_dir():
        raise PageError(f"{target} cannot be written: give a file name in a folder that is there")
    return target
