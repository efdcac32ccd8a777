"""A mechanic goes with its file: what is left imports, and schedules as if that mechanic were not in the scenario."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from outlast import systems
from outlast.ecs import Module, Worlds
from tests.conftest import few_by_day

FOLDER = Path(systems.__file__).parent
KINDS: dict[str, type[Module]] = {kind: getattr(systems, kind) for kind in systems.__all__}
# What these bring, others of the scenario read: without them, an error says so (tests/core/test_scenario.py, NEEDED).
NEEDED = {"Agents", "Ending", "Inventory", "Rewards", "Room", "Teams"}
EXCLUDED = {"FreeForAll", "Steering", "FineMotors", "FineSteering"}  # by Teams and by Motors
EXCLUDED |= {"Maze", "Pillars", "Rooms", "Walls"}  # by each other; where they stand, other systems wait for them
OTHERS = {"ObserveRoles", "Respawn"}  # for scenarios with roles, and for those that end at their limit only
OPTIONAL = sorted(KINDS.keys() - NEEDED)
FIRST = {"Melee"}  # to emit hits: if it did not exist, nobody could emit any in time for those who read them
INACTIVE = {  # for want of what the mechanic brings
    "Boxes": {"behaviour.take_cover"},
    "GiveLast": {"behaviour.give"},
    "Heals": {"behaviour.examine", "behaviour.heal", "behaviour.give"},
    "Lidar": {"preparation.measure_nothing"},
    "Melee": {"preparation.hold_fire", "behaviour.strike"},
    "SafeZone": {"behaviour.expose"},
}
WAITING = {"SpawnGrid": {"behaviour.begin"}}  # for bodies to be placed: without it, they run earlier

CHILD = """
import sys
from outlast import systems
from outlast.ecs import Worlds
modules = [getattr(systems, kind)() for kind in systems.__all__ if kind not in sys.argv]
for system in Worlds(modules, 1).schedule.systems:
    print(system.label)
"""


def scheduled(*left_out: str) -> list[str]:
    """The systems of all mechanics but those, in order."""
    modules = [kind() for name, kind in KINDS.items() if name not in EXCLUDED.union(OTHERS, left_out)]
    return [system.label for system in Worlds(modules, 1).schedule.systems]


@pytest.mark.parametrize("name", few_by_day(sorted({*OPTIONAL} - FIRST), ("Boxes", "Motors")))
def test_the_rest_imports_and_schedules_without_the_file(name: str, tmp_path: Path) -> None:
    """In a package whose folder of mechanics lacks that file, and whose list of mechanics lacks what is in it."""
    package = tmp_path / "outlast"
    (package / "systems").mkdir(parents=True)
    (package / "__init__.py").touch()
    for part in ("ecs", "components"):
        (package / part).symlink_to(FOLDER.parent / part)
    file = KINDS[name].__module__.rpartition(".")[2]
    own = [kind for kind, found in KINDS.items() if found.__module__ == KINDS[name].__module__]
    for path in FOLDER.iterdir():
        if path.name not in (f"{file}.py", "__init__.py"):
            (package / "systems" / path.name).symlink_to(path)
    text = (FOLDER / "__init__.py").read_text()
    text = re.sub(rf'^(from \.{file} import .+|    "({"|".join(own)})",)\n', "", text, flags=re.MULTILINE)
    (package / "systems" / "__init__.py").write_text(text)
    environment = {"PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1", "OUTLAST_CACHE_DIR": str(tmp_path / "cache")}
    command = [sys.executable, "-c", CHILD, *EXCLUDED, *OTHERS]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == scheduled(*own)


@pytest.mark.parametrize("name", OPTIONAL)
def test_the_order_of_the_rest_stays(name: str) -> None:
    own = {system.label for system in KINDS[name].all_systems()} | INACTIVE.get(name, set()) | WAITING.get(name, set())
    rest, everything = ([label for label in each if label not in own] for each in (scheduled(name), scheduled()))
    assert rest == everything
