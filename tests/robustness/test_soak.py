"""A short soak test, and a check that it detects leaks and violations."""

import gc
import mmap
import os
import threading
from collections.abc import Iterator
from multiprocessing import get_context
from typing import Any

import pytest

from outlast import VARIANTS
from outlast.components import Health
from tests import soak

ONES = 1000


@pytest.mark.nightly
def test_a_short_soak_holds(capfd: pytest.CaptureFixture[str]) -> None:
    sizes = (4096, 100, 8)
    options = [f"--{name}={size}" for name, size in zip(soak.PARTS, sizes, strict=True)]
    soak.main([*options, "--quiet"])  # the exit code is ignored: memory may grow in so short a run
    output = capfd.readouterr().out
    for name, size in zip(soak.PARTS, sizes, strict=True):
        assert f"{size:,} {name}: " in output
    assert output.splitlines()[-1] in ("all held", "not all held")


def leaking(kind: str, kept: list[Any]) -> Iterator[int]:
    while True:
        if kind == "memory":
            kept.append(mmap.mmap(-1, 2**16))  # pages of its own: malloc may reuse those of other tests
            kept[-1].write(b"1" * 2**16)
        elif kind == "files":
            kept.append(os.open(os.devnull, os.O_RDONLY))
        elif kind == "threads":
            kept.append(threading.Event())
            threading.Thread(target=kept[-1].wait).start()
        yield 1


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "words"), [("memory", "memory grew by"), ("files", "file descriptors grew"),
                                             ("threads", "threads grew"), ("nothing", "")])  # fmt: skip
def test_leaks_are_noticed(kind: str, words: str) -> None:
    kept: list[Any] = []
    if not soak.PROC.exists() and kind != "threads":
        pytest.skip("memory and files are not measured here")
    try:
        found = soak.soak(kind, leaking(kind, kept), 20 if kind == "threads" else ONES, quiet=True).faults()
    finally:
        for item in kept:
            if kind == "files":
                os.close(item)
            elif kind == "threads":
                item.set()
    assert [words in fault for fault in found] == ([True] if words else [])


def test_what_does_not_hold_ends_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def harm(walk: Any) -> None:
        walk.env.worlds[Health].points[0, 0] = 0
        walk.checker.check(walk.env.observe())

    monkeypatch.setattr(soak.CheckedPlay, "step", harm)
    monkeypatch.setattr(soak, "SCENARIOS", ["ffa_1"])
    with pytest.raises(AssertionError):
        next(soak.steps())


def objects() -> list[int]:
    """How many there are in this process after all variants were made and played, three times over."""
    work, counts = soak.environments(), []
    for _ in range(3):
        for _ in range(len(VARIANTS)):
            next(work)
        gc.collect()
        counts.append(len(gc.get_objects()))
    return counts


@pytest.mark.nightly
def test_environments_leave_no_objects_behind() -> None:
    """In a process of its own, as tests before this one leave some that go when they like."""
    with get_context("spawn").Pool(1) as pool:
        counts = pool.apply(objects)
    assert counts[2] - counts[1] < 20
