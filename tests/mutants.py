"""Mutation testing of systems/: how many small changes of mechanics do tests find?

    python -m tests.mutants [--sample N] [--seed N] [--files GLOB] [--compiled]
        [--coverage FILE] [--tests TEST ...] [--jobs N]

One small change at a time, made by cosmic-ray's operators, is made in a copy of
the tree, and the tests that execute the changed line are run, those that execute
little else first, until one fails. Which these are is in the data of coverage.py,
written by the first command for coverage in docs/reliability.md. A mutant that no
test detects survives: either its line is not tested, or it is equivalent, such as
`<=` for `<` where equality cannot occur. The exit status is 1 if less than 85 % of
the mutants are killed.

Kernels run as plain Python, so that nothing is compiled. The native backend of
Box2D only runs compiled, and is tested with --compiled; LEFT_OUT is left out, as
tests/physics/test_backends.py changes every number in it. So are changes that no
test could or should detect: in decorators, annotations, docstrings, f-strings;
a third replacement of an operator; -1 for 0, where most columns have one entry.
"""

import ast
import compileall
import difflib
import itertools
import os
import py_compile
import shutil
import subprocess
import sys
import tempfile
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from random import Random
from typing import Any

from coverage import CoverageData
from tqdm import tqdm

ROOT = Path(__file__).resolve().parents[1]
TREE = (".src", "components", "docs", "ecs", "envs", "systems", "tests", "training", "pyproject.toml")
NATIVE = "batch impact island joints native outline touches workspace"
COMPILED = [f"systems/box2d/{name}.py" for name in NATIVE.split()]
LEFT_OUT = [f"systems/box2d/{name}.py" for name in ("layout", "probe", "sample", "verify")]
LEAST_SHARE = 0.85
KILLED, SURVIVED = "killed", "survived"
TEST_SECONDS = 100  # for a test: most take up to 4, or 15 compiled

BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Mul Mod_FloorDiv Pow_Mul RShift_LShift LShift_RShift "
BINARY += "BitOr_BitAnd BitAnd_BitOr BitXor_BitAnd"
COMPARISON = "Eq_NotEq NotEq_Eq Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Is_IsNot IsNot_Is"
UNARY = "Delete_USub Delete_Invert Delete_Not"
OTHERS = "NumberReplacer ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceAndWithOr ReplaceOrWithAnd AddNot "
OTHERS += "ReplaceBreakWithContinue ReplaceContinueWithBreak ZeroIterationForLoop ExceptionReplacer"
OPERATORS = (
    *(f"ReplaceBinaryOperator_{name}" for name in BINARY.split()),
    *(f"ReplaceComparisonOperator_{name}" for name in COMPARISON.split()),
    *(f"ReplaceUnaryOperator_{name}" for name in UNARY.split()),
    *OTHERS.split(),
)
UNTESTED = {"decorator", "fstring", "import_from", "import_name"}  # types of parso's nodes

FOLDERS = "tests/core tests/engine tests/mechanics tests/physics tests/training/test_networks.py"
COVERED = f"NUMBA_DISABLE_JIT=1 python -m pytest --cov --cov-context=test --cov-report= --timeout=1200 {FOLDERS}"
NARROW, FILES = 25, 2  # tests that are tried first, and files that are tried then: those that execute little else
CASES = 3  # of one test that are tried first
NUMBERS = "numbers scenario"  # where a number of a module is declared
ORACLES = "edges observations bodies digests bounds numbers"  # tried at last: they compare all of a game
SLOW = ("fidelity_rules.py::test_the_longest_life_without_heals", "scenario.py::test_what_is_left_runs")

# ---- mutants


def operator(name: str) -> Any:
    """One of cosmic-ray's operators."""
    from cosmic_ray.plugins import get_operator

    return get_operator(f"core/{name}")()


@dataclass(frozen=True)
class Mutant:
    """A change to a file; `occurrence` counts the places where the operator could change it."""

    file: str  # as in "systems/give_last.py"
    operator: str
    occurrence: int
    line: int

    @property
    def source(self) -> str:
        """The whole file with the change."""
        from cosmic_ray.mutating import mutate_code

        source = (ROOT / self.file).read_text()
        return mutate_code(source, operator(self.operator), self.occurrence) or source

    @property
    def possible(self) -> bool:
        """Whether it changes the file, and compiles."""
        try:
            compile(self.source, self.file, "exec", dont_inherit=True)
        except (SyntaxError, ValueError):
            return False
        return self.source != (ROOT / self.file).read_text()

    @property
    def statement(self) -> range:
        """The lines of its statement up to its own."""
        tree = ast.walk(ast.parse((ROOT / self.file).read_text()))
        around = (node for node in tree if isinstance(node, ast.stmt) and node.lineno <= self.line <= node.end_lineno)
        return range(max(node.lineno for node in around), self.line + 1)

    @property
    def declares(self) -> bool:
        """Whether its statement declares a number of a module."""
        lines = (ROOT / self.file).read_text().splitlines()
        return "= number(" in lines[self.statement.start - 1]

    @property
    def difference(self) -> str:
        """The changed lines, old and new."""
        old, new = (ROOT / self.file).read_text().splitlines(), self.source.splitlines()
        lines = list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:]
        return "\n".join(line[0] + " " + line[1:].strip() for line in lines)

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.operator} {self.occurrence}\n{self.difference}\n"


def mutants(file: str) -> Iterator[Mutant]:
    """All mutants of a file, by operator; some may not compile."""
    from cosmic_ray.ast import ast_nodes, get_ast

    nodes = list(ast_nodes(get_ast((ROOT / file).read_text())))
    for name in OPERATORS:
        places = ((node, start) for node in nodes for start, _ in operator(name).mutation_positions(node))
        for occurrence, (node, (line, _)) in enumerate(places):
            if not is_untested(node) and not (is_index_zero(node) and name == "NumberReplacer" and occurrence % 2):
                yield Mutant(file, name, occurrence, line)


def is_index_zero(node: Any) -> bool:
    """Whether it is the 0 of `[0]`."""
    return node.parent.type == "trailer" and node.parent.children[0].value == "[" and node.get_code().strip() == "0"


def is_untested(node: Any) -> bool:
    """Whether it is part of a decorator, an annotation, a message or a list of parameters."""
    child = node
    while (parent := child.parent) is not None:
        annotation = (
            parent.type in ("tfpdef", "annassign") and child is parent.children[1 - 2 * (parent.type[0] == "t")]
        )
        returned = parent.type == "funcdef" and child is parent.annotation
        if annotation or returned or child.type in UNTESTED or (child is node and parent.type == "parameters"):
            return True
        child = parent
    return False


def sampled(files: list[str], count: int, seed: int) -> list[Mutant]:
    """About so many, of every file in proportion to what it has, at least one; in random order. 0: all of them."""
    found = {file: list(mutants(file)) for file in files}
    share = min(1.0, count / max(1, sum(map(len, found.values())))) if count else 1.0
    chosen = []
    for file, every in found.items():
        Random(f"{seed} {file}").shuffle(every)
        possible = (mutant for mutant in every if mutant.possible)
        chosen += itertools.islice(possible, max(1, round(share * len(every))))
    Random(seed).shuffle(chosen)
    return chosen


def chosen(globs: Iterable[str], compiled: bool) -> list[str]:
    """The files of systems/ that are tested compiled, or as plain Python."""
    found = sorted({str(path.relative_to(ROOT)) for glob in globs for path in ROOT.glob(glob)})
    found = [file for file in found if Path(file).name != "__init__.py"]
    return [file for file in found if file not in LEFT_OUT and (file in COMPILED) == compiled]


# ---- their tests


def file_of(test: str) -> str:
    """The file of a test."""
    return test.partition("::")[0]


def executed(lines: dict[int, set[str]]) -> Counter[str]:
    """How many of these lines each test executes, and the tests of each file."""
    found = Counter[str]()
    for tests in lines.values():
        found.update(tests | {*map(file_of, tests)})
    return found


class Coverage:
    """Which tests execute a line of systems/, by what coverage.py has written."""

    def __init__(self, file: Path) -> None:
        if not file.is_file():
            raise SystemExit(f"{file} is missing, which says what each test executes. To write it:\n{COVERED}")
        data = CoverageData(str(file))
        data.read()
        self.lines = dict[str, dict[int, set[str]]]()  # by file and line: the tests that execute it
        self.breadth = Counter[str]()  # lines that a test, or the tests of a file, execute
        for name in data.measured_files():
            if Path(name).is_relative_to(ROOT / "systems"):
                found = data.contexts_by_lineno(name)
                tests = {line: {each.rpartition("|")[0] for each in some} - {""} for line, some in found.items()}
                self.lines[str(Path(name).relative_to(ROOT))] = tests
                self.breadth += executed(tests)

    def tests(self, mutant: Mutant) -> list[list[str]]:
        """Arguments for pytest, called for each list in turn until a test fails: a few tests, then files, then ORACLES.

        Files are tried as tests share what the first of them has computed. What is executed when a module is imported,
        such as a constant, is tested by all that tests its file.
        """
        lines = self.lines.get(mutant.file, {})
        found = set[str]().union(*(lines.get(line, ()) for line in mutant.statement)) or set().union(*lines.values())
        share = {test: count / self.breadth[test] for test, count in executed(lines).items()}
        narrow, files = (
            sorted(some, key=lambda each: (-share[each], each)) for some in (found, {*map(file_of, found)})
        )
        names = [test.partition("[")[0] for test in narrow]
        narrow = [test for k, test in enumerate(narrow) if names[:k].count(names[k]) < CASES]
        numbers, oracles = ([path(name) for name in names.split()] for names in (NUMBERS, ORACLES))
        without = [f"--deselect={path(name)}" for name in SLOW]
        several = numbers if mutant.declares else [], narrow[:NARROW], files[:FILES], oracles
        return [[*each, *without] for each in several if each]


def path(name: str) -> str:
    """The path of a test file, or the id of one test in it."""
    file, _, test = name.partition("::")
    (found,) = ROOT.glob(f"tests/*/test_{file.removesuffix('.py')}.py")
    assert not test or f"def {test}(" in found.read_text(), f"there is no {test} in {found}"
    return str(found.relative_to(ROOT)) + (f"::{test}" if test else "")


def copy_of_the_tree(folder: Path) -> Path:
    """A copy with bytecode that is checked by the hash of its source instead of the time."""
    for name in TREE:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(ROOT / name, folder / name)
    compileall.compile_dir(folder, quiet=2, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
    return folder


def first_failure(tree: Path, tests: list[list[str]], compiled: bool) -> str:
    """Run lists of tests in a copy of the tree, until one fails: the end of its output; "" if all pass."""
    variables = os.environ | {"PYTHONPATH": f"{tree / '.src'}:{tree}", "PYTHONDONTWRITEBYTECODE": "1"}
    variables |= {"OUTLAST_CACHE_DIR": str(tree / "cache"), "NUMBA_DISABLE_JIT": str(int(not compiled))}
    shutil.rmtree(tree / "cache", ignore_errors=True)
    words = [sys.executable, "-m", "pytest", "-qx", "-n", "0", "-p", "no:cacheprovider", "--hypothesis-seed=0"]
    words += [f"--timeout={TEST_SECONDS}", "--timeout-method=thread", f"--rootdir={tree}", "-o", "pythonpath=.src ."]
    for arguments in tests:
        done = subprocess.run([*words, *arguments], cwd=tree, env=variables, capture_output=True, text=True)
        if done.returncode:
            return (done.stdout + done.stderr)[-3000:]
    return ""


def outcomes(
    mutants: list[Mutant], tests: list[list[list[str]]], compiled: bool, jobs: int
) -> Iterator[tuple[Mutant, str]]:
    """Each mutant, and whether one of its tests detects it."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        free = SimpleQueue[Path]()
        for k in range(jobs):
            free.put(copy_of_the_tree(Path(folder, str(k))))

        def outcome(mutant: Mutant, tests: list[list[str]]) -> tuple[Mutant, str]:
            tree = free.get()
            (tree / mutant.file).write_text(mutant.source)
            failure = first_failure(tree, tests, compiled)
            shutil.copy2(ROOT / mutant.file, tree / mutant.file)
            free.put(tree)
            return mutant, KILLED if failure else SURVIVED

        tree = free.get()
        every = dict.fromkeys(test for lists in tests for several in lists for test in several)
        if failure := first_failure(tree, [[*every, "-n", str(jobs)]], compiled):
            raise SystemExit(f"the tests fail without a mutant:\n{failure}")
        free.put(tree)
        yield from pool.map(outcome, mutants, tests)


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns 1 if fewer mutants are killed than have to be."""
    parser = ArgumentParser("python -m tests.mutants", description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    text = "number of mutants, drawn from all files; 0: all (default %(default)s)"
    parser.add_argument("--sample", type=int, default=300, help=text)
    parser.add_argument("--seed", type=int, default=0, help="decides which mutants are drawn (default %(default)s)")
    text = 'files to change, such as "systems/inner/*.py" (can be repeated; default: all of systems)'
    parser.add_argument("--files", action="append", metavar="GLOB", help=text)
    text = "coverage data that says which tests execute a line (default %(default)s)"
    parser.add_argument("--coverage", type=Path, default=Path(".coverage"), metavar="FILE", help=text)
    parser.add_argument("--tests", nargs="+", metavar="TEST", help="run these tests on all mutants")
    parser.add_argument("--compiled", action="store_true", help="change the native backend of Box2D, and compile")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="mutants tested at once (default: cores)")
    options = parser.parse_args(arguments)
    drawn = sampled(chosen(options.files or ["systems/**/*.py"], options.compiled), options.sample, options.seed)
    covered = None if options.tests or options.compiled else Coverage(options.coverage)
    given, found = [options.tests or ["tests/physics", path("hiding")]], Counter[tuple[str, str]]()
    tests = [covered.tests(mutant) if covered else given for mutant in drawn]
    for mutant, outcome in tqdm(outcomes(drawn, tests, options.compiled, options.jobs), total=len(drawn)):
        found[mutant.file, outcome] += 1
        if outcome == SURVIVED:
            tqdm.write(f"{mutant}", file=sys.stdout)
    for file in sorted({file for file, _ in found}):
        print(f"{file:<28}{found[file, KILLED]:>5} {KILLED}{found[file, SURVIVED]:>5} {SURVIVED}")
    share = sum(count for (_, outcome), count in found.items() if outcome == KILLED) / max(1, found.total())
    print(f"{share:.1%} of {found.total()} noticed; at least {LEAST_SHARE:.0%} must be")
    return int(share < LEAST_SHARE)


if __name__ == "__main__":
    sys.exit(main())
