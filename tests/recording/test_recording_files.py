"""Recordings that were cut, damaged, forged or left by a killed process: whole as far as they go, or refused."""

import json
import os
import re
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from outlast.envs.cli.main import main
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, file_format, replay
from outlast.envs.recording.file_format import DONE, HEAD, HEADER_SIZE, MAGIC, RECORDS, encode_chunk
from tests.recording.test_recording import recorded, replayed_ticks


@pytest.fixture(scope="module")
def small(tmp_path_factory: Any) -> bytes:
    folder = tmp_path_factory.mktemp("small")
    largest, file_format.MAX_PENDING_BYTES = file_format.MAX_PENDING_BYTES, 300
    try:
        return recorded(folder / "a.rec", 12, worlds=1).read_bytes()
    finally:
        file_format.MAX_PENDING_BYTES = largest


def opened(path: Path) -> Recording | str:
    try:
        return Recording.open(path)
    except RecordingError as error:
        return str(error)


def test_cut_at_every_byte_it_opens_with_fewer_ticks_or_says_why(tmp_path: Path, small: bytes) -> None:
    path, lengths, refused = tmp_path / "a.rec", list[int](), set[int]()
    path.write_bytes(small)
    for size in reversed(range(len(small))):
        os.truncate(path, size)
        found = opened(path)
        if isinstance(found, str):
            refused.add(size)
            continue
        assert found.cut
        assert len(list(found.tick_records())) == len(found)
        lengths.append(len(found))
    assert refused == set(range(small.index(RECORDS)))  # where not even the header is whole
    assert lengths == sorted(lengths, reverse=True)
    assert len(set(lengths)) >= 4  # chunks
    assert lengths[0] == 13
    path.write_bytes(small)
    assert not Recording.open(path).cut


@pytest.mark.parametrize("stride", [7, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_flipped_bit_anywhere_is_refused(tmp_path: Path, small: bytes, stride: int) -> None:
    path = tmp_path / "a.rec"
    path.write_bytes(small)
    with path.open("r+b", buffering=0) as file:
        for position in range(0, len(small), stride):
            byte = small[position]
            for now in (byte ^ 1 << position % 8, byte):
                file.seek(position)
                file.write(bytes([now]))
                found = opened(path)
                assert isinstance(found, Recording) == (now == byte)
                assert now == byte or re.search(r"is damaged at byte \d+|is not a recording|version", str(found))


def test_damage_in_the_middle_is_named_by_its_place_and_the_rest_can_be_saved(tmp_path: Path, small: bytes) -> None:
    path = tmp_path / "a.rec"
    third = [k for k in range(len(small)) if small[k : k + 4] == RECORDS][2]
    path.write_bytes(small[: third + HEADER_SIZE + 3] + b"!" + small[third + HEADER_SIZE + 4 :])
    with pytest.raises(RecordingError, match=f"is damaged at byte {third}: a checksum does not fit"):
        Recording.open(path)
    path.write_bytes(small[:third])
    assert replayed_ticks(Recording.open(path)) > 3


def test_chunks_that_are_missing_or_doubled_are_found(tmp_path: Path, small: bytes) -> None:
    starts = [k for k in range(len(small)) if small[k : k + 4] in (HEAD, RECORDS, DONE)] + [len(small)]
    head, *chunks, done = (small[a:b] for a, b in pairwise(starts))
    orders = (
        [head, *chunks[1:]],
        [head, chunks[0], chunks[0]],
        [head, chunks[0], *chunks[2:]],
        [head, *chunks[:2], done],
        [*chunks],
    )
    for parts in (*orders, [head, head, *chunks], [head, *chunks, done, b"more"]):
        (tmp_path / "a.rec").write_bytes(MAGIC + b"".join(parts))
        with pytest.raises(RecordingError, match=r"not follow the previous one|bytes follow its end|is not a rec"):
            Recording.open(tmp_path / "a.rec")


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.rec"
    for content in (b"", b"PK\x03\x04", b"outlast recording", os.urandom(1000), MAGIC, MAGIC + b"\0" * 100):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=r"is not a recording|is damaged at byte 20"):
            Recording.open(path)
    path.write_bytes(b"outlast recording 2\n" + b"\0" * 100)
    with pytest.raises(RecordingError, match="has version 2 of the format: this outlast reads version 1"):
        Recording.open(path)
    with pytest.raises(FileNotFoundError):
        Recording.open(tmp_path / "nowhere.rec")


def header(small: bytes, **changes: Any) -> bytes:
    """The recording with another header, its checksums right."""
    end = small.index(RECORDS)
    found = json.loads(zlib.decompress(small[len(MAGIC) + HEADER_SIZE : end]))
    return MAGIC + encode_chunk(HEAD, json.dumps(found | changes).encode(), 0, 0) + small[end:]


def test_large_worlds_of_a_file_that_is_trusted(small: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.rec"
    path.write_bytes(small)
    monkeypatch.setattr(replay, "MAX_WORLDS_BYTES", 0)
    monkeypatch.setattr(replay, "MORE_FOR_EACH_BYTE", 0)
    with pytest.raises(RecordingError, match=r"trust=True\) or replay --trust"):
        Recording.open(path)
    assert len(Recording.open(path, trust=True)) > 0
    assert main(["replay", str(path), "--quiet"]) == 2
    assert main(["replay", str(path), "--quiet", "--trust"]) == 0


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"worlds": 0}, "does not describe a recording"),
        ({"agents": 3}, "is damaged|agents are 3 there and 2 here"),
        ({"actions": [["ahead", -1, 3]]}, "is damaged|actions are"),
        ({"digests": None}, "does not describe a recording"),
        ({"digests": {"components": ["Clock"], "worlds": 64, "repeat": 1}}, "is damaged|components are"),
        ({"modules": ["os.path"]}, r"the mechanic os\.path is not one of outlast's own.*scenario=\.\.\."),
        ({"modules": ["outlast.systems.melee.Melee"]}, "unknown number .*another version of outlast"),
        *(
            ({"policy": wrong}, "does not describe a recording")
            for wrong in (None, {}, {"entities": [["heals", -1]]}, {"entities": [["heals", 1.5]]})
        ),
        ({"policy": {"entities": []}}, "is damaged at byte"),  # thoughts of another length
        ({"scenario": {"name": "x", "numbers": {}}}, "is missing; was it made by another version"),
    ],
)
def test_headers_that_cannot_be_are_refused(tmp_path: Path, small: bytes, changes: Any, reason: str) -> None:
    path = tmp_path / "a.rec"
    path.write_bytes(header(small, **changes))
    with pytest.raises(RecordingError, match=reason):
        replayed_ticks(Recording.open(path))


def test_a_chunk_that_claims_too_much_is_refused(tmp_path: Path, small: bytes) -> None:
    path = tmp_path / "a.rec"
    path.write_bytes(small[: small.index(RECORDS)] + encode_chunk(RECORDS, b"\0" * 10**8, 5, 0))
    with pytest.raises(RecordingError, match="claims to hold 100000000 bytes"):
        list(Recording.open(path).tick_records())
