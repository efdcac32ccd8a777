"""Fuzz targets: saved states and recordings, mutated also behind correct checksums."""

import contextlib
import hashlib
import io
import json
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

import outlast
from outlast.distributions import choice, integers, uniform
from outlast.ecs import Worlds
from outlast.envs.cli.main import main
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import FaultError, RecordingError, StateError
from outlast.envs.recording import Recording, file_format
from outlast.envs.recording.file_format import FIELDS, HEAD, MAGIC, RECORDS, encode_chunk, read_chunks, read_content
from outlast.envs.snapshots.state import HEADER, VERSION, State, _checksum
from tests.conftest import digest, draw_actions
from tests.fuzz.mutations import (
    INTEGERS,
    Random,
    mutated,
    mutated_json,
    mutated_npy,
    mutated_zip,
    npy,
    to_json,
    unzipped,
    zipped,
)
from tests.helpers.thinker import Thinker

TICKS = (0, 3, 40, 150)  # after which states are saved
FLOATS = (0, -1, 1e-45, 1e-3, 0.5, 12, 25, 1e4, 9.9e5, 1e6, 3e38, -9.9e5, -3e38, np.inf, -np.inf, np.nan)
SMALL = outlast.variant("teams_3").replace(n_heals=4, n_boxes=3)


def folder_of(owner: object) -> Path:
    """A new folder that is deleted with its owner, or when the process ends."""
    folder = Path(tempfile.mkdtemp())
    weakref.finalize(owner, shutil.rmtree, folder, ignore_errors=True)
    return folder


class States:
    """Saved states of two worlds in a batch of three."""

    refusals: ClassVar = (StateError,)
    scenario: ClassVar = SMALL

    def __init__(self) -> None:
        self.env, self.rng = outlast.make_vec(self.scenario, 3, seed=0, render_mode="ansi"), np.random.default_rng(0)
        self.states = [self.env.get_state(slice(2))]  # of worlds before their first reset
        self.env.reset()
        for tick in range(max(TICKS) + 1):
            if tick in TICKS:
                self.states.append(self.env.get_state(slice(2)))
            self.env.step(draw_actions(self.env, self.rng))
        self.files = [_file(state.scenario, state.arrays) for state in self.states]
        self.valid = self.files[-1]

    def mutate(self, rng: Random) -> bytes:
        """A hostile file; most have impossible numbers behind a correct checksum."""
        state, content = rng.choice([*zip(self.states, self.files, strict=True)])
        match rng.randrange(8):
            case 0:
                return mutated(content, rng)
            case 1:
                return mutated_zip(content, rng)
            case 2:
                entries = unzipped(content)
                name = rng.choice([*entries])
                return zipped(entries | {name: mutated_npy(entries[name], rng)})
            case 3:
                return self._header(content, rng)
        arrays = {name: array.copy() for name, array in state.arrays.items()}
        for _ in range(rng.choice((1, 1, 2, 5))):
            self._corrupt(arrays, rng)
        return _file(state.scenario, arrays)

    def use(self, path: Path) -> None:
        """Restore it and step the worlds."""
        state, before = State.load(path), digest(self.env.worlds)
        if len(state) not in (1, 2):
            return
        try:
            self.env.set_state(state, slice(len(state)))
        except StateError:
            assert digest(self.env.worlds) == before, "a refused state has changed the worlds"
            raise
        for _ in range(3):
            if not self.env._tracker.running.all():
                self.env.reset(options={"reset_mask": ~self.env._tracker.running})
            try:
                self.env.step(draw_actions(self.env, self.rng))
            except FaultError:
                self.env.reset()
        self.env.render()

    def _header(self, content: bytes, rng: Random) -> bytes:
        entries = unzipped(content)
        header = json.loads(entries[f"{HEADER}.npy"][128:])
        entries[f"{HEADER}.npy"] = npy(np.frombuffer(to_json(mutated_json(header, rng)), np.uint8))
        return zipped(entries)

    def _corrupt(self, arrays: dict[str, Any], rng: Random) -> None:
        """Change one entry, or one row, of a column of the worlds; rarely of another array, or its shape."""
        name = rng.choice(("world",) * 9 + tuple(arrays))
        column = arrays[name]
        if name == "world" and column.shape[1:] == self.states[0].arrays[name].shape[1:]:
            layout, kinds = self.env.worlds.layout, rng.choice(("iu", "iu", "biuf"))
            packed = [place for place in layout.places if place.offset >= 0]
            place = rng.choice([p for p in packed if p.dtype.kind in kinds])
            column = getattr(layout.columns(column, place.component), place.name)
        elif rng.random() < 0.2:
            shape = rng.choice([(0,), (1,), (3,), (2, 0), (2, 9)])
            arrays[name] = np.zeros(shape, rng.choice((column.dtype, "f8", "i4", "u1")))
            return
        spot = tuple(rng.randrange(max(1, size)) for size in column.shape)
        spot = rng.choice((spot, spot, (spot[0],)))
        if column.size and column.dtype.kind == "f":
            column[spot] = rng.choice(FLOATS)
        elif column.size:
            column = column.view(np.uint8) if column.dtype == bool else column
            number, size = rng.choice((*INTEGERS, *(rng.randrange(-3, 60) for _ in INTEGERS))), column.itemsize
            column[spot] = np.frombuffer((number % 256**size).to_bytes(size, "little"), column.dtype)[0]


VARIED: dict[str, Any] = {
    "n_agents": integers(2, 4), "n_heals": integers(1, 4), "pillars_count": integers(1, 4),
    "motors_ahead": uniform(0.1, 0.4), "cameras_cone": choice("sector", "kite"),
}  # fmt: skip


class LevelStates(States):
    """The same of worlds that have other numbers, counts, roles and walls."""

    scenario: ClassVar = (
        SMALL.with_(outlast.systems.Pillars(count=4))
        .vary(**VARIED)
        .roles(hunter=outlast.role(1, cameras_depth=uniform(8, 14)), prey=outlast.role(), drawn="anyone")
    )


def _file(scenario: dict[str, Any], arrays: dict[str, Any]) -> bytes:
    """A saved state of these arrays, with a correct checksum."""
    header = {"version": VERSION, "scenario": scenario, "checksum": _checksum(arrays)}
    head = npy(np.frombuffer(json.dumps(header).encode(), np.uint8))
    return zipped({f"{HEADER}.npy": head, **{f"{name}.npy": npy(array) for name, array in arrays.items()}})


class Recordings:
    """Recordings of two worlds, in several chunks; replayed, and exported as a page, a dataset and pictures."""

    refusals: ClassVar = (RecordingError,)

    def __init__(self) -> None:
        self.folder = folder_of(self)
        limit, file_format.MAX_PENDING_BYTES = file_format.MAX_PENDING_BYTES, 400
        self.files = [self._recorded(outlast.variant(name), k) for k, name in enumerate(("ffa_1", "teams_3"))]
        self.files.append(self._recorded(outlast.variant("ffa_1"), 2, Thinker()))
        file_format.MAX_PENDING_BYTES = limit
        self.valid = self.files[0]
        self.compiled: dict[Any, bool] = {}

    def _recorded(self, scenario: outlast.Scenario, k: int, policy: Any = None) -> bytes:
        env, path = SurvivalVectorEnv(scenario.replace(ending_limit=9), 2, seed=k), self.folder / f"{k}.rec"
        with outlast.record(env, path, policy=policy):
            env.reset()
            for step in range(14):
                env.step(draw_actions(env, np.random.default_rng(step)))
        env.close()
        return path.read_bytes()

    def _is_compiled(self, recording: Recording) -> bool:
        """Whether its tick is in the compile cache."""
        key = (*recording.header["modules"], recording.scenario.numbers().get("physics_backend"))
        if key not in self.compiled:
            self.compiled[key] = Worlds(recording.scenario.modules, 1).compiled
        return self.compiled[key]

    def mutate(self, rng: Random) -> bytes:
        """A hostile file; most have correct checksums."""
        content = rng.choice(self.files)
        parts = [*_parts(content)]
        k = rng.randrange(len(parts))
        tag, inner, ticks, first, behind = parts[k]
        match rng.randrange(10):
            case 0:
                return mutated(content, rng)
            case 1:
                parts = [rng.choice(parts) for _ in range(rng.randrange(9))]
            case 2:
                parts[k] = (tag, mutated(inner, rng), ticks, first, behind)
            case 3:
                other = rng.choice((HEAD, RECORDS, b"DONE", b"WHAT"))
                parts[k] = (other, inner, rng.choice(INTEGERS) % 2**32, first, behind)
            case 4:
                return _with_chunk_fields(content, rng)
            case 5:
                parts[0] = (HEAD, to_json(mutated_json(json.loads(parts[0][1]), rng)), 0, 0, b"")
            case 6:
                parts[k] = (tag, inner, ticks, first, mutated(behind, rng))
            case _:
                head = json.loads(parts[0][1])
                numbers = head["scenario"]["numbers"]
                for name in rng.sample([*numbers], rng.choice((1, 1, 2, 6))):
                    numbers[name] = rng.choice((*FLOATS, *INTEGERS, *range(2, 40), True, False, [1.0], [3e38, 1e-9]))
                parts[0] = (HEAD, to_json(head), 0, 0, b"")
        return MAGIC + b"".join(encode_chunk(*part) for part in parts)

    def changed(self, content: bytes, changes: dict[str, Any] | None = None, **numbers: Any) -> bytes:
        """A recording with changes to its header and to the numbers of its scenario."""
        first, *rest = _parts(content)
        head = json.loads(first[1]) | (changes or {})
        head["scenario"]["numbers"] |= numbers
        return MAGIC + b"".join(encode_chunk(*part) for part in [(HEAD, to_json(head), 0, 0), *rest])

    def use(self, path: Path) -> None:
        """Run `outlast replay` on it, for some with an export to a page, a dataset or pictures."""
        if not self._is_compiled(Recording.open(path)):
            return  # compiling would take too long
        out = self.folder / "out"
        product = {1: ["--html", f"{out}.html"], 2: ["--data", str(out)], 3: ["--out", f"{out}.apng", "--size", "64"]}
        extra = product.get(path.stat().st_size % 16, [])
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as output:
            status = main(["replay", str(path), "--quiet", *extra])
        for left in self.folder.glob("out*"):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        assert "allocate" not in output.getvalue(), output.getvalue()
        if status == 2:
            raise RecordingError(output.getvalue())


def _parts(content: bytes) -> Iterator[tuple[bytes, bytes, int, int, bytes]]:
    """The chunks of a recording, as arguments of `encode_chunk`."""
    file = io.BytesIO(content)
    for chunk in read_chunks(file, "", len(content)):
        inner, behind = read_content(file, "", chunk, chunk.unpacked)
        yield chunk.tag, inner, chunk.ticks, chunk.first, zlib.decompress(behind) if behind else b""


def _with_chunk_fields(content: bytes, rng: Random) -> bytes:
    """The recording with a wrong number in the header of one chunk, whose checksum is correct."""
    at = rng.choice([*read_chunks(io.BytesIO(content), "", len(content))]).offset
    fields = list(FIELDS.unpack_from(content, at))
    k = rng.choice((1, 2, 3, 4))
    fields[k] = rng.choice((fields[k] + 1, *INTEGERS)) % 2 ** (64 if k == 4 else 32)
    packed = FIELDS.pack(*fields)
    check = hashlib.blake2b(packed, digest_size=8).digest()
    return content[:at] + packed + check + content[at + len(packed + check) :]
