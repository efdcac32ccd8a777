"""Packing: an episode as columns of numbers, small enough for a page.

A column has a row of numbers for each tick. Of integers, the differences from tick to tick are stored, entry by entry
of the row, in as few bytes as they need (1, 2 or 4, little-endian); rewards and values are float32. All columns of all
episodes are then compressed together. Counts are exact; lengths are in millimetres, angles in parts of a turn,
probabilities and attention in percent (-1: unknown). recording.js is the reader.

Every number fits, however long the episode is: a turn has as many parts as 2 bytes have values, so an angle and its
differences wrap around without a jump, and anything else out of the range of int32 becomes the nearest number in it.
"""

import gzip
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...core.validation import Array
from ...inspect.world_json import Json

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


@dataclass
class PageRoom:
    """A recording as a page shows it: its title, and its episodes by world."""

    title: str
    recorded: dict[int, list[EpisodeTrack]]


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
        table["agent.likely"], table["agent.attends"] = (
            _percent(thoughts[name]) for name in ("probabilities", "attention")
        )
    return table


def pack(rooms: Sequence[PageRoom]) -> bytes:
    """Return recordings as gzip: the length of the JSON header (uint32, little-endian), the header, all columns.

    The header: [{title, worlds: [{world, episodes: [{description, number, start, length, events, columns: [[name,
    numbers in a row, bytes of a number (0: float32)]]}]}]}].
    """
    blobs: list[bytes] = []
    header = [
        {
            "title": room.title,
            "worlds": [{"world": w, "episodes": [_packed(e, blobs) for e in es]} for w, es in room.recorded.items()],
        }
        for room in rooms
    ]
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
    low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
    fits = [bits for bits in (8, 16) if -(2 ** (bits - 1)) <= low and high < 2 ** (bits - 1)]
    return np.dtype(f"<i{fits[0] // 8 if fits else 4}")


def _places(of: str, bodies: Sequence[Json]) -> dict[str, list[int]]:
    lengths = {f"{of}.{name}": [round(METRE * body[name]) for body in bodies] for name in ("x", "y")}
    return lengths | {f"{of}.angle": [round(RADIAN * body["angle"]) % TURN for body in bodies]}


def _bits(values: Any) -> list[int]:
    """Return the bits of values as float32."""
    return np.asarray(values, np.float32).view(np.int32).tolist()


def _percent(shares: Array) -> list[int]:
    """Return shares in percent, -1 where they are unknown; clipped, as files may hold any number."""
    known = np.nan_to_num(np.rint(WHOLE * shares.astype(np.float32)), nan=-1)
    return known.clip(-1, WHOLE).astype(int).ravel().tolist()


def _bitset(bodies: list[int] | None, count: int) -> list[int]:
    if bodies is None:
        return [-1] * count
    bits = [0] * count
    for body in bodies:
        bits[body // WORD] |= 1 << body % WORD
    return bits
