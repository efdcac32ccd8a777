"""Measure the coverage of the tests.

    python -m tests.covered [--least-lines 95] [--least-branches 90]

The tests run twice: as plain Python, where kernels are measured line by line,
and compiled, for adapters, commands, training and the compiler. Child processes
are measured, too. A table lists the files with the most lines left to cover.
The exit status is 1 if a test failed, or if less is covered than required.
"""

import json
import os
import subprocess
import sys
import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path
from typing import Any

from tests.__main__ import KERNELS_ONLY, ROOT, Stage, suite

MEASURED = ("--cov", "--cov-append", "--cov-report=", "--timeout=1200")
UNMEASURED = "--ignore=tests/robustness/test_soak.py"  # it measures memory, which coverage itself uses
SHOWN = 20  # files of the table


def measured() -> tuple[bool, dict[str, Any]]:
    """Whether all tests passed, and coverage's JSON report."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["COVERAGE_FILE"] = str(Path(folder) / "data")
        passed = True
        for stage in (
            Stage("pytest not compiled", (*MEASURED, *KERNELS_ONLY), "NUMBA_DISABLE_JIT"),
            Stage("pytest compiled", (*MEASURED, UNMEASURED, "-m", "not nightly")),
        ):
            result = suite(stage, [])
            print(result, flush=True)
            passed &= result.passed
        file = Path(folder) / "report.json"
        subprocess.run([sys.executable, "-m", "coverage", "json", "-q", "-o", str(file)], cwd=ROOT, check=True)
        return passed, json.loads(file.read_text())


def shares(summary: dict[str, int]) -> tuple[float, float]:
    """Percent of lines and of branches."""
    lines = summary["covered_lines"] / max(1, summary["num_statements"])
    branches = (summary["covered_branches"] + (not summary["num_branches"])) / max(1, summary["num_branches"])
    return 100 * lines, 100 * branches


def table(files: dict[str, Any]) -> str:
    """Files by what is left to cover, most first: percentages, and the lines."""
    rows = []
    for name, file in files.items():
        summary = file["summary"]
        left = summary["missing_lines"] + summary["missing_branches"]
        rows.append((-left, name, *shares(summary), " ".join(map(str, file["missing_lines"]))))
    lines = [f"{name:<40}{own:6.1f}{branches:6.1f}  {missing:.60}" for _, name, own, branches, missing in sorted(rows)]
    return "\n".join([f"{'':<40}{'lines':>6}{'branches':>9}", *lines[:SHOWN]])


def main() -> int:
    """The command."""
    parser = ArgumentParser("python -m tests.covered", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--least-lines", type=float, default=95, help="percentage of lines required (default 95)")
    parser.add_argument("--least-branches", type=float, default=90, help="percentage of branches required (default 90)")
    options = parser.parse_args()
    passed, report = measured()
    lines, branches = shares(report["totals"])
    print(f"\n{table(report['files'])}\n\n{lines:.1f} % of lines, {branches:.1f} % of branches are covered")
    return int(not passed or lines < options.least_lines or branches < options.least_branches)


if __name__ == "__main__":
    sys.exit(main())
