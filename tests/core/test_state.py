"""States of worlds and their files; that nothing differs where one goes on from them is in test_stateful.py."""

import hashlib
import io
import json
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import StateError
from outlast.envs.snapshots.state import HEADER, State
from tests.conftest import COMPILED, digest, draw_actions
from tests.fuzz.mutations import npy

WORLDS, STEPS = 6, 60 if COMPILED else 6
SHORT = {"ending_limit": 25, "agents_health": 40} if COMPILED else {"ending_limit": 3}  # episodes end in between


def make(seed: int = 1) -> SurvivalVectorEnv:
    env = outlast.make_vec(outlast.variant("teams_3").replace(**SHORT), WORLDS, seed=seed)
    env.reset()
    return env


def play(env: SurvivalVectorEnv, first: int, last: int) -> list[str]:
    digests = []
    for step in range(first, last):
        observations, reward, terminated, truncated, _ = env.step(draw_actions(env, np.random.default_rng(step)))
        observed = [*(observations[key] for key in sorted(observations)), reward, terminated, truncated]
        digests.append(digest(env.worlds) + hashlib.sha256(b"".join(part.tobytes() for part in observed)).hexdigest())
    return digests


CHILD = """
import sys
from tests.core.test_state import STEPS, State, make, play
env = make(seed=9)
env.set_state(State.load(sys.argv[1]))
print(play(env, STEPS // 2, STEPS))
"""


def test_another_process_goes_on_from_a_file(tmp_path: Path) -> None:
    env, file = make(), tmp_path / "state.npz"
    play(env, 0, STEPS // 2)
    env.get_state().save(file)
    command = [sys.executable, "-c", CHILD, file]
    printed = subprocess.check_output(command, text=True, cwd=Path(__file__).parents[2])
    assert printed.strip() == str(play(env, STEPS // 2, STEPS))
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_states_can_be_chosen_from() -> None:
    env = make()
    state = env.get_state()
    assert (len(state), len(state[2]), len(state[1:4]), len(state[np.arange(WORLDS) % 2 == 0])) == (6, 1, 3, 3)
    assert state[-1].arrays["world"].tobytes() == env.worlds.block[5].tobytes()
    assert ([len(each) for each in state], len(state[np.array(2)])) == ([1] * 6, 1)
    with pytest.raises(IndexError, match="world 6 does not exist: the state is of 6"):
        state[6]
    for wrong in ((0,), None, True):
        with pytest.raises(IndexError, match="a state has one axis, its worlds"):
            state[wrong]
    state.arrays["world"][:] = 0  # a copy: the environment does not feel it
    assert env.worlds.block.any()


@pytest.mark.parametrize("where", [[1, 1], np.array([0, 0, 1]), [-1, WORLDS - 1]])
def test_a_world_cannot_become_two_things(where: Any) -> None:
    env = make()
    before = digest(env.worlds)
    with pytest.raises(StateError, match="names a world twice; take each once, or a mask of bool"):
        env.set_state(env.get_state(where), where)
    assert digest(env.worlds) == before


@pytest.mark.parametrize("where", [None, np.ones(WORLDS + 1, bool), WORLDS, [[0, 1]]])
def test_worlds_that_cannot_be_are_refused(where: Any) -> None:
    env = make()
    state, before = env.get_state(), digest(env.worlds)
    for refused in (lambda: env.get_state(where), lambda: env.set_state(state, where)):
        with pytest.raises(StateError, match="where = "):
            refused()
    with pytest.raises(StateError, match="is not a State, as get_state"):
        env.set_state(state.arrays)
    assert digest(env.worlds) == before


def rewrite(file: Path, change: Any) -> None:
    with zipfile.ZipFile(file) as old:
        entries = {entry.filename: old.read(entry) for entry in old.infolist()}
    change(entries)
    with zipfile.ZipFile(file, "w") as new:
        for name, content in entries.items():
            new.writestr(name, content)


def with_header(**changes: Any) -> Any:
    def change(entries: dict[str, bytes]) -> None:
        array = np.load(io.BytesIO(entries[f"{HEADER}.npy"]))
        header = json.loads(array.tobytes()) | changes
        entries[f"{HEADER}.npy"] = npy(np.frombuffer(json.dumps(header).encode(), np.uint8))

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (with_header(version=99), "version 99 of the format"),
        (with_header(checksum="00"), "damaged"),
        (lambda entries: entries.update({"world.npy": npy(np.zeros((6, 64), np.uint8))}), "damaged"),
        (lambda entries: entries.pop(f"{HEADER}.npy"), "not a saved state"),
        (lambda entries: entries.pop("world.npy"), "damaged"),
        (lambda entries: entries.update({"evil.npy": npy(np.array([{}], object))}), "not a saved state"),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, change: Any, reason: str) -> None:
    file = tmp_path / "state.npz"
    make().get_state().save(file)
    rewrite(file, change)
    with pytest.raises(StateError, match=reason):
        State.load(file)


def test_foreign_files_are_refused(tmp_path: Path) -> None:
    for content in (b"", b"hello", npy(np.zeros(3))):
        (tmp_path / "a").write_bytes(content)
        with pytest.raises(StateError, match="not a saved state"):
            State.load(tmp_path / "a")
    np.savez(tmp_path / "b.npz", world=np.zeros(3))
    with pytest.raises(StateError, match=r"b\.npz is not a saved state: it has no 'header'"):
        State.load(tmp_path / "b.npz")
    with pytest.raises(FileNotFoundError):
        State.load(tmp_path / "nowhere.npz")


def test_states_are_equal_if_they_are_the_same_bits() -> None:
    env = make()
    state = env.get_state()
    assert state == env.get_state()
    play(env, 0, 1)
    assert state != env.get_state()
    assert state[:2] != state[:3]
    with pytest.raises(TypeError, match="unhashable"):
        hash(state)
