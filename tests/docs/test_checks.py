"""`python -m tests`: its last line names what was left out, and the texts about it agree."""

import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import tests.__main__ as check

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def report(tmp_path: Path) -> Path:
    """The JUnit report of tests of which some were skipped: by a mark, by a module, for another reason."""
    (tmp_path / "test_some.py").write_text(
        "import pytest\n"
        "@pytest.mark.skip(reason='needs torch: outlast[train]')\ndef test_one(): pass\n"
        "@pytest.mark.skip(reason='Ray is not installed: pip install outlast[ray]')\ndef test_two(): pass\n"
        "@pytest.mark.skip(reason='Windows has no such signal')\ndef test_three(): pass\n"
        "def test_four(): pass\n"
    )
    (tmp_path / "test_more.py").write_text(
        "import pytest\npytest.importorskip('no_such_library', reason='needs it: outlast[docs,sb3]')\n"
    )
    path = tmp_path / "report.xml"
    command = [sys.executable, "-m", "pytest", "-q", f"--junitxml={path}", "--rootdir=.", "."]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    return path


def test_what_tests_lack_is_read_from_their_report(report: Path) -> None:
    assert check.extras(report) == {"train", "ray", "docs", "sb3"}
    assert check.counts(report) == {"passed": 1, "skipped": 4, "failed": 0}
    assert check.extras(report.with_name("none.xml")) == frozenset()


@pytest.mark.parametrize(
    ("types", "needed", "end"),
    [
        (True, {"ray"}, ""),  # its tests have an environment of their own
        (False, set(), "mypy"),
        (True, {"train", "ray"}, "tests that need outlast[train]"),
        (False, {"train", "sb3"}, "mypy and tests that need outlast[sb3,train]"),
    ],
)
def test_the_last_line_names_what_was_left_out(
    types: bool, needed: set[str], end: str, capsys: pytest.CaptureFixture[str]
) -> None:
    tests = Counter(passed=5, failed=0, skipped=2)
    results = [check.Result("pytest", True, 1.0, tests, frozenset(needed)), check.Result("ruff", True, 1.0)]
    assert check.summary(results, types) == 0
    end = f"; left out: {end} (all are in '.[test-all]')" if end else ""
    assert capsys.readouterr().out.splitlines()[-1] == f"5 passed, 0 failed, 2 skipped{end}"


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/reliability.md"])
def test_pages_that_install_the_tests_name_what_these_leave_out(page: str) -> None:
    text = (ROOT / page).read_text()
    assert ".[test]'" in text
    assert ".[test-all]" in text
