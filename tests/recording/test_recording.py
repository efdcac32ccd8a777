"""Recordings: what is in them and how much, when they can be begun, and what is refused meanwhile."""

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import Clock
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import ActionError, NotResetError, RecordingError
from outlast.envs.recording import Recording, Replay
from outlast.envs.recording.container import RECORDS
from tests.conftest import draw_actions
from tests.helpers.model import digest_of_episode

SHORT = {"ending_limit": 25, "agents_health": 40}


def make(worlds: int = 3, variant: str = "ffa_1", **options: Any) -> SurvivalVectorEnv:
    return outlast.make_vec(outlast.variant(variant).replace(**SHORT), worlds, seed=1, **options)


def play(env: SurvivalVectorEnv, steps: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(steps):
        env.step(draw_actions(env, rng))


def recorded(path: Path, steps: int, **options: Any) -> Path:
    """A recording of a reset and that many steps."""
    env = make(**options)
    with outlast.record(env, path):
        env.reset()
        play(env, steps)
    env.close()
    return path


CHILD = """
import sys
sys.path.insert(0, {tests!r})
import outlast
from tests.recording.test_recording import make, play
from outlast.envs.recording import record, recorder
recorder.MAX_PENDING_BYTES = 2000
env = make()
record(env, {path!r})
env.reset()
print("ready", flush=True)
play(env, {steps})
"""


def replayed_ticks(recording: Recording) -> int:
    """Replay all of it, digests compared; the number of ticks."""
    return sum(1 for _ in Replay(recording).ticks())


# ---- what is in it


def test_a_byte_an_agent_step(tmp_path: Path) -> None:
    """All included, for 64 worlds of four random agents."""
    env = make(64, "teams_3")
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        play(env, 1000)
    assert (tmp_path / "a.rec").stat().st_size < 1.15 * 1000 * 64 * 4


@pytest.mark.nightly
def test_long_recordings_have_many_chunks(tmp_path: Path) -> None:
    """With the smallest tick records there are: each chunk is as large as a reader takes."""
    path = recorded(tmp_path / "a.rec", 12_000, worlds=1)
    assert path.read_bytes().count(RECORDS) >= 2
    assert replayed_ticks(Recording.open(path)) == 12_001


def test_many_joint_actions_take_two_bytes(tmp_path: Path) -> None:
    """With a seventh action there are 432 of them."""
    env = outlast.make_vec(outlast.variant("ffa_3").with_(outlast.systems.DropLast()), 2, seed=0)
    assert np.prod(env.action_sizes) == 432
    with outlast.record(env, tmp_path / "a.rec") as recorder:
        env.reset()
        play(env, 5)
        assert recorder.ticks == 6
    found = Recording.open(tmp_path / "a.rec")
    assert {record.codes.dtype for record in found.tick_records()} == {np.dtype("<u2")}
    assert replayed_ticks(found) == 6


# ---- when it can be begun, and what is refused meanwhile


def test_it_begins_with_a_reset_of_all_worlds(tmp_path: Path) -> None:
    env = make()
    env.reset()
    outlast.record(env, tmp_path / "a.rec")
    before, some = digest_of_episode(env.worlds), {"reset_mask": np.array([True, False, True])}
    for call in (lambda: play(env, 1), lambda: env.reset(options=some), lambda: env.reset(seed=7, options=some)):
        with pytest.raises(RecordingError, match="reset all worlds first"):
            call()
        assert env.get_state().arrays["started"].all()
    assert before == digest_of_episode(env.worlds)
    env.reset()
    play(env, 3)
    env.close()
    assert replayed_ticks(Recording.open(tmp_path / "a.rec")) == 4


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.rec"
    path.write_text("precious")
    env = make()
    with pytest.raises(RecordingError, match=r"a\.rec exists; recordings never overwrite files"):
        outlast.record(env, path)
    with pytest.raises(RecordingError, match="cannot be written: there is no folder"):
        outlast.record(env, tmp_path / "nowhere" / "a.rec")
    assert path.read_text() == "precious"
    outlast.record(env, tmp_path / "b.rec")  # the environment is as it was
    env.close()


def test_what_is_no_environment_is_not_recorded(tmp_path: Path) -> None:
    env = outlast.adapters.make_agents("ffa_1", 1, seed=0)
    with pytest.raises(
        TypeError, match=r"record\(\) needs an environment of make_vec, not SurvivalAgentVectorEnv: give env\.un"
    ):
        outlast.record(env, tmp_path / "a.rec")
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_recorded_is_refused_meanwhile(tmp_path: Path) -> None:
    env = make(check_actions=False)
    env.reset()
    state = env.get_state()
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        with pytest.raises(RecordingError, match=r"set_state\(\) while a recording goes on; close\(\) that first"):
            env.set_state(state)
        with pytest.raises(RecordingError, match=r"record\(\) while a recording goes on"):
            outlast.record(env, tmp_path / "b.rec")
        with pytest.raises(ActionError, match="0 to 2 is allowed"):
            env.step(np.full((3, 2, 6), 9))
        play(env, 2)
    env.set_state(state)
    play(env, 2)
    assert replayed_ticks(Recording.open(tmp_path / "a.rec")) == 3
    assert not (tmp_path / "b.rec").exists()


def test_another_recording_follows_when_one_is_closed(tmp_path: Path) -> None:
    """In the middle of everything: the second one has the right episode."""
    env, episodes = make(), list[list[int]]()
    for name in ("a.rec", "b.rec"):
        episodes.append(env.worlds[Clock].episode[:, 0].tolist())
        with outlast.record(env, tmp_path / name) as recorder:
            env.reset()
            play(env, 4)
        play(env, 3)
        assert repr(recorder) == f"<Recorder to {tmp_path / name}: 5 ticks, closed>"
    assert [replayed_ticks(Recording.open(tmp_path / name)) for name in ("a.rec", "b.rec")] == [5, 5]
    (keyed,) = (record.keys for record in Recording.open(tmp_path / "b.rec").tick_records() if len(record.keys))
    assert keyed[:, 3].tolist() == episodes[1] != episodes[0]


def test_a_tick_that_is_interrupted_is_not_recorded(tmp_path: Path, monkeypatch: Any) -> None:
    env, path = make(), tmp_path / "a.rec"
    outlast.record(env, path)
    env.reset()
    play(env, 4)
    run = env.worlds.run

    def interrupted(mode: Any) -> None:
        run(mode)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(env.worlds, "run", interrupted)
        with pytest.raises(KeyboardInterrupt):
            play(env, 1)
    with pytest.raises(NotResetError, match="interrupted"):
        play(env, 1)
    with pytest.raises(RecordingError, match="a tick was interrupted"):
        env.reset(options={"reset_mask": np.array([True, False, False])})
    env.reset()
    play(env, 3)
    env.close()
    assert replayed_ticks(Recording.open(path)) == 9


def test_a_sent_step_is_recorded_too(tmp_path: Path) -> None:
    env = make()
    outlast.record(env, tmp_path / "a.rec")
    env.reset()
    for _ in range(4):
        env.send(np.ones((3, 2, 6), int))
        env.recv()
    env.close()
    assert replayed_ticks(Recording.open(tmp_path / "a.rec")) == 5


@pytest.mark.parametrize("pause", [0, 1e-3])
def test_a_recording_is_closed_after_a_step_that_was_sent(tmp_path: Path, pause: float) -> None:
    env, later = make(), 3
    recorder = outlast.record(env, tmp_path / "a.rec")
    env.reset()
    env.send(np.ones((3, 2, 6), int))
    time.sleep(pause)
    recorder.close()
    env.recv()
    play(env, later)
    assert replayed_ticks(Recording.open(tmp_path / "a.rec")) == 2
    assert not Recording.open(tmp_path / "a.rec").cut


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_leaves_it_alone(tmp_path: Path) -> None:
    env = make()
    outlast.record(env, tmp_path / "a.rec")
    env.reset()
    child = os.fork()
    if child == 0:
        try:
            play(env, 1)
        except RecordingError as error:
            env.close()
            os._exit(7 if "by another process" in str(error) else 1)
        os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    play(env, 2)
    env.close()
    assert replayed_ticks(Recording.open(tmp_path / "a.rec")) == 3


def test_without_close_nothing_is_lost(tmp_path: Path) -> None:
    child = CHILD.format(tests=str(Path(__file__).parents[2]), path=str(tmp_path / "a.rec"), steps=50)
    subprocess.run([sys.executable, "-c", child], check=True)
    found = Recording.open(tmp_path / "a.rec")
    assert (len(found), found.cut) == (51, "")
