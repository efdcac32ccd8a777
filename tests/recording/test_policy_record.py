"""Recordings with what a policy thought: it comes back tick by tick, readers of before leave it unread."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.errors import RecordingError
from outlast.envs.recording import Recording, Replay, recorder
from outlast.envs.recording.container import HEAD, MAGIC, RECORDS, encode_chunk, read_chunks, read_content
from outlast.envs.rollout.policies import random_policy
from tests.helpers.thinker import ENTITIES, Thinker

Json = dict[str, Any]


@pytest.fixture
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder, "MAX_PENDING_BYTES", 3000)


def recorded(path: Path, plays: Callable[[Any], Any] | None = None) -> list[tuple[Any, Any, Any]]:
    """A recording of 60 ticks of 3 worlds; what was thought ahead of each, NaN where a world was reset."""
    env = outlast.make_vec(outlast.variant("ffa_2").replace(ending_limit=20), 3, seed=1)
    thinker, thoughts = Thinker(), []
    with outlast.record(env, path, policy=thinker, plays=None if plays is None else lambda: plays(env)):
        observations, _ = env.reset()
        act = random_policy(env, 0)
        for _ in range(60):
            thoughts.append(Thinker()(observations))
            observations, *_ = env.step(act(observations))
    assert thinker.told[0] == [True] * 3
    assert len(thinker.told) == 3  # at the start of each episode
    return thoughts


def test_what_was_thought_comes_back(tmp_path: Path, short_chunks: None) -> None:
    thoughts = recorded(tmp_path / "a.rec")
    recording = Recording.open(tmp_path / "a.rec")
    assert recording.entities == ENTITIES
    replay, stepped = Replay(recording), 0
    for tick in replay.ticks():
        assert replay.policy is not None
        for w in range(3):
            row = replay.policy[w]
            if replay.worlds.mode[w] != 1:
                assert all(np.isnan(row[name]).all() for name in row.dtype.names)
                continue
            value, likely, attention = (each[w] for each in thoughts[tick - 1])
            stepped += 1
            np.testing.assert_array_equal(row["value"], value.astype(np.float32))
            np.testing.assert_array_equal(row["probabilities"], likely.astype(np.float16))
            np.testing.assert_array_equal(row["attention"], attention.astype(np.float16))
    assert stepped == 3 * (60 - 2)  # two of the ticks began an episode


def test_agents_of_others_are_unknown(tmp_path: Path) -> None:
    recorded(tmp_path / "a.rec", lambda env: np.array([[True, False]] * 3))
    replay = Replay(Recording.open(tmp_path / "a.rec"))
    for _ in replay.ticks(last=5):
        pass
    assert replay.policy is not None
    assert np.isnan(replay.policy["probabilities"]).all(-1).tolist() == [[False, True]] * 3


# ---- files


def parts(path: Path) -> tuple[Json, list[tuple[bytes, bytes, int, int, bytes]]]:
    """The header, and the chunks behind it as arguments of `encode_chunk`, what the policy thought unpacked."""
    recording = Recording.open(path)
    size, found = recording._format.policy.itemsize, []
    steps = iter([len(record.codes) for record in recording.tick_records()])
    with path.open("rb") as file:
        head, *chunks = read_chunks(file, "", path.stat().st_size)
        header = json.loads(read_content(file, "", head, 2**20)[0])
        for chunk in chunks:
            content, _ = read_content(file, "", chunk, 2**20)
            count = sum(next(steps) for _ in range(chunk.ticks)) * recording.num_agents * size
            found.append((chunk.tag, content, chunk.ticks, chunk.first, bytes(count)))
    return header, found


def written(path: Path, header: Json, chunks: list[tuple[bytes, bytes, int, int, bytes]]) -> Path:
    path.write_bytes(MAGIC + b"".join(encode_chunk(*c) for c in [(HEAD, json.dumps(header).encode(), 0, 0), *chunks]))
    return path


def test_readers_of_before_leave_it_unread(tmp_path: Path, short_chunks: None) -> None:
    """They know nothing of a policy in the header, and do not look behind the tick records."""
    recorded(tmp_path / "a.rec")
    recorded_with = Recording.open(tmp_path / "a.rec")
    header, chunks = parts(tmp_path / "a.rec")
    del header["policy"]
    before = Recording.open(written(tmp_path / "b.rec", header, chunks))
    assert len(before) == len(recorded_with) == 61
    assert before.entities == []
    assert all(record.policy is None for record in before.tick_records())
    replay = Replay(before)
    assert sum(1 for _ in replay.ticks()) == 61
    assert replay.policy is None


@pytest.mark.parametrize(
    "policy",
    [
        *(None, [], {}, 3, {"entities": None}, {"entities": [3]}, {"entities": [["heals"]]}),
        *({"entities": [["heals", -1]]}, {"entities": [["heals", 2**40]]}, {"entities": [["\x1b[31m", 1]]}),
        *({"entities": [["heals", 1.5]]}, {"entities": [["heals", True]]}),
    ],
)
def test_headers_that_make_no_sense_are_refused(tmp_path: Path, policy: Any) -> None:
    recorded(tmp_path / "a.rec")
    header, chunks = parts(tmp_path / "a.rec")
    with pytest.raises(RecordingError, match="header does not describe a recording"):
        Recording.open(written(tmp_path / "b.rec", header | {"policy": policy}, chunks))


@pytest.mark.parametrize("change", [lambda thought: b"", lambda thought: thought[:-1], lambda thought: thought + b"x"])
def test_thoughts_of_another_length_are_damage(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    """Also behind correct checksums."""
    recorded(tmp_path / "a.rec")
    header, chunks = parts(tmp_path / "a.rec")
    changed = [(tag, *rest, change(thought) if tag == RECORDS else b"") for tag, *rest, thought in chunks]
    with pytest.raises(RecordingError, match="is damaged at byte"):
        list(Recording.open(written(tmp_path / "b.rec", header, changed)).tick_records())
