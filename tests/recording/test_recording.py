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
    env = make(**options)
    with outlast.record(env, path):
        env.reset()
        play(env, steps)
    env.close()
    return path


def replayed_ticks(recording: Recording) -> int:
    return sum(1 for _ in Replay(recording).ticks())


def test_a_byte_an_agent_step(tmp_path: Path) -> None:
    """All included, for 64 worlds of four random agents."""
    env = make(64, "teams_3")
    with outlast.record(env, tmp_path / "a.rec"):
        env.reset()
        play(env, 1000)
    assert (tmp_path / "a.rec").stat().st_size < 1.15 * 1000 * 64 * 4


def test_many_joint_actions_take_two_bytes(tmp_path: Path) -> None:
    env = outlast.make_vec(outlast.variant("ffa_3").with_(outlast.systems.DropLast()), 2, seed=0)
    assert np.prod(env.action_sizes) == 432
    with outlast.record(env, tmp_path / "a.rec") as recorder:
        env.reset()
        play(env, 5)
        assert recorder.ticks == 6
    found = Recording.open(tmp_path / "a.rec")
    assert {record.codes.dtype for record in found.tick_records()} == {np.dtype("<u2")}
    assert replayed_ticks(found) == 6


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
    lines = (
        "import sys, outlast; from tests.recording.test_recording import make, play",
        "env = make(); outlast.record(env, sys.argv[1]); env.reset(); play(env, 50)",
    )
    child = [sys.executable, "-c", "\n".join(lines), tmp_path / "a.rec"]
    subprocess.run(child, check=True, cwd=Path(__file__).parents[2])
    found = Recording.open(tmp_path / "a.rec")
    assert (len(found), found.cut) == (51, "")
