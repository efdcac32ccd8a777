"""Recordings with what a policy thought: it comes back tick by tick, readers of before leave it unread."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.recording import Recording, Replay, file_format
from outlast.envs.recording.file_format import HEAD, MAGIC, encode_chunk, read_chunks, read_content
from outlast.envs.rollout.policies import random_policy
from tests.helpers.thinker import ENTITIES, Thinker


@pytest.fixture
def short_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_format, "MAX_PENDING_BYTES", 3000)


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


def test_readers_of_before_leave_it_unread(tmp_path: Path, short_chunks: None) -> None:
    recorded(tmp_path / "a.rec")
    recorded_with = Recording.open(tmp_path / "a.rec")
    header, chunks = recorded_with.header, []
    with (tmp_path / "a.rec").open("rb") as file:
        for chunk in read_chunks(file, "", (tmp_path / "a.rec").stat().st_size):
            content, thoughts = read_content(file, "", chunk, 2**20)
            content = (
                content
                if chunk.tag != HEAD
                else json.dumps({k: v for k, v in header.items() if k != "policy"}).encode()
            )
            chunks.append(encode_chunk(chunk.tag, content, chunk.ticks, chunk.first, thoughts))
    (tmp_path / "b.rec").write_bytes(MAGIC + b"".join(chunks))
    before = Recording.open(tmp_path / "b.rec")
    assert len(before) == len(recorded_with) == 61
    assert before.entities == []
    assert all(record.policy is None for record in before.tick_records())
    replay = Replay(before)
    assert sum(1 for _ in replay.ticks()) == 61
    assert replay.policy is None
