"""Reading a recording: every checksum first, then one chunk at a time."""

import json
import math
import os
from collections.abc import Generator, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from outlast.ecs import RESET, EngineError
from outlast.ecs.kernels.integers import is_whole

from ..errors import RecordingError, ScenarioError
from ..scenarios.fingerprint import classes, difference, fingerprint, is_fingerprint, is_word, planned, rebuilt
from ..scenarios.mechanics import foreign
from ..scenarios.parse import resolve
from ..scenarios.scenario import Scenario
from ..storage import strict_json
from .container import DONE, HEAD, RECORDS, Chunk, damaged, read_chunks, read_content
from .policy_record import is_policy, policy_dtype
from .recorder import MAX_PENDING_BYTES
from .tick_records import MAX_JOINT_ACTIONS, TickFormat, TickRecord, decode_ticks

MAX_COUNT = 2**31  # worlds or agents
MAX_HEADER = 2**20  # bytes of the header's JSON
# bytes of worlds that any file may request, and more for each of its bytes
MAX_WORLDS_BYTES, MORE_FOR_EACH_BYTE = 2**30, 10_000


class Recording:
    """A recording of an environment in a file, made by `open`; len(recording) is the number of its ticks.

    Attributes:
        header: Description in the file: `outlast`, `machine`, `scenario` ...
        scenario: The scenario that was played.
        num_worlds, num_agents, first_world: As in SurvivalVectorEnv; `num_agents` is per world.
        entities: If a policy was recorded, what it attended to: (key of the observation, rows) for each kind.
        cut: Empty, or a sentence about the missing end of the file, because its writer was killed or still runs.
    """

    def __init__(self, path: str, header: dict[str, Any], scenario: Scenario, chunks: list[Chunk], size: int) -> None:
        self.path, self.header, self.scenario = path, header, scenario
        self._place = Path(path).absolute()  # stays right if the working directory changes
        self.components: list[str] = header["digests"]["components"]
        self.num_worlds, self.num_agents, self.first_world = (
            header[key] for key in ("worlds", "agents", "first_world")
        )
        self._chunks = [chunk for chunk in chunks if chunk.tag == RECORDS]
        self._length = sum(chunk.ticks for chunk in self._chunks)
        self._format = TickFormat(
            *(self.num_worlds, self.num_agents, math.prod(size for _, _, size in header["actions"])),
            *(len(self.components), header["digests"]["repeat"]),
            policy_dtype(header["actions"], header["policy"]) if "policy" in header else None,
            header["given"],
        )
        self.entities = [(str(key), int(rows)) for key, rows in header.get("policy", {"entities": []})["entities"]]
        lost = size - chunks[-1].end
        sentence = f"{path} was cut off: {self._length} ticks are complete, {lost} bytes after them are left out"
        self.cut = "" if chunks[-1].tag == DONE else sentence

    @classmethod
    def open(
        cls, path: str | os.PathLike[str], scenario: Scenario | str | None = None, *, trust: bool = False
    ) -> "Recording":
        """Read a file and check all of it. An unfinished end, left by a killed writer, is ignored (see `cut`).

        Args:
            path: A file that `outlast.record` or `outlast rollout --record` wrote.
            scenario: Needed if some of its mechanics are neither outlast's own nor imported, as names in a file are
                never imported: the recorded scenario, or the name of a scenario, such as "mygame.py:arena", which is
                imported for its mechanics, with any numbers.
            trust: Whether its worlds may take as much memory as they need. If not, 1 GiB is the limit, unless the file
                is long.

        Returns:
            The recording. The file is read again, chunk by chunk, when ticks are requested.

        Raises:
            RecordingError: The file is not a recording, is damaged, or is of another scenario.
            OSError: The file cannot be read.
        """
        name, size = os.fspath(path), Path(path).stat().st_size
        with open(path, "rb") as file:
            chunks = list(read_chunks(file, name, size))
            if not chunks or chunks[0].tag != HEAD:
                raise RecordingError(f"{name} is not a recording: it ends before the description of what was recorded")
            _check_order(name, chunks)
            header = _read_header(file, name, chunks[0])
            recording = cls(name, header, _scenario(name, header, scenario), chunks, size)
            recording._check_size(math.inf if trust else MAX_WORLDS_BYTES + MORE_FOR_EACH_BYTE * size)
            recording._check_begin(file)
        return recording

    @property
    def contents(self) -> str:
        """A description of the recording: "teams_3, 64 worlds, 601 ticks"."""
        return f"{self.scenario.name}, {self.num_worlds} worlds, {len(self):,} ticks"

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {self.contents}{', cut off' if self.cut else ''}>"

    def _repr_html_(self) -> str:
        """Return HTML for notebooks: a frame that plays the first world; see web.replay.write.frame."""
        pages = import_module("outlast.envs.web.replay.write")  # imported here, as pages import this package
        return str(pages.frame(self))

    def __len__(self) -> int:
        return self._length

    def tick_records(self) -> Generator[TickRecord, None, None]:
        """Iterate over the records of ticks, reading a chunk at a time. The first tick resets all worlds.

        Yields:
            Modes, joint actions, keys of random numbers and a digest. Resets are ticks, too.

        Raises:
            RecordingError: The file is damaged.
        """
        with self._place.open("rb") as file:
            for chunk in self._chunks:
                yield from self._decoded(file, chunk)

    def _check_size(self, most: float) -> None:
        """Refuse worlds of more than `most` bytes: a small file could request an absurd amount."""
        try:
            agents, each = planned(self.scenario)
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{self.path}: its worlds cannot be made: {error}") from None
        if agents != self.num_agents:
            raise RecordingError(f"{self.path}: agents are {self.num_agents} there and {agents} here")
        if (asked := each * self.num_worlds) > most:
            raise RecordingError(
                f"{self.path}: its worlds would take {asked} bytes: {most} are given to a file so small; if you know "
                "where it is from, open it with Recording.open(path, trust=True) or replay --trust"
            )

    def _check_begin(self, file: BinaryIO) -> None:
        """Check that the first tick keys and resets all worlds, as many as in the header."""
        for chunk in self._chunks[:1]:
            first = self._decoded(file, chunk)[0]
            if (first.mode != RESET).any() or not np.array_equal(first.keys[:, 0], np.arange(self.num_worlds)):
                raise RecordingError(f"{self.path} does not begin with a reset of all worlds")

    def _decoded(self, file: BinaryIO, chunk: Chunk) -> list[TickRecord]:
        content, behind = read_content(file, self.path, chunk, MAX_PENDING_BYTES + self._format.max_bytes)
        try:
            return list(decode_ticks(content, chunk.ticks, self._format, behind))
        except ValueError:
            raise damaged(self.path, chunk.offset) from None


def _check_order(path: str, chunks: list[Chunk]) -> None:
    """Check that every chunk continues where the previous one ended."""
    ticks = 0
    for k, chunk in enumerate(chunks):
        allowed = (HEAD,) if k == 0 else (RECORDS, DONE)
        if chunk.tag not in allowed or chunk.first != ticks or (chunk.ticks > 0) != (chunk.tag == RECORDS):
            raise RecordingError(f"{path}: the chunk at byte {chunk.offset} does not follow the previous one")
        ticks += chunk.ticks


def _read_header(file: BinaryIO, path: str, chunk: Chunk) -> dict[str, Any]:
    """Return the header, in which all values have valid types. Raises RecordingError otherwise."""
    content, _ = read_content(file, path, chunk, MAX_HEADER)
    try:
        header = json.loads(content)
        valid = _is_valid(header)
    except strict_json.BROKEN:
        valid = False
    if not valid:
        raise RecordingError(f"{path} is not a recording: its header does not describe a recording")
    return dict(header)


def _is_valid(header: Any) -> bool:
    digests, actions = header["digests"], header["actions"]
    numbers = [header["worlds"], header["agents"], header["first_world"], digests["worlds"], digests["repeat"]]
    numbers += [header["given"], header.get("episodes", 0)]  # the latter is missing in some recordings
    names = [header["outlast"], header["machine"], *header["modules"], *digests["components"]]
    columns = all(is_word(key) and type(low) is type(size) is int and size >= 1 for key, low, size in actions)
    return bool(
        all(type(number) is int and number >= 0 for number in numbers)
        and 1 <= header["worlds"] <= MAX_COUNT
        and 1 <= header["agents"] <= MAX_COUNT
        and header["first_world"] < 2**62
        and all(map(is_word, names))
        and type(header["modules"]) is type(digests["components"]) is list
        and is_fingerprint(header["scenario"])
        and columns
        and math.prod(size for _, _, size in actions) <= MAX_JOINT_ACTIONS
        and ("policy" not in header or is_policy(actions, header["policy"]))
        and ("played" not in header or _is_played(header["played"], header["agents"]))
        and digests["worlds"] >= 1
        and digests["repeat"] >= 1
        and header["given"] <= MAX_HEADER
        and header.get("episodes", 0) <= MAX_COUNT
        and len(digests["components"]) <= MAX_HEADER
    )


def _is_played(given: Any, agents: int) -> bool:
    return given.keys() == {"agent", "others"} and is_word(given["others"]) and given["agent"] in range(agents)


def _scenario(path: str, header: dict[str, Any], given: Scenario | str | None) -> Scenario:
    """Return the scenario of the file, or the given one if it is the same. Raises RecordingError otherwise."""
    if not isinstance(given, Scenario):
        try:
            if given is not None:
                _import(header, given)
            given = rebuilt(header["scenario"], header["modules"])
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{path}: {error}") from None
    if other := difference(header["scenario"], fingerprint(given)):
        raise RecordingError(f"{path} is of another scenario {other}")
    if sorted(header["modules"]) != classes(given):
        raise RecordingError(f"{path} was made with {header['modules']}: the scenario given has {classes(given)}")
    return given


def _import(header: dict[str, Any], name: str) -> None:
    """Import the named scenario for its mechanics. Raises ScenarioError, also if the file needs no user's mechanics."""
    if not foreign(header["modules"]):
        raise ScenarioError(f"all of its mechanics are outlast's own: leave out the scenario {name}")
    resolve(name)


def last_tick(recording: Recording, first: int, last: int | None) -> int:
    """Return the number of the last tick of a selection, by default that of the recording.

    Raises RecordingError if the ticks do not exist.
    """
    given: list[Any] = [first, 0 if last is None else last]
    if strange := [tick for tick in given if not is_whole(tick)]:
        raise RecordingError(f"tick {strange[0]!r}: integers are needed, counted from 0")
    if not len(recording):
        raise RecordingError(f"{recording.path}: it has no ticks")
    most = len(recording) - 1
    end = most if last is None else last
    if not 0 <= first <= end <= most:
        raise RecordingError(
            f"ticks {first} to {end}: 0 <= from <= to <= {most} is needed, the last tick of {recording.path}"
        )
    return end


def rows_of(recording: Recording, worlds: Any, first: int | None = None) -> list[int]:
    """Return the rows of these worlds in the tables. Raises RecordingError if the worlds do not exist.

    first: Number of the first world; None: that in tables of events and samples, `first_world`.
    """
    if not isinstance(worlds, Iterable):
        raise RecordingError(f"worlds = {worlds!r}: their numbers are needed, as in [0, 3]")
    asked, first = list(worlds), recording.first_world if first is None else first
    last = first + recording.num_worlds - 1
    if odd := [w for w in asked if not is_whole(w)]:
        raise RecordingError(f"world {odd[0]!r}: integers are needed")
    if unknown := [w for w in asked if not first <= w <= last]:
        raise RecordingError(f"{recording.path}: world {unknown[0]} does not exist; they are {first} to {last}")
    return [w - first for w in asked]
