"""Mutation testing of systems/: how much of what could be wrong there would a test notice?

`python -m tests.mutants [--sample N] [--seed N] [--files GLOB] [--compiled] [--jobs N] [--out FILE] [--again FILE]`
changes the mechanics in one small place at a time (tests/mutants_made.py says how), in a copy of the tree, and runs the
tests that go through that file, the most pertinent first, until one fails. A mutant that no test notices survives: its
line is not pinned, or it is equivalent, as `<=` for `<` where equality cannot be. The exit status is 1 if less than
85 % are killed.

Kernels run as plain Python, so that nothing is compiled; the native backend, which only runs compiled, is tried by
--compiled. Left out: box2d/layout.py, probe.py, sample.py and verify.py, as tests/physics/test_backends.py is their
mutation test: it changes every number that they hold.
"""

import json
import os
import signal
import sys
import tempfile
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tqdm import tqdm

from tests.mutants_made import ROOT, Mutant, sampled
from tests.mutants_run import KILLED, SURVIVED, TIMED_OUT, Tests, copies, outcomes, warm

BAR = 0.85
UNTRIED = "untried"
COMPILED = [f"systems/box2d/{name}.py" for name in ("workspace", "impact", "island", "native")]
LEFT_OUT = [f"systems/box2d/{name}.py" for name in ("layout", "probe", "sample", "verify")]

# Which tests run first, the quickest of them ahead; NAIVE follow. Names are those of tests/*/test_NAME.py.
NAIVE = "mechanics_edges mechanics_observations mechanics_bodies"
REFUSED = "bad_input.py::test_scenarios_are_refused"
FIRST = {
    "agents": "mechanics_edges mechanics_observations fidelity",
    "boxes": "mechanics_edges mechanics_reset fidelity_rules",
    "cameras": "mechanics_edges fidelity mechanics_crowd",
    "death_drop": "fidelity_items",
    "drop_last": "mechanics_world",
    "ending": "mechanics_edges vector_ends",
    "give_last": "fidelity_items",
    "heals": "fidelity_items",
    "mortality": f"fixes fidelity_rules {REFUSED}",
    "inventory": "fidelity_items",
    "melee": "fidelity_rules",
    "motors": "fixes mechanics_world fidelity",
    "physics": f"mechanics_flight fidelity {REFUSED}",
    "pickup": "fidelity_items",
    "record": "mechanics_observations vector_ends",
    "rewards": "fixes fidelity_rules",
    "room": "mechanics_reset fidelity",
    "steering": "fixes mechanics_world",
    "teams": f"mechanics_reset {REFUSED}",
    "spawn_grid": f"mechanics_reset mechanics_world {REFUSED}",
    "safe_zone": f"mechanics_reset fidelity_rules {REFUSED}",
    "broad_phase": "mechanics_culling fidelity",
    "points": "geometry",
    "rays": "geometry",
    "aabb": "mechanics_culling",
    "blocks": "mechanics_culling",
    "portable": "mechanics_flight fidelity box2d",
    "batch": "mechanics_flight box2d fidelity",
    "transfer": "fidelity",
}
NUMBERS = "mechanics_numbers scenario"  # where a number of a module is declared
BACKEND = "box2d"
LEFT_OUT_TESTS = (  # the first three are slow, the last one starts a process that finds the installed outlast
    "fixes.py::test_scripted_agents_can_steer",
    "fidelity_rules.py::test_the_longest_life_without_heals",
    "scenario.py::test_what_is_left_runs",
    "box2d.py::test_a_cached_kernel_runs_in_another_process",
)


@dataclass
class Report:
    """What became of the mutants so far."""

    results: list[tuple[Mutant, str, str]] = field(default_factory=list)  # mutant, outcome, what its tests said

    @property
    def counts(self) -> Counter[str]:
        return Counter(outcome for _, outcome, _ in self.results)

    @property
    def share(self) -> float:
        """Of the mutants: those that did not survive."""
        return 1 - self.counts[SURVIVED] / max(1, len(self.results))

    def __str__(self) -> str:
        files = defaultdict[str, Counter[str]](Counter)
        for mutant, outcome, _ in self.results:
            files[mutant.file][outcome] += 1
        table = [f"{'':<28}{KILLED:>10}{TIMED_OUT:>11}{SURVIVED:>10}"]
        for name, counts in [*sorted(files.items()), ("all", self.counts)]:
            table.append(f"{name:<28}{counts[KILLED]:>10}{counts[TIMED_OUT]:>11}{counts[SURVIVED]:>10}")
        survivors = sorted((m for m, outcome, _ in self.results if outcome == SURVIVED), key=lambda m: (m.file, m.line))
        said = [f"{mutant}\n{mutant.difference}\n" for mutant in survivors]
        table.append(f"{self.share:.1%} of {len(self.results)} noticed; at least {BAR:.0%} must be")
        return "\n".join([*said, *table])

    def write(self, file: Path, mutants: list[Mutant]) -> None:
        """All of it, as JSON: what --again takes. mutants: of which some may not have been tried."""
        tried = {mutant for mutant, _, _ in self.results}
        results = [*self.results, *((mutant, UNTRIED, "") for mutant in mutants if mutant not in tried)]
        rows = [asdict(mutant) | {"outcome": outcome, "told": told} for mutant, outcome, told in results]
        file.write_text(json.dumps(rows, indent=1))


def read(file: Path) -> tuple[Report, list[Mutant]]:
    """Of a report that was written: what was noticed, and what is to be tried again."""
    report, again = Report(), []
    for row in json.loads(file.read_text()):
        mutant = Mutant(*(row[name] for name in ("file", "operator", "occurrence", "line")))
        if row["outcome"] in (KILLED, TIMED_OUT):
            report.results.append((mutant, row["outcome"], row["told"]))
        else:
            again.append(mutant)
    return report, again


def tests_of(mutant: Mutant) -> list[list[str]]:
    """Arguments for pytest, which is called once for each list until a test fails: collecting them all takes long."""
    if mutant.file in COMPILED:
        first, others = BACKEND.split(), []
    else:
        first = NUMBERS.split() if mutant.declares else FIRST.get(Path(mutant.file).stem, "").split()
        others = [name for name in NAIVE.split() if name not in first]
    without = [f"--deselect={path(name)}" for name in LEFT_OUT_TESTS]
    return [[*map(path, names), *without] for names in (first, others) if names]


def path(name: str) -> str:
    """Of a file of tests, or of one test in it."""
    file, _, test = name.partition("::")
    (found,) = ROOT.glob(f"tests/*/test_{file.removesuffix('.py')}.py")
    return str(found.relative_to(ROOT)) + (f"::{test}" if test else "")


def chosen(globs: Iterable[str], compiled: bool) -> list[str]:
    """Files of systems/ that are tried in this way."""
    found = sorted({str(path.relative_to(ROOT)) for glob in globs for path in ROOT.glob(glob)})
    found = [file for file in found if Path(file).name != "__init__.py"]
    return [file for file in found if file not in LEFT_OUT and (file in COMPILED) == compiled]


def run(report: Report, mutants: list[Mutant], tests: Tests, compiled: bool, jobs: int) -> None:
    """Try them all and add to the report; Ctrl-C ends it early, with what is known until then."""
    warm()
    with tempfile.TemporaryDirectory() as folder, tqdm(total=len(mutants), unit="mutant") as bar:
        trees = copies(Path(folder), min(jobs, len(mutants)))
        try:
            patience = baseline(trees[0], tests, compiled)
            for mutant, outcome, told in outcomes(mutants, trees, tests, compiled, patience):
                assert mutant
                report.results.append((mutant, outcome, told))
                if outcome == SURVIVED:
                    bar.write(f"{mutant}\n{mutant.difference}\n")
                bar.update()
                bar.set_postfix_str(f"{report.share:.1%} noticed")
        except KeyboardInterrupt:
            bar.write("interrupted")


def baseline(tree: Path, tests: Tests, compiled: bool) -> float:
    """Seconds that a mutant is given: several times what all tests take without one, when they must pass."""
    begin = time.monotonic()
    every = dict.fromkeys(test for lists in tests.values() for several in lists for test in several)
    ((_, outcome, told),) = outcomes([None], [tree], {None: [[*every]]}, compiled, 3600)
    if outcome != SURVIVED:
        raise SystemExit(f"the tests fail without a mutant:\n{told}")
    return 60 + 4 * (time.monotonic() - begin)


def main(arguments: list[str] | None = None) -> int:
    parser = ArgumentParser("python -m tests.mutants", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--sample", type=int, default=300, help="how many, spread over the files; 0: all (300)")
    parser.add_argument("--seed", type=int, default=0, help="which ones (0)")
    parser.add_argument("--files", action="append", metavar="GLOB", help='as "systems/geometry/*.py"; may be repeated')
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="for pytest, in the place of those chosen here")
    parser.add_argument("--compiled", action="store_true", help="of the native backend, compiled")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many at once (one a core)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write all of it there, as JSON")
    told = "go on with what --out wrote: only what was not noticed there is tried"
    parser.add_argument("--again", type=Path, metavar="FILE", help=told)
    asked = parser.parse_args(arguments)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell has those in the background ignore
    files = chosen(asked.files or ["systems/**/*.py"], asked.compiled)
    report, mutants = read(asked.again) if asked.again else (Report(), sampled(files, asked.sample, asked.seed))
    if not mutants:
        parser.error("there is nothing to change in these files")
    tests = {mutant: tests_of(mutant) if not asked.tests else [asked.tests] for mutant in mutants}
    before = len(report.results)
    run(report, mutants, tests, asked.compiled, asked.jobs)
    if asked.out:
        report.write(asked.out, mutants)
    print(report)
    return 0 if report.share >= BAR and len(report.results) == before + len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
