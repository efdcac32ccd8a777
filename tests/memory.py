"""Memory safety: run compiled ticks and Box2D under memory checkers.

    python -m tests.memory [CHECKER ...] [--steps N | --tests FILE ...]

Sparse and crowded worlds of teams_4 are played in a process of its own, and
their digests must equal those without a checker; or the given test files run
there instead, and must pass. The checkers:

========== ===================================================================
plain      no checker: makes the digest
perturbed  glibc fills fresh memory with 0x5A and freed memory with 0xA5, and
           checks its heap at each call
asan       AddressSanitizer's allocator: it puts red zones around blocks and
           keeps freed ones; an error ends the process
valgrind   Memcheck: checks every load and store; takes some minutes, and runs
           as on a generic processor
========== ===================================================================

Checkers that are not installed are reported and skipped. The exit status is 1
if one found an error.
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
# Without a watchdog thread per test: if it starts during a fork, the checker's heap stays locked in the child.
TESTS = ("-m", "pytest", "-q", "-p", "no:cacheprovider", "-o", "faulthandler_timeout=0")
RESULTS = re.compile(r"(?m)^[0-9a-f]{32}$|\b\d+ passed")
FAULTY = ("ERROR: AddressSanitizer", "free(): invalid", "corrupted", "malloc(): ", "double free")
OUR_FRAMES = re.compile(r"(?m)\bb2[A-Z]\w*::|_Box2D|: \?\?\?$")  # stack frames of Box2D, or of no library (the tick)
ROOT = Path(__file__).parent.parent


@dataclass(frozen=True)
class Checker:
    """A way to run a process. needs: requirements and where they were found; command: what precedes Python's."""

    name: str
    needs: dict[str, str | None] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    command: tuple[str, ...] = ()
    generic: bool = False  # compile for a generic processor

    @property
    def missing(self) -> str:
        """The requirements that were not found."""
        return ", ".join(name for name, found in self.needs.items() if not found)


@dataclass(frozen=True)
class Report:
    """The result of a run. digest: "" if it failed. errors: what the checker found, as text."""

    checker: str
    digest: str
    errors: list[str]
    seconds: float


def work(steps: int) -> None:
    """Make worlds, step them, print their digests and close them."""
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
    """All checkers, as configured for this machine."""
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
    """The path of a shared library that the C compiler or the loader finds."""
    if (compiler := shutil.which("gcc")) is not None:
        output = subprocess.run([compiler, f"-print-file-name={name}"], capture_output=True, text=True).stdout.strip()
        if os.path.isabs(output):
            return os.path.realpath(output)
    places = (Path(folder, name) for folder in ("/lib/x86_64-linux-gnu", "/lib64", "/usr/lib", "/lib"))
    return next((str(path) for path in places if path.exists()), None)


def run(checker: Checker, steps: int, files: Sequence[str] = ()) -> Report:
    """Run the work, or these test files, under a checker; if it is generic, compile in a run without it first."""
    environment = os.environ | ({"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""} if checker.generic else {})
    command, first = ((sys.executable, *(word.format(steps=n) for word in WORK)) for n in (steps, 1))
    if files:
        command = first = (sys.executable, *TESTS, *files)
    if checker.generic:
        subprocess.run(first, cwd=ROOT, env=environment, check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as folder:
        log, start = Path(folder, "log"), time.perf_counter()
        prefix = [word.format(log=log) for word in checker.command]
        environment |= checker.environment
        done = subprocess.run((*prefix, *command), cwd=ROOT, env=environment, capture_output=True, text=True)
        output = log.read_text() if log.exists() else ""
    found = faults(output) + [line for line in done.stderr.splitlines() if any(word in line for word in FAULTY)]
    if done.returncode:
        output = done.stderr.strip() or done.stdout.strip()
        found.append(f"it ended with status {done.returncode}: {output[-300:]}")
    return Report(checker.name, "".join(RESULTS.findall(done.stdout)), found, time.perf_counter() - start)


def faults(log: str) -> list[str]:
    """The errors in Memcheck's log that have Box2D or the tick in their stack."""
    blocks = re.split(r"(?m)^==\d+== \n", log)
    return [block for block in blocks if "    at 0x" in block and OUR_FRAMES.search(block)]


def verdict(report: Report, expected: str) -> str:
    """The result in a word or two."""
    if report.errors:
        return f"{len(report.errors)} errors"
    return "ok" if report.digest == expected else "another digest"


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        "python -m tests.memory", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    known = checkers()
    parser.add_argument("checkers", nargs="*", metavar="CHECKER", help="checkers to run (default: all)")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of each world (default %(default)s)")
    parser.add_argument("--tests", nargs="+", metavar="FILE", default=(), help="run these test files instead of worlds")
    options = parser.parse_args(arguments)
    if strange := set(options.checkers) - {checker.name for checker in known}:
        parser.error(f"{', '.join(strange)}: choose among {', '.join(checker.name for checker in known)}")
    expected, bad = run(known[0], options.steps, options.tests), False
    for checker in known:
        if options.checkers and checker.name not in options.checkers:
            continue
        if checker.missing:
            print(f"{checker.name:<10} not run: {checker.missing} is not here", flush=True)
            continue
        report = expected if checker is known[0] else run(checker, options.steps, options.tests)
        result = verdict(report, expected.digest)
        bad |= result != "ok" or not report.digest
        print(f"{checker.name:<10} {result:<16} {report.seconds:7.1f} s  {report.digest[:16]}", flush=True)
        print(*report.errors, sep="\n", end="\n" if report.errors else "")
    return int(bad)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
