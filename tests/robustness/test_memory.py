"""The memory checkers: a short run is clean, and they detect a write beyond the end of a block."""

import pytest

from tests import memory

KNOWN = {checker.name: checker for checker in memory.checkers()}
BEYOND = """
import ctypes
from outlast.systems.box2d import layout
system = ctypes.CDLL(None)
system.malloc.restype = ctypes.c_void_p
system.free.argtypes = [ctypes.c_void_p]
zeros, blocks = ctypes.c_int64(), [system.malloc(layout.BODY_SIZE) for _ in range(8)]
ctypes.memset(blocks[3], 1, layout.BODY_SIZE + 24)
for block in blocks: system.free(block)
print("survived")
"""


def installed(name: str) -> memory.Checker:
    if KNOWN[name].missing:
        pytest.skip(f"needs {KNOWN[name].missing}")
    return KNOWN[name]


@pytest.fixture(scope="module")
def plain() -> memory.Report:
    """The run without a checker."""
    return memory.run(KNOWN["plain"], 20)


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["perturbed", "asan"])
def test_the_backend_is_clean_under(name: str, plain: memory.Report) -> None:
    checked = memory.run(installed(name), 20)
    assert plain.errors == checked.errors == []
    assert len(plain.digest) == 64
    assert checked.digest == plain.digest


def test_what_is_written_beyond_a_block_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "WORK", ("-c", BEYOND))
    found = memory.run(installed("perturbed"), 1)
    assert found.errors, found
    assert memory.verdict(found, found.digest) != "ok"


LOG = """==7== Memcheck, a memory error detector
==7== 
==7== Invalid read of size 8
==7==    at 0x1: b2World::b2World(b2Vec2 const&) (b2World.cpp:55)
==7==    by 0x2: ??? (in /usr/lib/libffi.so.8)
==7== 
==7== Invalid write of size 4
==7==    at 0x3: ??? (in /usr/lib/libother.so)
==7== 
==7== Invalid write of size 4
==7==    at 0x4: ???
==7==    by 0x5: PyObject_Call (in /usr/bin/python3)
==7== 
==7== ERROR SUMMARY: 3 errors from 3 contexts
"""  # noqa: W291


def test_errors_of_box2d_and_of_the_tick_are_distinguished_from_others() -> None:
    assert [block.splitlines()[1].split()[3] for block in memory.faults(LOG)] == ["b2World::b2World(b2Vec2", "???"]


def test_what_is_not_here_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory.shutil, "which", lambda name: None)
    monkeypatch.setattr(memory, "run", lambda checker, steps, files: memory.Report(checker.name, "0", [], 0.0))
    assert memory.main(["valgrind"]) == 0
    assert "valgrind   not run: valgrind is not here" in capsys.readouterr().out
