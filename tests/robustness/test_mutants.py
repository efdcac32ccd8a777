"""Mutants are tested by the tests that execute their lines, in a copy of the tree where all of these pass."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants import FOLDERS, ROOT, SLOW, Coverage, Mutant, copy_of_the_tree, first_failure, path

TESTS = "tests/mechanics/test_geometry.py"
GAP, CONE = (f"{TESTS}::test_{name}_the_naive_form" for name in ("gap_equals", "cameras_equal"))


def test_a_mutant_is_tested_by_what_executes_its_line(tmp_path: Path) -> None:
    file = tmp_path / "coverage"
    variables = os.environ | {"NUMBA_DISABLE_JIT": "1", "COVERAGE_FILE": str(file)}
    words = ["-m", "pytest", "-q", "-p", "no:cacheprovider", "--cov", "--cov-context=test", "--cov-report=", GAP, CONE]
    subprocess.run([sys.executable, *words], cwd=ROOT, env=variables, check=True, capture_output=True)
    coverage, points = Coverage(file), "systems/geometry/points.py"
    lines = (ROOT / points).read_text().splitlines()
    found = {}
    for name, words in {"gap": "return np.float32(np.sqrt(", "cone": "beyond = ", "constant": "ONE = "}.items():
        (line,) = (number for number, text in enumerate(lines, 1) if words in text)
        tests, files, _ = coverage.tests(Mutant(points, "NumberReplacer", 0, line))
        found[name] = {test for test in tests if "deselect" not in test}
        assert files[0] == TESTS
    assert found == {"gap": {GAP}, "cone": {CONE}, "constant": {GAP, CONE}}


@pytest.mark.nightly
def test_tests_pass_in_the_copy_of_the_tree(tmp_path: Path) -> None:
    without = [f"--deselect={path(name)}" for name in SLOW]
    assert first_failure(copy_of_the_tree(tmp_path), [[*FOLDERS.split(), *without]], compiled=False) == ""
