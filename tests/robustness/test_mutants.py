"""The mutation test names files and tests that exist."""

from pathlib import Path

from tests.mutants import FIRST, NAIVE, NUMBERS, ROOT, SLOW, chosen, path


def test_files_and_tests_that_are_named_exist() -> None:
    assert FIRST.keys() <= {Path(file).stem for file in chosen(["systems/**/*.py"], compiled=False)}
    for name in {*" ".join((*FIRST.values(), NAIVE, NUMBERS)).split(), *SLOW}:
        assert (ROOT / path(name).partition("::")[0]).exists()
