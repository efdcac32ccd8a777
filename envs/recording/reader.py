"""Reading a recording: every checksum first, then one frame at a time."""

import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from outlast.ecs import RESET, EngineError

from ..errors import RecordingError, ScenarioError
from ..scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word
from ..scenarios.scenario import Scenario
from ..scenarios.serialize import classes, planned, rebuilt
from .container import DONE, HEAD, RUNS, Frame, content, damaged, frames, unpack
from .recorder import LARGEST
from .tick_records import Run, Shape
from .tick_records import unpack as unpack_runs

COUNT = (1, 2**31)  # of worlds or agents
LONGEST = 2**20  # bytes of JSON in the header
USUAL, SHARE = 2**30, 10_000  # bytes of worlds that any file may ask for, and more for each of its own bytes


class Recording:
    """A recording; made by `open`. len(recording) runs of the tick are whole, of which the first resets all worlds.

    header: what it says of itself. scenario, num_worlds, num_agents (in each), first_world: as in SurvivalVectorEnv.
    cut: in words, that its end is missing, as its writer was killed or still runs; else empty.
    """

    def __init__(self, path: str, header: dict[str, Any], scenario: Scenario, found: list[Frame], size: int) -> None:
        self.path, self.header, self.scenario = path, header, scenario
        self.components: list[str] = header["digests"]["components"]
        self.num_worlds, self.num_agents, self.first_world = (
            header[key] for key in ("worlds", "agents", "first_world")
        )
        self._frames = [each for each in found if each.tag == RUNS]
        self._length = sum(each.runs for each in self._frames)
        self.cut = "" if found[-1].tag == DONE else self._told(size - found[-1].end)

    @classmethod
    def open(cls, path: str | os.PathLike[str], scenario: Scenario | None = None) -> "Recording":
        """Read a file and check all of it; what a killed writer left unfinished at its end is dropped (see `cut`).

        scenario: needed if some of its mechanics are not outlast's own, as what a file names is never imported. Raises
        RecordingError for what is not a recording, or damaged, or of another scenario; and OSError.
        """
        name, size = os.fspath(path), Path(path).stat().st_size
        with open(path, "rb") as file:
            found = list(frames(file, name, size))
            if not found or found[0].tag != HEAD:
                raise RecordingError(f"{name} is not a recording: it ends before it says what was recorded")
            _check_order(name, found)
            header = _header(file, name, found[0])
            recording = cls(name, header, _scenario(name, header, scenario), found, size)
            recording._check_size(size)
            recording._check_begin(file)
        return recording

    def _told(self, lost: int) -> str:
        return f"{self.path} was cut off: {len(self)} runs of the tick are whole, {lost} bytes after them are left out"

    def __len__(self) -> int:
        return self._length

    def runs(self) -> Iterator[Run]:
        """The recorded runs, one after another; read a frame at a time. Raises RecordingError."""
        shape = self.shape
        with open(self.path, "rb") as file:
            for each in self._frames:
                yield from self._unpacked(file, each, shape)

    @property
    def shape(self) -> Shape:
        """What its runs have in common."""
        count = math.prod(size for _, _, size in self.header["actions"])
        return Shape(
            self.num_worlds,
            self.num_agents,
            np.min_scalar_type(count - 1),
            len(self.components),
            self.header["digests"]["repeat"],
        )

    def _check_size(self, size: int) -> None:
        """Worlds of absurd size are not begun with: few bytes could ask for very many. size: of the file, bytes."""
        try:
            agents, each = planned(self.scenario)
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{self.path}: its worlds cannot be made: {error}") from None
        if agents != self.num_agents:
            raise RecordingError(f"{self.path}: agents are {self.num_agents} there and {agents} here")
        if (asked := each * self.num_worlds) > (most := USUAL + SHARE * size):
            raise RecordingError(
                f"{self.path}: its worlds would take {asked} bytes: {most} are given to a file so small"
            )

    def _check_begin(self, file: BinaryIO) -> None:
        """The first run keys and resets all worlds: as many as the header says."""
        for each in self._frames[:1]:
            run = self._unpacked(file, each, self.shape)[0]
            if (run.mode != RESET).any() or not np.array_equal(run.keys[:, 0], np.arange(self.num_worlds)):
                raise RecordingError(f"{self.path} does not begin with a reset of all worlds")

    def _unpacked(self, file: BinaryIO, each: Frame, shape: Shape) -> list[Run]:
        whole = unpack(content(file, self.path, each), self.path, each, LARGEST + shape.most)
        try:
            return list(unpack_runs(whole, each.runs, shape))
        except ValueError:
            raise damaged(self.path, each.offset) from None


def _check_order(path: str, found: list[Frame]) -> None:
    """Every frame goes on where the one before it ended."""
    runs = 0
    for k, each in enumerate(found):
        known = (HEAD,) if k == 0 else (RUNS, DONE)
        if each.tag not in known or each.first != runs or (each.runs > 0) != (each.tag == RUNS):
            raise RecordingError(f"{path}: the frame at byte {each.offset} does not follow the one before it")
        runs += each.runs


def _header(file: BinaryIO, path: str, head: Frame) -> dict[str, Any]:
    """The header, with everything in it of the right kind."""
    whole = unpack(content(file, path, head), path, head, LONGEST)
    try:
        header = json.loads(whole)
        fits = _fits(header)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        fits = False
    if not fits:
        raise RecordingError(f"{path} is not a recording: its header does not say what was recorded")
    return dict(header)


def _fits(header: Any) -> bool:
    digests, actions = header["digests"], header["actions"]
    numbers = [header["worlds"], header["agents"], header["first_world"], digests["worlds"], digests["repeat"]]
    names = [header["outlast"], header["machine"], *header["modules"], *digests["components"]]
    columns = all(is_word(key) and type(low) is type(size) is int and size >= 1 for key, low, size in actions)
    return bool(
        all(type(number) is int and number >= 0 for number in numbers)
        and COUNT[0] <= header["worlds"] <= COUNT[1]
        and COUNT[0] <= header["agents"] <= COUNT[1]
        and header["first_world"] < 2**62
        and all(map(is_word, names))
        and type(header["modules"]) is type(digests["components"]) is list
        and is_fingerprint(header["scenario"])
        and columns
        and math.prod(size for _, _, size in actions) <= 2**32
        and digests["worlds"] >= 1
        and digests["repeat"] >= 1
        and len(digests["components"]) <= LONGEST
    )


def _scenario(path: str, header: dict[str, Any], given: Scenario | None) -> Scenario:
    """The scenario of the file, or the one given if it is the same."""
    if given is None:
        try:
            return rebuilt(header["scenario"], header["modules"])
        except (ScenarioError, EngineError, KeyError) as error:
            raise RecordingError(f"{path}: {error}") from None
    if other := difference(header["scenario"], fingerprint(given)):
        raise RecordingError(f"{path} is of another scenario {other}")
    if header["modules"] != classes(given):
        raise RecordingError(f"{path} was made with {header['modules']}: the scenario given has {classes(given)}")
    return given
