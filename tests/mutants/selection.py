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
    "inventory": "fidelity_items",
    "melee": "fidelity_rules",
    "mortality": f"ablations fidelity_rules {REFUSED}",
    "motors": "mechanics_world fidelity",
    "physics": f"mechanics_flight fidelity {REFUSED}",
    "pickup": "fidelity_items",
    "record": "mechanics_observations vector_ends",
    "rewards": "ablations fidelity_rules",
    "room": "mechanics_reset fidelity",
    "safe_zone": f"mechanics_reset fidelity_rules {REFUSED}",
    "spawn_grid": f"mechanics_reset mechanics_world {REFUSED}",
    "steering": "ablations mechanics_world",
    "teams": f"mechanics_reset {REFUSED}",
    "aabb": "mechanics_culling",
    "blocks": "mechanics_culling",
    "bounds": "bounds",
    "broad_phase": "mechanics_culling fidelity",
    "points": "geometry",
    "rays": "geometry",
    "portable": "mechanics_flight fidelity box2d",
    "batch": "mechanics_flight box2d fidelity",
    "transfer": "fidelity",
}
NUMBERS = "mechanics_numbers scenario"  # where a number of a module is declared
BRIDGE = "box2d"
LEFT_OUT_TESTS = (  # three slow ones, and one whose child process imports the installed outlast
    "ablations.py::test_scripted_agents_can_steer",
    "fidelity_rules.py::test_the_longest_life_without_heals",
    "scenario.py::test_what_is_left_runs",
    "box2d.py::test_a_cached_kernel_runs_in_another_process",
)


def tests_of(mutant: Mutant) -> list[list[str]]:
    """Arguments for pytest, which is called for each list in turn until a test fails: collecting all takes long."""
    if mutant.file in COMPILED:
        first, others = BRIDGE.split(), []
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
