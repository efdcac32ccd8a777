"""Memory safety: Box2D's machine code and ours at work, under whatever this machine has to watch over memory.

    python -m tests.memory [CHECKER ...] [--steps N | --tests FILE ...]

Worlds of teams_4, sparse and crowded, are played in a process of its own, and their digests have to be those without a
checker; or these files of tests run there instead, and have to pass. The checkers:

========== =============================================================================================================
plain      nothing watches: the digest
perturbed  glibc fills fresh memory with 0x5A and freed memory with 0xA5, and checks its heap at each call
asan       AddressSanitizer's allocator: red zones around blocks, freed ones kept; a broken one ends the process
valgrind   Memcheck: every load and store of every instruction; slow (some minutes), without the machine's AVX-512
========== =============================================================================================================

What is not installed is named, and left out. The exit status is 1 if a checker found something.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from outlast import make_vec, variant

STEPS = 300  # of each world
WORLDS = 8
CROWD = {"agents_count": 12, "room_size": 10.0, "safe_zone_radii": (5.0, 3.0)}  # contacts in every tick
WORK = ("-c", "from tests.memory import work; work({steps})")
# Without a watchdog thread for each test: in a fork, the checkers' heaps stay locked if it was just beginning.
TESTS = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=0")
TOLD = re.compile(r"(?m)^[0-9a-f]{32}$|\b\d+ passed")
FAULTY = ("ERROR: AddressSanitizer", "free(): invalid", "corrupted", "malloc(): ", "double free")
OURS = re.compile(r"(?m)\bb2[A-Z]\w*::|_Box2D|: \?\?\?$")  # in a stack: Box2D, or code of no library, as the tick's
ROOT = Path(__file__).parent.parent


@dataclass(frozen=True)
class Checker:
    """A way to run a process. needs: what has to be there, and where it was found; command: words before Python's."""

    name: str
    needs: dict[str, str | None] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    command: tuple[str, ...] = ()
    generic: bool = False  # for an ordinary processor

    @property
    def missing(self) -> str:
        """What it needs and has not got."""
        return ", ".join(name for name, found in self.needs.items() if not found)


@dataclass(frozen=True)
class Report:
    """What came of a run. digest: "" if it did not end as it should. errors: what the checker found, in words."""

    checker: str
    digest: str
    errors: list[str]
    seconds: float


def work(steps: int) -> None:
    """What is watched: make worlds, step them, let them go; prints a digest of all that there is in the end."""
    from tests.conftest import digest, draw_actions

    rng = np.random.default_rng(0)
    for name, numbers in (("teams_4", {}), ("teams_4", CROWD)):
        env = make_vec(variant(name).replace(**numbers, physics_backend="native"), WORLDS, seed=3, threads=2)
        env.reset()
        for _ in range(steps):
            env.step(draw_actions(env, rng))
        print(digest(env.worlds), flush=True)
        env.close()


def checkers() -> list[Checker]:
    """All that are known, for this machine."""
    debug = library("libc_malloc_debug.so.0")
    asan, runtime = library("libasan.so"), library("libstdc++.so")
    perturbed = {"MALLOC_PERTURB_": "165", "MALLOC_CHECK_": "3", "GLIBC_TUNABLES": "glibc.malloc.check=3"}
    options = {"ASAN_OPTIONS": "detect_leaks=0:check_initialization_order=0", "PYTHONMALLOC": "malloc"}
    flags = ("--error-limit=no", "--leak-check=no", "--num-callers=20")
    valgrind = shutil.which("valgrind")
    return [
        Checker("plain"),
        Checker("perturbed", {"glibc's libc_malloc_debug.so.0": debug}, perturbed | {"LD_PRELOAD": debug or ""}),
        Checker("asan", {"gcc's libasan.so": asan}, options | {"LD_PRELOAD": f"{asan}:{runtime}"}),
        Checker(
            "valgrind",
            {"valgrind": valgrind},
            {"PYTHONMALLOC": "malloc"},
            (valgrind or "", *flags, "--log-file={log}"),
            True,
        ),
    ]


def library(name: str) -> str | None:
    """The path of a shared library that the C compiler or the loader knows."""
    if (compiler := shutil.which("gcc")) is not None:
        told = subprocess.run([compiler, f"-print-file-name={name}"], capture_output=True, text=True).stdout.strip()
        if os.path.isabs(told):
            return os.path.realpath(told)
    places = (Path(folder, name) for folder in ("/lib/x86_64-linux-gnu", "/lib64", "/usr/lib", "/lib"))
    return next((str(path) for path in places if path.exists()), None)


def run(checker: Checker, steps: int, files: Sequence[str] = ()) -> Report:
    """The work, or these files of tests, under a checker; after a first run without that compiles what it needs."""
    environment = os.environ | ({"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""} if checker.generic else {})
    command, first = ((sys.executable, *(word.format(steps=n) for word in WORK)) for n in (steps, 1))
    if files:
        command = first = (sys.executable, *TESTS, *files)
    if checker.generic:
        subprocess.run(first, cwd=ROOT, env=environment, check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as folder:
        log, start = Path(folder, "log"), time.perf_counter()
        words = [word.format(log=log) for word in checker.command]
        environment |= checker.environment
        done = subprocess.run((*words, *command), cwd=ROOT, env=environment, capture_output=True, text=True)
        told = log.read_text() if log.exists() else ""
    found = faults(told) + [line for line in done.stderr.splitlines() if any(word in line for word in FAULTY)]
    if done.returncode:
        told = done.stderr.strip() or done.stdout.strip()
        found.append(f"it ended with status {done.returncode}: {told[-300:]}")
    return Report(checker.name, "".join(TOLD.findall(done.stdout)), found, time.perf_counter() - start)


def faults(log: str) -> list[str]:
    """The errors in Memcheck's log that have Box2D or the tick in their stack."""
    blocks = re.split(r"(?m)^==\d+== \n", log)
    return [block for block in blocks if "    at 0x" in block and OURS.search(block)]


def verdict(report: Report, expected: str) -> str:
    """In a word or two."""
    if report.errors:
        return f"{len(report.errors)} errors"
    return "ok" if report.digest == expected else "another digest"


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        "python -m tests.memory", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = checkers()
    parser.add_argument("checkers", nargs="*", metavar="CHECKER", help="all if none is named")
    parser.add_argument("--steps", type=int, default=STEPS, help="of each world (%(default)s)")
    parser.add_argument("--tests", nargs="+", metavar="FILE", default=(), help="run these in place of worlds")
    asked = parser.parse_args(arguments)
    if strange := set(asked.checkers) - {checker.name for checker in known}:
        parser.error(f"{', '.join(strange)}: choose among {', '.join(checker.name for checker in known)}")
    expected, bad = run(known[0], asked.steps, asked.tests), False
    for checker in known:
        if asked.checkers and checker.name not in asked.checkers:
            continue
        if checker.missing:
            print(f"{checker.name:<10} not run: {checker.missing} is not here", flush=True)
            continue
        report = expected if checker is known[0] else run(checker, asked.steps, asked.tests)
        told = verdict(report, expected.digest)
        bad |= told != "ok" or not report.digest
        print(f"{checker.name:<10} {told:<16} {report.seconds:7.1f} s  {report.digest[:16]}", flush=True)
        print(*report.errors, sep="\n", end="\n" if report.errors else "")
    return int(bad)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
