"""Mutation testing of systems/: how many small changes of mechanics do tests find?

    python -m tests.mutants [--sample N] [--seed N] [--files GLOB] [--compiled]
        [--jobs N] [--out FILE] [--again FILE]

One small change at a time (see operators.py) is made in a copy of the tree, and
the tests of the changed file are run, the most relevant first, until one fails.
A mutant that no test detects survives: either its line is not tested, or it is
equivalent, such as `<=` for `<` where equality cannot occur. The exit status is
1 if less than 85 % of the mutants are killed.

Kernels run as plain Python, so that nothing is compiled. The native backend of
Box2D only runs compiled, and is tested with --compiled. box2d/layout.py,
probe.py, sample.py and verify.py are left out: tests/physics/test_backends.py
is their mutation test, as it changes every number in them.
"""

import json
import os
import signal
import sys
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tqdm import tqdm

from tests.mutants.operators import Mutant, sampled
from tests.mutants.selection import chosen, tests_of
from tests.mutants.trials import KILLED, SURVIVED, TIMED_OUT, Tests, copies, outcomes, preload

LEAST_SHARE = 0.85
UNTRIED = "untried"


@dataclass
class Report:
    """The results so far."""

    results: list[tuple[Mutant, str, str]] = field(default_factory=list)  # mutant, outcome, output of its tests

    @property
    def counts(self) -> Counter[str]:
        return Counter(outcome for _, outcome, _ in self.results)

    @property
    def share(self) -> float:
        """The share of mutants that did not survive."""
        return 1 - self.counts[SURVIVED] / max(1, len(self.results))

    def __str__(self) -> str:
        files = defaultdict[str, Counter[str]](Counter)
        for mutant, outcome, _ in self.results:
            files[mutant.file][outcome] += 1
        table = [f"{'':<28}{KILLED:>10}{TIMED_OUT:>11}{SURVIVED:>10}"]
        for name, counts in [*sorted(files.items()), ("all", self.counts)]:
            table.append(f"{name:<28}{counts[KILLED]:>10}{counts[TIMED_OUT]:>11}{counts[SURVIVED]:>10}")
        survivors = sorted((m for m, outcome, _ in self.results if outcome == SURVIVED), key=lambda m: (m.file, m.line))
        changes = [f"{mutant}\n{mutant.difference}\n" for mutant in survivors]
        table.append(f"{self.share:.1%} of {len(self.results)} noticed; at least {LEAST_SHARE:.0%} must be")
        return "\n".join([*changes, *table])

    def write(self, file: Path, mutants: list[Mutant]) -> None:
        """Write a JSON file for --again. mutants: all of them, also those that were not run."""
        tried = {mutant for mutant, _, _ in self.results}
        results = [*self.results, *((mutant, UNTRIED, "") for mutant in mutants if mutant not in tried)]
        rows = [asdict(mutant) | {"outcome": outcome, "output": output} for mutant, outcome, output in results]
        file.write_text(json.dumps(rows, indent=1))


def read(file: Path) -> tuple[Report, list[Mutant]]:
    """A written report: the mutants that were detected, and those to run again."""
    report, again = Report(), []
    for row in json.loads(file.read_text()):
        mutant = Mutant(*(row[name] for name in ("file", "operator", "occurrence", "line")))
        if row["outcome"] in (KILLED, TIMED_OUT):
            report.results.append((mutant, row["outcome"], row["output"]))
        else:
            again.append(mutant)
    return report, again


def run(report: Report, mutants: list[Mutant], tests: Tests, compiled: bool, jobs: int) -> None:
    """Run the tests on all mutants and add to the report; Ctrl-C ends it early."""
    preload()
    with tempfile.TemporaryDirectory() as folder, tqdm(total=len(mutants), unit="mutant") as bar:
        trees = copies(Path(folder), min(jobs, len(mutants)))
        try:
            timeout = baseline(trees[0], tests, compiled)
            for mutant, outcome, output in outcomes(mutants, trees, tests, compiled, timeout):
                assert mutant
                report.results.append((mutant, outcome, output))
                if outcome == SURVIVED:
                    bar.write(f"{mutant}\n{mutant.difference}\n")
                bar.update()
                bar.set_postfix_str(f"{report.share:.1%} noticed")
        except KeyboardInterrupt:
            bar.write("interrupted")


def baseline(tree: Path, tests: Tests, compiled: bool) -> float:
    """Seconds after which a mutant is timed out: several times what all tests, which must pass, take without one."""
    start_time = time.monotonic()
    every = dict.fromkeys(test for lists in tests.values() for several in lists for test in several)
    ((_, outcome, output),) = outcomes([None], [tree], {None: [[*every]]}, compiled, 3600)
    if outcome != SURVIVED:
        raise SystemExit(f"the tests fail without a mutant:\n{output}")
    return 60 + 4 * (time.monotonic() - start_time)


def main(arguments: list[str] | None = None) -> int:
    parser = ArgumentParser("python -m tests.mutants", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    text = "number of mutants, drawn from all files; 0: all (default %(default)s)"
    parser.add_argument("--sample", type=int, default=300, help=text)
    parser.add_argument("--seed", type=int, default=0, help="decides which mutants are drawn (default %(default)s)")
    text = 'files to change, such as "systems/inner/*.py" (can be repeated; default: all of systems)'
    parser.add_argument("--files", action="append", metavar="GLOB", help=text)
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="run these tests on all mutants")
    parser.add_argument(
        "--compiled", action="store_true", help="change the native backend of Box2D instead, and compile"
    )
    parser.add_argument(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        help="mutants that are tested at the same time (default: cores)",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the results to this JSON file")
    parser.add_argument(
        "--again", type=Path, metavar="FILE", help="run again those of this file of --out that were not detected"
    )
    options = parser.parse_args(arguments)
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # ignored by processes that a shell starts in the background
    files = chosen(options.files or ["systems/**/*.py"], options.compiled)
    report, mutants = read(options.again) if options.again else (Report(), sampled(files, options.sample, options.seed))
    if not mutants:
        parser.error("there is nothing to change in these files")
    tests = {mutant: tests_of(mutant) if not options.tests else [options.tests] for mutant in mutants}
    before = len(report.results)
    run(report, mutants, tests, options.compiled, options.jobs)
    if options.out:
        report.write(options.out, mutants)
    print(report)
    return 0 if report.share >= LEAST_SHARE and len(report.results) == before + len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
