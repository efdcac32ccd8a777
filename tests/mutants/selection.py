"""Which files are mutated, and which tests run on the mutants of each."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tests.mutants.operators import Mutant

ROOT = Path(__file__).resolve().parents[2]
COMPILED = [f"systems/box2d/{name}.py" for name in ("workspace", "impact", "island", "native")]
LEFT_OUT = [f"systems/box2d/{name}.py" for name in ("layout", "probe", "sample", "verify")]

# Which tests run first, the fastest ahead; then those of NAIVE. Names are those of tests/*/test_NAME.py.
NAIVE = "edges observations bodies"
REFUSED = "bad_input.py::test_scenarios_are_refused"
FIRST = {
    "agents": "edges observations fidelity",
    "boxes": "edges reset fidelity_rules events",
    "cameras": "edges fidelity crowd",
    "death_drop": "fidelity_items events",
    "drop_last": "world events",
    "ending": "edges vector_ends events",
    "give_last": "fidelity_items events",
    "heals": "fidelity_items",
    "inventory": "fidelity_items events",
    "melee": "fidelity_rules events",
    "mortality": f"ablations fidelity_rules events {REFUSED}",
    "motors": "world fidelity",
    "physics": f"flight fidelity {REFUSED}",
    "pickup": "fidelity_items events",
    "record": "observations vector_ends events",
    "rewards": "ablations fidelity_rules",
    "room": "reset fidelity",
    "safe_zone": f"reset fidelity_rules events {REFUSED}",
    "spawn_grid": f"reset world {REFUSED}",
    "steering": "ablations world",
    "teams": f"reset {REFUSED}",
    "aabb": "culling",
    "blocks": "culling",
    "bounds": "bounds",
    "broad_phase": "culling fidelity",
    "points": "geometry",
    "rays": "geometry",
    "portable": "flight fidelity box2d",
    "batch": "flight box2d fidelity",
    "transfer": "fidelity",
}
NUMBERS = "numbers scenario"  # where a number of a module is declared
BOX2D = "box2d"
LEFT_OUT_TESTS = (  # three slow ones, and one whose child process imports the installed outlast
    "ablations.py::test_scripted_agents_can_steer",
    "fidelity_rules.py::test_the_longest_life_without_heals",
    "scenario.py::test_what_is_left_runs",
    "box2d.py::test_a_cached_kernel_runs_in_another_process",
)


def tests_of(mutant: Mutant) -> list[list[str]]:
    """Arguments for pytest, which is called for each list in turn until a test fails: collecting all takes long."""
    if mutant.file in COMPILED:
        first, others = BOX2D.split(), []
    else:
        first = NUMBERS.split() if mutant.declares else FIRST.get(Path(mutant.file).stem, "").split()
        others = [name for name in NAIVE.split() if name not in first]
    without = [f"--deselect={path(name)}" for name in LEFT_OUT_TESTS]
    return [[*map(path, names), *without] for names in (first, others) if names]


def path(name: str) -> str:
    """The path of a test file, or the id of one test in it."""
    file, _, test = name.partition("::")
    (found,) = ROOT.glob(f"tests/*/test_{file.removesuffix('.py')}.py")
    assert not test or f"def {test}(" in found.read_text(), f"there is no {test} in {found}"
    return str(found.relative_to(ROOT)) + (f"::{test}" if test else "")


def chosen(globs: Iterable[str], compiled: bool) -> list[str]:
    """The files of systems/ that are tested compiled, or as plain Python."""
    found = sorted({str(path.relative_to(ROOT)) for glob in globs for path in ROOT.glob(glob)})
    found = [file for file in found if Path(file).name != "__init__.py"]
    return [file for file in found if file not in LEFT_OUT and (file in COMPILED) == compiled]
