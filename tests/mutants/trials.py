"""Run tests on mutants, in copies of the tree and in forks of a process that has imported the slow libraries."""

import compileall
import contextlib
import importlib
import os
import py_compile
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import hypothesis
import numba
import pytest

from tests.mutants.operators import Mutant
from tests.mutants.selection import ROOT

TREE = (".src", "components", "docs/examples", "ecs", "envs", "systems", "tests", "training", "pyproject.toml")
PRELOADED = ("Box2D", "cv2", "gymnasium", "hypothesis.strategies", "pettingzoo", "platformdirs", "tqdm")
Tests = dict[Mutant | None, list[list[str]]]  # lists of arguments for pytest, one call each; None: no mutant
KILLED, SURVIVED, TIMED_OUT = "killed", "survived", "timed out"
TEST_SECONDS, COMPILED_TEST_SECONDS = (
    8,
    60,
)  # seconds of processor time for a test: most take up to 4, or 15 compiled
OUTCOMES = {0: SURVIVED, -signal.SIGVTALRM: TIMED_OUT}  # by exit status; any other is a test that failed
PHASES = (hypothesis.Phase.explicit, hypothesis.Phase.generate)  # without shrinking


@dataclass(frozen=True)
class StopAtFirstFailure:
    """A pytest plugin that ends the process at the first test that fails or takes too long."""

    seconds: float  # seconds of processor time

    def pytest_runtest_logstart(self) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, self.seconds)  # also interrupts a kernel; other processes do not count

    def pytest_runtest_logreport(self, report: Any) -> None:
        if report.failed:
            print(report.nodeid, report.longreprtext[-600:], flush=True)
            os._exit(1)

    def pytest_collectreport(self, report: Any) -> None:
        if report.failed:
            print(report.nodeid, str(report.longrepr)[-600:], flush=True)
            os._exit(1)


@dataclass
class Trial:
    """A child process that tests a mutant."""

    mutant: Mutant | None  # None: the tree as it is
    tree: Path
    end: float  # when it is timed out, by time.monotonic

    @property
    def output(self) -> str:
        return (self.tree / "output").read_text()


def copies(folder: Path, count: int) -> list[Path]:
    """Copies of the tree, with bytecode that is checked by the hash of its source instead of the time."""
    first, *others = trees = [folder / str(k) for k in range(count)]
    for name in TREE:
        target = first / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, target, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, target)
    compileall.compile_dir(first, quiet=2, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
    for other in others:
        shutil.copytree(first, other, symlinks=True)
    return trees


def preload() -> None:
    """Import libraries that mutants do not change before the forks."""
    for name in PRELOADED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    assert not any(name.split(".")[0] == "outlast" for name in sys.modules)


def outcomes(
    mutants: Iterable[Mutant | None],
    trees: list[Path],
    tests: Tests,
    compiled: bool,
    timeout: float,
) -> Iterator[tuple[Mutant | None, str, str]]:
    """(mutant, outcome, output) in the order in which they end; as many run at once as there are trees.

    tests: of each mutant, in the order in which they run. timeout: seconds for all tests of one mutant.
    """
    waiting, free, running = list(mutants), list(trees), dict[int, Trial]()
    try:
        while waiting or running:
            while free and waiting:
                trial = Trial(waiting.pop(0), free.pop(), time.monotonic() + timeout)
                running[start(trial, tests[trial.mutant], compiled)] = trial
            pid, outcome = wait_for_one(running)
            trial = running.pop(pid)
            free.append(trial.tree)
            if trial.mutant:
                shutil.copy2(ROOT / trial.mutant.file, trial.tree / trial.mutant.file)
            yield trial.mutant, outcome, trial.output
    finally:
        for pid in running:
            os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)


def wait_for_one(running: dict[int, Trial]) -> tuple[int, str]:
    """The first child to end or to time out, and its outcome."""
    while True:
        for pid, trial in running.items():
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(pid, signal.SIGKILL)  # its own children
                return pid, OUTCOMES.get(os.waitstatus_to_exitcode(status), KILLED)
            if time.monotonic() > trial.end:
                os.killpg(pid, signal.SIGKILL)
                os.waitpid(pid, 0)
                return pid, TIMED_OUT
        time.sleep(0.02)


def start(trial: Trial, tests: list[list[str]], compiled: bool) -> int:
    """Write the mutant and run the tests in a child; its process id, which is also its group's."""
    if trial.mutant:
        (trial.tree / trial.mutant.file).write_text(trial.mutant.source)
    sys.stdout.flush()
    if pid := os.fork():
        with contextlib.suppress(PermissionError, ProcessLookupError):
            os.setpgid(pid, pid)  # in parent and child, whichever runs first
        return pid
    with contextlib.suppress(PermissionError):
        os.setpgid(0, 0)
    try:
        child(trial.tree, tests, compiled)
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(1)


def child(tree: Path, tests: list[list[str]], compiled: bool) -> NoReturn:
    """Test the mutant in `tree`; never returns."""
    out = os.open(tree / "output", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(out, 1)
    os.dup2(out, 2)
    os.chdir(tree)
    shutil.rmtree(tree / "cache", ignore_errors=True)
    os.environ |= {"OUTLAST_CACHE_DIR": str(tree / "cache"), "PYTHONPATH": str(tree / ".src")}
    if not compiled:
        os.environ["NUMBA_DISABLE_JIT"], numba.config.DISABLE_JIT = "1", 1
    sys.path[:] = [str(tree / ".src"), str(tree), *(path for path in sys.path if Path(path).resolve() != ROOT)]
    for name in [name for name in sys.modules if name.split(".")[0] == "tests"]:
        del sys.modules[name]
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    hypothesis.settings.register_profile("mutants", derandomize=True, database=None, deadline=None, phases=PHASES)
    hypothesis.settings.load_profile("mutants")
    options = ["-q", "-p", "no:cacheprovider", "--tb=short", "--timeout=0", "--rootdir", str(tree)]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # about modules that are imported already
    first = StopAtFirstFailure(COMPILED_TEST_SECONDS if compiled else TEST_SECONDS)
    for arguments in tests:
        if pytest.main([*options, *arguments], plugins=[first]) != pytest.ExitCode.OK:
            os._exit(1)
    os._exit(0)
