"""Pages that replay: one HTML file with the ticks of some worlds, or of recordings, and everything needed to play them.

An episode is packed as columns of numbers. A column has a row of numbers for each tick. Of integers, the differences
from tick to tick are stored, entry by entry of the row, in as few bytes as they need (1, 2 or 4, little-endian);
rewards and values are float32. All columns of all episodes are then compressed together. Counts are exact; lengths are
in millimetres, angles in parts of a turn, probabilities and attention in percent (-1: unknown). recording.js is the
reader.

Every number fits, however long the episode is: a turn has as many parts as 2 bytes have values, so an angle and its
differences wrap around without a jump, and anything else out of the range of int32 becomes the nearest number in it.
"""

import base64
import contextlib
import gzip
import html
import json
import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from outlast.components import Side
from outlast.ecs import Clock, Worlds

from ..core.validation import Array
from ..errors import PageError
from ..progress import Progress
from ..recording import Recording, Replay
from ..recording.replay import last_tick, rows_of
from ..storage.outputs import atomic_write, check_file, written_to
from .assets import SHARED, assemble
from .world_json import Json, bodies_of, describe, events, snapshot

PLAYING = (
    *("recording.js", "panel.js", "events.js", "views.js", "timeline.js", "event_list.js", "mind.js"),
    *("facts.js", "room.js", "address.js", "controls.js", "player.js"),
)

MOST = 2000  # ticks in a notebook, which take about a megabyte in its file
HEIGHT = 780  # pixels of a page in a notebook
Source = Recording | str | os.PathLike[str]

METRE, TURN, WHOLE = 1000, 2**16, 100  # the integer for a metre, for a full turn, and for a probability of 1
RADIAN = TURN / (2 * math.pi)
WORD = 16  # bodies in each number of a bitset
PACKING = {"metre": METRE, "radian": RADIAN, "whole": WHOLE, "word": WORD}  # constants for recording.js
FLOATS = ("agent.reward", "agent.value")  # columns that are float32
ANGLES = ("agent.angle", "object.angle")
INT32 = np.iinfo(np.int32)


@dataclass
class EpisodeTrack:
    """The record of one episode of one world.

    sizes: how many numbers a row has of each column, see `columns`. rows: for each tick its numbers, int32 in that
    order; numbers of FLOATS are the bits of a float32.
    """

    description: Json
    number: int
    start: int  # tick of the first row
    sizes: dict[str, int] = field(default_factory=dict)
    rows: list[Array] = field(default_factory=list)
    events: list[Json] = field(default_factory=list)  # each with the index of its row as "at"

    def add(self, snapshot: Json, events: Iterable[Json], thoughts: Array | None = None) -> None:
        """Add the state after a tick, what happened in the tick, and what the policy thought before it, (agents,)."""
        self.events += [{"at": len(self.rows), **event} for event in events]
        table = columns(self.description, snapshot, thoughts)
        self.sizes = {name: len(values) for name, values in table.items()}
        row = np.array([number for values in table.values() for number in values])
        self.rows.append(row.clip(INT32.min, INT32.max).astype(np.int32))


Recorded = dict[int, list[EpisodeTrack]]  # episodes by the number of their world


@dataclass
class PageRoom:
    """A recording as a page shows it: its title, and its episodes by world."""

    title: str
    recorded: Recorded


def write_page(
    path: str | os.PathLike[str], worlds: Worlds, ticks: Iterable[object], chosen: Sequence[int], *, title: str
) -> None:
    """Write what happens in some worlds as a page that needs no server and no network; completely or not at all.

    Args:
        path: The file to write.
        worlds: The worlds, of which some are shown.
        ticks: An iterator whose items each run the worlds for a tick; the first item comes right after a reset. Each
            tick of a world of 4 agents takes a kilobyte of memory.
        chosen: Numbers of the worlds to show.
        title: Title of the page.

    Raises:
        PageError: A world or folder does not exist, ticks are missing, or the disk is full.
    """
    target = checked(path)
    _save(target, [PageRoom(title, record_ticks(worlds, ticks, chosen))], title)


def _save(target: Path, rooms: Sequence[PageRoom], title: str) -> None:
    """Write a page that shows recordings side by side. Raises PageError."""
    if not all(any(room.recorded.values()) for room in rooms):
        raise PageError("there is nothing to show: not one tick")
    page = page_html(rooms, title)
    with written_to(target, PageError), atomic_write(target) as place:
        place.write_text(page, encoding="utf-8", newline="\n")


def page_html(rooms: Sequence[PageRoom], title: str) -> str:
    """Return the page itself, as HTML."""
    data = base64.b64encode(pack(rooms)).decode()
    return assemble(title, "replay", (*SHARED, *PLAYING, "replay.js"), data=data, PACKING=PACKING)


def record_ticks(
    worlds: Worlds,
    ticks: Iterable[object],
    chosen: Sequence[int],
    replay: Replay | None = None,
    after: Callable[[Recorded], object] = lambda recorded: None,
) -> Recorded:
    """Return the episodes of each `chosen` world, as far as the ticks go. chosen: rows of the tables.

    A world whose clock stands still was not run, so nothing is recorded; if its clock jumps, an episode starts.
    replay: the replay that runs the worlds, if one does. It may have a policy to show; its episodes count from 1.
    after: called after each tick with what has been recorded so far.
    """
    rows = {int(w): list[EpisodeTrack]() for w in chosen}
    if (unknown := [w for w in rows if not 0 <= w < worlds.count]) or not rows:
        raise PageError(f"worlds {unknown or 'to show: none'}; choose among 0 to {worlds.count - 1}")
    if Side not in worlds:
        raise PageError("there is nothing to show: this scenario has no agents")
    first = 0 if replay is None else replay.recording.first_world
    recorded = {first + w: episodes for w, episodes in rows.items()}
    clocks: dict[int, tuple[int, ...]] = {}
    for _ in ticks:
        for w, episodes in rows.items():
            clock = tuple(int(column[w, 0]) for column in worlds[Clock])
            # a world that is reset twice in a row may have the same clock, but in another episode
            if replay is not None:
                clock = (int(replay.episodes[w]), *clock)
            before = clocks.get(w)
            if clock == before:
                continue
            if before is None or clock != (*before[:-1], before[-1] + 1):
                *_, number, tick = clock
                number = number if replay is None else clock[0]
                episodes.append(EpisodeTrack(describe(worlds, w) | _entities(worlds, replay), number, tick))
            clocks[w] = clock
            thoughts = None if replay is None or replay.policy is None else replay.policy[w]
            episodes[-1].add(snapshot(worlds, w), events(worlds, w), thoughts)
        after(recorded)
    return recorded


def _entities(worlds: Worlds, replay: Replay | None) -> Json:
    """Return what the recorded policy attends to: {entities: [{key, rows, others, first}]}; {} without a policy.

    others: whether the rows are the other agents, in order. first: number of the body in the first row, -1: unknown.
    If a key is the plural of an archetype's name, its rows are the bodies of that archetype, in order.
    """
    if replay is None or replay.policy is None:
        return {}
    numbers, found = bodies_of(worlds.layout).numbers, []
    for key, rows in replay.recording.entities:
        spans = [
            span for kind, span in worlds.layout.spans.items() if key in (f"{kind}s", f"{kind}es") and len(span) == rows
        ]
        first = numbers[spans[0].start] if spans else -1
        found.append({"key": key, "rows": rows, "others": key == "others", "first": first})
    return {"entities": found}


def checked(path: str | os.PathLike[str], *sources: Path) -> Path:
    """Return the path of a page that shows `sources`. Raises PageError, before anything runs, if it is not possible."""
    target = check_file(path, "pages", PageError, endings=(".html",))
    if target.exists() and any(target.samefile(source) for source in sources if source.exists()):
        raise PageError(f"{target} is the recording itself: give another name for the page")
    return target


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
    sources = [recording] if beside is None else [recording, beside]
    opened = [source if isinstance(source, Recording) else Recording.open(source) for source in sources]
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
    _save(target, rooms, title or " beside ".join(room.title for room in rooms))
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


def columns(description: Json, snapshot: Json, thoughts: Array | None = None) -> dict[str, list[int]]:
    """Return the numbers of a snapshot by column. -1: empty slots, and bitsets of agents that see everything.

    thoughts: file_format.policy_dtype (agents,), if the description has `entities`.
    """
    agents, objects, slots = snapshot["agents"], snapshot["objects"], description["slots"]
    words = -(-(len(agents) + len(objects)) // WORD)  # numbers of a bitset of all bodies
    table = {"zone": [round(METRE * value) for value in snapshot["zone"] or ()], **_places("agent", agents)}
    for name in ("alive", "health", "strike", "target"):
        table[f"agent.{name}"] = [int(agent[name]) for agent in agents]
    table["agent.bag"] = [item for agent in agents for item in (agent["bag"] + slots * [-1])[:slots]]
    table["agent.sees"] = [word for agent in agents for word in _bitset(agent["sees"], words)]
    table["agent.rays"] = [round(METRE * far) for agent in agents for far in agent["rays"]]
    table["agent.action"] = [number for agent in agents for number in agent["action"]]
    table["agent.reward"] = _bits([agent["reward"] for agent in agents] if description["rewards"] else [])
    table |= _places("object", objects)
    for name in ("here", "owner", "wound"):
        table[f"object.{name}"] = [int(body[name]) for body in objects]
    if description["looks"]:
        table |= {f"body.{name}": [int(each) for each in snapshot[f"{name}s"]] for name in ("ring", "line")}
    if thoughts is not None:
        table["agent.value"] = _bits(thoughts["value"])
        for name, key in (("likely", "probabilities"), ("attends", "attention")):
            known = np.nan_to_num(np.rint(WHOLE * thoughts[key].astype(np.float32)), nan=-1)
            table[f"agent.{name}"] = known.clip(-1, WHOLE).astype(int).ravel().tolist()  # as files may hold any number
    return table


def pack(rooms: Sequence[PageRoom]) -> bytes:
    """Return recordings as gzip: the length of the JSON header (uint32, little-endian), the header, all columns.

    The header: [{title, worlds: [{world, episodes: [{description, number, start, length, events, columns: [[name,
    numbers in a row, bytes of a number (0: float32)]]}]}]}].
    """
    blobs: list[bytes] = []
    header = []
    for room in rooms:
        worlds = [{"world": w, "episodes": [_packed(e, blobs) for e in es]} for w, es in room.recorded.items()]
        header.append({"title": room.title, "worlds": worlds})
    text = json.dumps(header, separators=(",", ":")).encode()
    return gzip.compress(len(text).to_bytes(4, "little") + text + b"".join(blobs), mtime=0)


def _packed(episode: EpisodeTrack, blobs: list[bytes]) -> Json:
    """Return the header of an episode, and append its columns to `blobs`."""
    matrix, first, table = np.stack(episode.rows, 1), 0, []
    for name, count in episode.sizes.items():
        values, floats = matrix[first : first + count], name in FLOATS
        steps = values if floats else np.diff(values.astype(np.int64), axis=1, prepend=0)
        steps = steps.astype(np.int16) if name in ANGLES else steps  # the shorter way round
        kind = np.dtype("<i4") if floats else _narrowest(steps)
        table.append((name, count, 0 if floats else kind.itemsize))
        blobs.append(steps.astype(kind).tobytes())
        first += count
    kept = {"description": episode.description, "number": episode.number, "start": episode.start}
    return kept | {"length": len(episode.rows), "events": episode.events, "columns": table}


def _narrowest(values: Array) -> np.dtype[Any]:
    """Return the smallest type that holds all values. Differences of int32 may wrap around; their sums do so back."""
    low, high = int(values.min(initial=0)), int(values.max(initial=0))
    fits = [kind for kind in ("<i1", "<i2") if np.iinfo(kind).min <= low and high <= np.iinfo(kind).max]
    return np.dtype([*fits, "<i4"][0])


def _places(of: str, bodies: Sequence[Json]) -> dict[str, list[int]]:
    lengths = {f"{of}.{name}": [round(METRE * body[name]) for body in bodies] for name in ("x", "y")}
    return lengths | {f"{of}.angle": [round(RADIAN * body["angle"]) % TURN for body in bodies]}


def _bits(values: Any) -> list[int]:
    """Return the bits of values as float32."""
    return np.asarray(values, np.float32).view(np.int32).tolist()


def _bitset(bodies: list[int] | None, count: int) -> list[int]:
    if bodies is None:
        return [-1] * count
    return [sum(1 << body % WORD for body in bodies if body // WORD == k) for k in range(count)]
