"""The mutation test: it distinguishes a mutant that a test detects from an equivalent one."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.mutants.selection import FIRST, LEFT_OUT, LEFT_OUT_TESTS, NAIVE, NUMBERS, ROOT, chosen, path

HAVE_COSMIC_RAY = importlib.util.find_spec("cosmic_ray") is not None
needs_cosmic_ray = pytest.mark.skipif(not HAVE_COSMIC_RAY, reason="needs cosmic-ray: outlast[mutation]")
if HAVE_COSMIC_RAY:
    from tests.mutants.operators import Mutant, mutants, sampled

NOTICED = "- if push(bag, item, e, row):\n+ if not push(bag, item, e, row):"
EQUIVALENT = "- body.ApplyAngularImpulse(float(row[JTURN]), True)"  # wakes a body that is awake


def found(file: str, difference: str) -> "Mutant":
    return next(mutant for mutant in mutants(file) if mutant.difference.startswith(difference))


@needs_cosmic_ray
def test_what_is_noticed_and_what_survives(tmp_path: Path) -> None:
    """--again runs exactly the two mutants of an earlier report."""
    pair = found("systems/pickup.py", NOTICED), found("systems/box2d/portable.py", EQUIVALENT)
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text(json.dumps([asdict(mutant) | {"outcome": "survived"} for mutant in pair]))
    command = [sys.executable, "-m", "tests.mutants", "--jobs", "1", "--again", str(before), "--out", str(after)]
    command += ["--tests", "tests/mechanics/test_fidelity_items.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    outcomes = {row["file"]: row["outcome"] for row in json.loads(after.read_text())}
    assert outcomes == {"systems/pickup.py": "killed", "systems/box2d/portable.py": "survived"}
    assert EQUIVALENT in done.stdout
    assert NOTICED not in done.stdout
    assert done.stdout.endswith("50.0% of 2 noticed; at least 85% must be\n")
    assert done.returncode == 1  # too few


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
    assert "offset: float = number(1.0, low=0)  # metres from the agent's centre" in changed
    assert not any(line.startswith(("@", '"""', "def ", "from ")) for line in changed)
    assert "systems/box2d/native.py" in chosen(["systems/**/*.py"], compiled=True)
    assert not set(LEFT_OUT) & {*chosen(["systems/**/*.py"], False), *chosen(["systems/**/*.py"], True)}


def test_files_and_tests_that_are_named_exist() -> None:
    assert FIRST.keys() <= {Path(file).stem for file in chosen(["systems/**/*.py"], compiled=False)}
    for name in {*" ".join((*FIRST.values(), NAIVE, NUMBERS)).split(), *LEFT_OUT_TESTS}:
        assert (ROOT / path(name).partition("::")[0]).exists()
