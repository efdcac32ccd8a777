"""The mutation test: it distinguishes a mutant that a test detects from an equivalent one."""

import importlib.util
from pathlib import Path

import pytest

from tests.mutants import (
    FIRST,
    KILLED,
    LEFT_OUT,
    LEFT_OUT_TESTS,
    NAIVE,
    NUMBERS,
    ROOT,
    SURVIVED,
    Mutant,
    chosen,
    mutants,
    outcomes,
    path,
    sampled,
)

needs_cosmic_ray = pytest.mark.skipif(
    not importlib.util.find_spec("cosmic_ray"), reason="needs cosmic-ray: outlast[mutation]"
)
NOTICED = "- if push(bag, item, e, row):\n+ if not push(bag, item, e, row):"
EQUIVALENT = "- body.ApplyAngularImpulse(float(row[JTURN]), True)"  # wakes a body that is awake


@needs_cosmic_ray
def test_what_is_noticed_and_what_survives() -> None:
    def found(file: str, difference: str) -> Mutant:
        return next(mutant for mutant in mutants(file) if mutant.difference.startswith(difference))

    pair = [found("systems/pickup.py", NOTICED), found("systems/box2d/portable.py", EQUIVALENT)]
    tests = [["tests/mechanics/test_fidelity_items.py"]]
    assert [*outcomes(pair, tests, compiled=False, jobs=1)] == [(pair[0], KILLED), (pair[1], SURVIVED)]


@needs_cosmic_ray
def test_a_sample_is_the_same_for_a_seed_and_takes_of_every_file() -> None:
    files = ["systems/pickup.py", "systems/record.py", "systems/drop_last.py"]
    some = sampled(files, 12, 1)
    assert some == sampled(files, 12, 1) != sampled(files, 12, 2)
    assert {mutant.file for mutant in some} == set(files)
    assert len(set(some)) == len(some) == pytest.approx(12, abs=2)
    assert all(mutant.possible for mutant in some)


@needs_cosmic_ray
def test_what_cannot_matter_is_left_alone() -> None:
    """Decorators, docstrings and imports; and files with a mutation test of their own."""
    lines = (ROOT / "systems/drop_last.py").read_text().splitlines()
    changed = {lines[mutant.line - 1].strip() for mutant in mutants("systems/drop_last.py")}
    assert {"low=0,", "for i in range(agents.size):"} <= changed
    assert not any(line.startswith(("@", '"""', "def ", "from ")) for line in changed)
    assert "systems/box2d/native.py" in chosen(["systems/**/*.py"], compiled=True)
    assert not set(LEFT_OUT) & {*chosen(["systems/**/*.py"], False), *chosen(["systems/**/*.py"], True)}


def test_files_and_tests_that_are_named_exist() -> None:
    assert FIRST.keys() <= {Path(file).stem for file in chosen(["systems/**/*.py"], compiled=False)}
    for name in {*" ".join((*FIRST.values(), NAIVE, NUMBERS)).split(), *LEFT_OUT_TESTS}:
        assert (ROOT / path(name).partition("::")[0]).exists()
