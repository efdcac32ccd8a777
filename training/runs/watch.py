"""Watching a run while it trains: episodes of its newest checkpoint, and the numbers of its log."""

import base64
import contextlib
import itertools
import logging
import threading
import time
from pathlib import Path
from typing import Any

from outlast.envs.rollout.saved import checkpoints, steps_of
from outlast.envs.web.pages import PageRoom, Recorded, pack, record_ticks

from ..base import curves
from ..base.errors import TrainingError
from ..base.quantities import headline
from .film import episode

MOST = 5000  # maximum ticks of an episode that are shown
CHARTED, POINTS = ("episodes", "wins"), 120  # groups of figures with a chart; maximum points of a chart
POLL, AWAY = 0.5, 15.0  # seconds: between checks of the folder; without a request, after which no page is watching
logger = logging.getLogger(__name__)
Json = dict[str, Any]


class RunWatcher:
    """A run in a folder, for its page, which outlast.envs.web.server serves. Work is done on request only.

    A checkpoint that cannot be played is reported, and the newest playable one is played instead. The first episode
    grows tick by tick; later ones are available once they are complete.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.asked = 0.0  # time of the last request, of time.monotonic()
        self.recorded: Json | None = None  # the newest episode
        self.source: tuple[Path, int] | None = None  # its checkpoint, and the time when that was written
        self.taken = False  # whether a page has fetched it
        self.differs = ""  # difference between the game played and that of training
        self.broken: dict[tuple[Path, int], str] = {}  # checkpoints that cannot be played, with reasons
        self.log: tuple[Any, list[Json], str] = None, [], ""  # the file's state, figures, its fault
        self.lock = threading.Lock()  # protects `log`

    def status(self) -> Json:
        """Return the state of the run, see watch.js: message, newest {steps, age}, episode {number, steps}, figures."""
        self.asked = time.monotonic()
        found = self._checkpoints()
        with self.lock:
            figures, wrong = self._figures()
        made = self.recorded
        newest, messages = None, [self._waiting(found)]
        if found:
            path, written = found[0]
            newest = {"steps": steps_of(path), "age": max(0.0, time.time() - written / 1e9)}
            messages.append(self.broken.get(found[0], self.differs))
        return {
            "message": " ".join(filter(None, (*messages, wrong))),
            "newest": newest,
            "episode": made and {"number": made["number"], "steps": made["steps"]},
            "figures": figures,
        }

    def episode(self) -> Json | None:
        """Return the newest episode, see `_published`, or None. After it was fetched, another one is recorded."""
        self.asked, found = time.monotonic(), self.recorded
        self.taken = True
        return found

    def record(self, stop: threading.Event) -> None:
        """Record an episode whenever a newer one is needed, until `stop`."""
        number = 0
        while not stop.is_set():
            if (source := self._wanted()) is None:
                stop.wait(POLL)
            else:
                number += 1
                self._record(source, number, stop)

    def _wanted(self) -> tuple[Path, int] | None:
        """Return the checkpoint whose episode is to be recorded now, if any."""
        if time.monotonic() - self.asked > AWAY:
            return None
        source = next((found for found in self._checkpoints() if found not in self.broken), None)
        return source if source != self.source or self.taken else None

    def _record(self, source: tuple[Path, int], number: int, stop: threading.Event) -> None:
        path, _ = source
        try:
            with episode(path, seed=number, most=MOST) as played:
                game, differs = played.scenario.name, played.differs
                known = {"number": number, "steps": steps_of(path), "game": game}
                self.differs = f"This {game} differs from the game of its training: {differs}." if differs else ""

                def grown(recorded: Recorded) -> None:
                    """Publish the beginning of an episode at ticks 0, 1, 3, 7, ..., before the first complete one."""
                    ticks = _ticks(recorded)
                    if not ticks & (ticks - 1) and not (self.recorded and self.recorded["whole"]):
                        self.recorded = _published(known, recorded, whole=False)

                found = record_ticks(
                    played.worlds, itertools.takewhile(lambda _: not stop.is_set(), played.ticks), [0], after=grown
                )
                made = _published(known, found, whole=True)
        except Exception as error:  # of the file, of the world: an older checkpoint may still play
            why = (str(error) or type(error).__name__).replace(str(path), "it")
            self.broken[source] = f"{path.name} cannot be played: {why}."
            logger.warning("%s cannot be played: %s", path, why)
            return
        if stop.is_set():
            return
        self.recorded, self.source, self.taken = made, source, False

    def _checkpoints(self) -> list[tuple[Path, int]]:
        """Return the checkpoints and their times (nanoseconds since 1970), the newest first."""
        found = []
        with contextlib.suppress(OSError):  # the folder cannot be read now
            for path in reversed(checkpoints(self.folder)):
                with contextlib.suppress(OSError):  # it was just removed
                    found.append((path, path.stat().st_mtime_ns))
        return found

    def _waiting(self, found: list[tuple[Path, int]]) -> str:
        if not self.folder.is_dir():
            return f"The folder {self.folder} does not exist any more."
        if not found:
            return f"{self.folder} has no checkpoint yet: the first one will be played."
        return "" if self.recorded or self.broken.keys() >= {*found} else "The first episode is being played."

    def _figures(self) -> tuple[list[Json], str]:
        """Return the figures of the log, read again when it has changed; and its fault."""
        path = self.folder / curves.LOG
        try:
            status = path.stat()
        except OSError:  # the file does not exist yet
            return [], ""
        if not status.st_size:  # its first line is not written yet
            return [], ""
        state = status.st_mtime_ns, status.st_size
        if self.log[0] != state:
            try:
                self.log = state, figures(curves.read_log(path)), ""
            except TrainingError as error:
                self.log = state, self.log[1], f"{error}."
        return self.log[1:]


def figures(points: curves.Points) -> list[Json]:
    """Return the figures of a log: {group, name, text, points [[agent-steps, value], ...] or None without a chart}."""
    by_step: dict[int, dict[str, float]] = {}
    for tag, rows in points.items():
        for step, value in rows:
            by_step.setdefault(step, {})[tag] = value
    series: dict[tuple[str, str], list[tuple[int, float]]] = {}
    for step, tags in sorted(by_step.items()):
        for figure in headline(tags):
            series.setdefault((figure.group, figure.name), []).append((step, figure.value))
    return [
        {
            "group": figure.group,
            "name": figure.name,
            "text": figure.text,
            "points": _thinned(series.get((figure.group, figure.name), [])) if figure.group in CHARTED else None,
        }
        for figure in headline({tag: rows[-1][1] for tag, rows in points.items()})
    ]


def _thinned(points: list[tuple[int, float]]) -> list[tuple[int, float]]:
    """Reduce points to at most POINTS, each the mean of neighbours, at the last of their agent-steps."""
    size = max(1, -(-len(points) // POINTS))
    parts = [points[k : k + size] for k in range(0, len(points), size)]
    return [(part[-1][0], sum(value for _, value in part) / len(part)) for part in parts]


def _ticks(recorded: Recorded) -> int:
    """Return the number of ticks of the only world, including the reset."""
    return sum(len(episode.rows) for episodes in recorded.values() for episode in episodes)


def _published(known: Json, recorded: Recorded, *, whole: bool) -> Json:
    """Return an episode for a page, {number, steps, game, ticks, whole, data: base64 of `pack`}.

    known: Known beforehand: number, steps, game. ticks: How many there are so far. whole: Whether these are all.
    """
    data = base64.b64encode(pack([PageRoom(known["game"], recorded)])).decode()
    return known | {"ticks": _ticks(recorded), "whole": whole, "data": data}
