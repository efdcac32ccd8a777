"""The native backend asks first: a Box2D whose insides are elsewhere is refused by name, and asking never crashes."""

import os
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import Box2D
import pytest

from outlast.systems import Physics
from outlast.systems.box2d import layout, native, verify
from outlast.systems.box2d.batch import IncompatibleBox2D
from tests.conftest import COMPILED

pytestmark = [
    pytest.mark.skipif(not (COMPILED and native.available()), reason="the native backend does not run here"),
    pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing can be tried in a copy of this process"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

# Box2D's own numbers, not places
CONSTANTS = {*["STATIC", "KINEMATIC", "MOVING", "IN_ISLAND", "CIRCLE", "POLYGON", "SOLID", "TOUCHING", "POST_SOLVE"]}
UNREAD = {"STEP_INVERSE_DT", "STEP_POSITION"}  # written, but by nothing that is called here ever read
IN_PLACE = {"WORLD_SIZE", "BODY_SIZE"}  # found out to the next word
OFFSETS = sorted(name for name, value in vars(layout).items() if name.isupper() and isinstance(value, int))
OFFSETS = [name for name in OFFSETS if name not in CONSTANTS | UNREAD]
SMALL = (-64, -32, -24, -16, -12, -8, -6, -4, -2, -1, 1, 2, 4, 6, 8, 12, 16, 24, 32, 64)
CHANCE = 0.002  # of what lies behind an object to look right
PATIENCE = 20  # seconds
ROOT = Path(__file__).resolve().parents[2]


def asked(offset: str, value: int) -> str:
    """What `verify` says in a copy of this process in which that number is another; "crash" if the copy dies."""
    reading, writing = os.pipe()
    if not (child := os.fork()):
        try:
            signal.alarm(PATIENCE)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            setattr(layout, offset, value)
            os.write(writing, verify._report.__wrapped__().encode()[:4000])
        except BaseException as error:
            os.write(writing, f"raised {error!r}".encode())
        finally:
            os._exit(0)
    os.close(writing)
    with open(reading, "rb") as pipe:
        said = pipe.read().decode()
    return "crash" if os.WIFSIGNALED(os.waitpid(child, 0)[1]) else said


def check(deltas: tuple[int, ...]) -> None:
    """Every offset but for these amounts is refused, mostly by its own name."""
    said = {(name, delta): asked(name, getattr(layout, name) + delta) for name in OFFSETS for delta in deltas}
    near = {key for key in said if key[0] in IN_PLACE and 0 < key[1] < 8}
    assert [key for key, text in said.items() if text == "crash" or text.startswith("raised")] == []
    assert len({key for key, text in said.items() if not text} - near) <= CHANCE * len(said)
    named = Counter(text.startswith(f"{name} ") for (name, _), text in said.items() if text)
    assert named[True] > 0.9 * named.total()


def test_nothing_is_wrong_with_this_one() -> None:
    assert asked("BODY_SIZE", layout.BODY_SIZE) == ""


@pytest.mark.nightly
def test_every_offset_that_is_a_little_off_is_found() -> None:
    """In a process of its own: what others have left in memory looks right more often."""
    script = f"from tests.physics.test_backends import check; check({SMALL})"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.by_day(9)
@pytest.mark.parametrize("first", [name for name in OFFSETS if name.startswith("SOLVER_")])
@pytest.mark.parametrize("second", [name for name in OFFSETS if name.startswith("SOLVER_")])
def test_pointers_that_changed_places_are_found(first: str, second: str) -> None:
    said = asked(first, getattr(layout, second))
    assert (said == "") == (getattr(layout, first) == getattr(layout, second))
    assert said != "crash"
    assert not said.startswith("raised")


def test_another_version_is_refused_before_anything_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    def never() -> None:
        raise AssertionError("a world was made")

    monkeypatch.setattr(verify, "Sample", never)
    for version in ("2.3.8", "2.3.2", "2.4.1", "3.0.0"):
        monkeypatch.setattr(Box2D, "__version__", version)
        assert verify._report.__wrapped__() == f"its version is {version}, not 2.3.10"


@pytest.mark.parametrize("symbol", layout.SIGNATURES)
def test_every_missing_function_is_named(symbol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    has = layout.has_symbol
    monkeypatch.setattr(layout, "has_symbol", lambda name: name != symbol and has(name))
    monkeypatch.setattr(verify, "Sample", None)
    assert verify._report.__wrapped__() == f"it does not export {symbol}"


@pytest.mark.nightly
def test_a_library_that_cannot_be_loaded_leaves_the_portable_backend(tmp_path: Path) -> None:
    script = """
import Box2D, pathlib, sys
Box2D._Box2D.__file__ = sys.argv[1]
import numba.core.registry, llvmlite.binding as llvm
llvm.address_of_symbol = lambda name, known=llvm.address_of_symbol: None if name.startswith("_ZN") else known(name)
import outlast
from outlast.systems.box2d import native
print(native.available(), outlast.make_vec("ffa_1", 1, seed=0).worlds is not None)
"""
    (broken := tmp_path / "_Box2D.so").write_bytes(b"\x7fELF" + bytes(100))
    said = subprocess.run([sys.executable, "-c", script, str(broken)], capture_output=True, text=True)
    assert said.stdout.split() == ["False", "True"], said.stderr


@pytest.mark.parametrize("kind", ["native", "auto"])
def test_a_world_of_another_box2d_is_refused_or_made_by_the_portable_backend(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layout, "BODY_OMEGA", layout.BODY_OMEGA + 4)
    monkeypatch.setattr(verify, "_report", verify._report.__wrapped__)
    physics = Physics(backend=kind)
    if kind == "auto":
        assert not physics.native()
    else:
        with pytest.raises(IncompatibleBox2D, match=r"BODY_OMEGA holds .*backend=\"portable\""):
            physics.native()
