"""Run the whole check in one command: the linters, mypy and the tests.

    python -m tests [--quick] [--nightly] [-- PYTEST ARGUMENTS]

Every stage runs, even after a failure, and the summary comes last. The exit
status is 0 only if all stages passed. What is left out for lack of a library,
mypy or tests, is named in the last line; `.[test-all]` has all libraries but
those of Ray and BenchMARL. The tests run compiled, with the slow
ones, and then as plain Python; by day, the second run needs only those of the
engine and a few files of the core and of the mechanics. `--quick` skips the
slow tests and the second run. `--nightly` runs the tests that only the night
has time for, and then all tests of kernels twice: compiled with bounds checks,
and as plain Python.
"""

import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
MODES = ("NUMBA_BOUNDSCHECK", "NUMBA_DISABLE_JIT")
WORKERS = ("-n", "auto", "--dist", "loadfile")  # a process for each core; tests of one file share what they compile
# Folders of tests without kernels of their own: with bounds checks, or as plain Python, they would repeat themselves.
# They are ignored as folders, because markers would make those runs import every library first (a minute).
WITHOUT_KERNELS = ("adapters", "docs", "recording", "rendering", "robustness", "rollout", "training", "web")
KERNELS_ONLY = tuple(f"--ignore=tests/{folder}" for folder in WITHOUT_KERNELS)
# By day, plain Python runs the tests with kernels of their own, those that compare it with compiled kernels, and those
# of digests and naive forms. All others would show the same again, a hundred times slower.
PLAIN_BY_DAY = (
    *(f"tests/engine/test_{name}.py" for name in ("columns", "event_lists", "per_agent", "random", "varied", "worlds")),
    *(f"tests/core/test_{name}.py" for name in ("determinism", "digests")),
    *(f"tests/mechanics/test_{name}.py" for name in ("ablations", "edges", "fidelity_rules", "lidar", "reference")),
)
NO_TESTS = 5  # pytest's exit code where nothing was selected
NEEDED = re.compile(r"outlast\[([\w,-]+)\]")  # extras, in the reasons of skipped tests
ELSEWHERE = {"ray", "benchmarl"}  # extras whose tests need environments of their own: .ci/run --nightly

# import-linter has no `-m` of its own: `python -m importlinter.cli` would do nothing, and pass.
LINT_IMPORTS = "from importlinter.cli import lint_imports_command as run; run()"


@dataclass(frozen=True)
class Stage:
    """One command, given to this Python; `mode` is the numba variable it runs under."""

    name: str
    arguments: tuple[str, ...]
    mode: str = ""

    @property
    def environment(self) -> dict[str, str]:
        inherited = {name: value for name, value in os.environ.items() if name not in MODES}
        return inherited | ({self.mode: "1"} if self.mode else {})


@dataclass
class Result:
    name: str
    passed: bool
    seconds: float
    tests: Counter[str] = field(default_factory=Counter)
    needed: frozenset[str] = frozenset()  # extras without which tests were skipped

    def __str__(self) -> str:
        tests = f"   {summary_line(self.tests)}" if self.tests else ""
        return f"{'ok  ' if self.passed else 'FAIL'}  {self.name:<24}{self.seconds:7.1f} s{tests}"


def checks() -> list[Stage]:
    """Return the static checks. mypy follows what outlast.training imports, so it needs torch."""
    types = [Stage("mypy", ("-m", "mypy"))] if importlib.util.find_spec("torch") else []
    return [
        Stage("ruff check", ("-m", "ruff", "check", "--output-format", "concise")),
        Stage("ruff format --check", ("-m", "ruff", "format", "--check", "--output-format", "concise")),
        Stage("lint-imports", ("-c", LINT_IMPORTS)),
        *types,
    ]


def suites(quick: bool, nightly: bool) -> list[Stage]:
    """The test runs."""
    if nightly:
        return [
            Stage("pytest nightly", ("-m", "nightly")),
            Stage("pytest bounds-checked", KERNELS_ONLY, "NUMBA_BOUNDSCHECK"),
            Stage("pytest not compiled", KERNELS_ONLY, "NUMBA_DISABLE_JIT"),
        ]
    if quick:
        return [Stage("pytest compiled", ())]
    return [
        Stage("pytest compiled", ("-m", "not nightly")),
        Stage("pytest not compiled", PLAIN_BY_DAY, "NUMBA_DISABLE_JIT"),
    ]


def check(stage: Stage) -> Result:
    """Run a stage; its output is shown only if it fails."""
    start = time.perf_counter()
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run([sys.executable, *stage.arguments], cwd=ROOT, env=stage.environment, text=True, **streams)
    if done.returncode:
        print(done.stdout.rstrip(), flush=True)
    return Result(stage.name, done.returncode == 0, time.perf_counter() - start)


def suite(stage: Stage, arguments: list[str]) -> Result:
    """Run the tests, show their output, and count them."""
    print(f"\n{stage.name}", flush=True)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", *WORKERS, f"--junitxml={report}", *stage.arguments, *arguments]
        code = subprocess.run(command, cwd=ROOT, env=stage.environment).returncode
        tests, needed = counts(report), extras(report)
    if code not in (0, NO_TESTS) and not tests["failed"]:
        tests["failed"] += 1  # it ended before a report was written
    return Result(stage.name, code in (0, NO_TESTS), time.perf_counter() - start, tests, needed)


def extras(report: Path) -> frozenset[str]:
    """Return the extras that the skipped tests of a JUnit report name in their reasons."""
    if not report.exists():
        return frozenset()
    reasons = (ElementTree.tostring(child, "unicode") for child in ElementTree.parse(report).iter("skipped"))
    return frozenset(extra for reason in reasons for names in NEEDED.findall(reason) for extra in names.split(","))


def counts(report: Path) -> Counter[str]:
    """How many tests of a JUnit report passed, failed and were skipped."""
    tests: Counter[str] = Counter(passed=0, failed=0, skipped=0)
    if report.exists():
        for case in ElementTree.parse(report).iter("testcase"):
            ends = {child.tag for child in case}
            tests["failed" if ends & {"failure", "error"} else "skipped" if "skipped" in ends else "passed"] += 1
    return tests


def summary_line(tests: Counter[str]) -> str:
    """The line that continuous integration looks for."""
    line = f"{tests['passed']} passed, {tests['failed']} failed"
    return line + (f", {tests['skipped']} skipped" if tests["skipped"] else "")


def left_out(types: bool, needed: frozenset[str]) -> str:
    """Return what was not run, as the end of the last line. types: whether mypy ran."""
    named = ",".join(sorted(needed - ELSEWHERE))
    parts = [*([] if types else ["mypy"]), *([f"tests that need outlast[{named}]"] if named else [])]
    return f"; left out: {' and '.join(parts)} (all are in '.[test-all]')" if parts else ""


def other_tree() -> str:
    """Why the imported package is not the one of this tree, or ""."""
    found = importlib.util.find_spec("outlast")
    if found and found.origin and Path(found.origin).resolve().is_relative_to(ROOT):
        return ""
    return f"outlast is {f'imported from {found.origin}' if found else 'not installed'}, not from {ROOT}"


def summary(results: list[Result], types: bool) -> int:
    """Print what failed, the number of tests and what was left out; return the exit code. types: whether mypy ran."""
    total = sum((result.tests for result in results), Counter())
    failed = [result.name for result in results if not result.passed]
    print("\n" + "\n".join(str(result) for result in results))
    if failed:
        print(f"\nfailed: {', '.join(failed)}")
    elif not total["passed"]:
        print("\nno test ran")
    needed = frozenset().union(*(result.needed for result in results))
    print(summary_line(total) + left_out(types, needed), flush=True)
    return 1 if failed or not total["passed"] else 0


def main() -> int:
    words = [*sys.argv[1:], "--"]
    own, for_pytest = words[: words.index("--")], words[words.index("--") + 1 : -1]
    parser = ArgumentParser("python -m tests", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run the linters, mypy and the fast tests, compiled")
    parser.add_argument("--nightly", action="store_true", help="run only what is left out by day")
    options = parser.parse_args(own)
    if other := other_tree():
        parser.error(f"{other}; run: python -m pip install --editable '.[test]'")
    results = []
    static = [] if options.nightly else checks()
    for stage in static:
        results.append(check(stage))
        print(results[-1], flush=True)
    for stage in suites(options.quick, options.nightly):
        results.append(suite(stage, for_pytest))
        print(results[-1], flush=True)
    return summary(results, types=options.nightly or any(stage.name == "mypy" for stage in static))


if __name__ == "__main__":
    sys.exit(main())
