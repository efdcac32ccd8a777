"""Scenarios of one's own by name: from files, modules and installed packages."""

import pickle
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import gymnasium
import pytest

from outlast.envs.cli.main import main
from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios import parse as entry_points
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.parse import named, resolve

SWAMP = """
from dataclasses import dataclass

from outlast.ecs import Module, number


@dataclass(frozen=True)
class Swamp(Module):
    drag: float = number(0.5, low=0, high=1)
"""
BOG = """
import outlast
from swamp_of_bog import Swamp

arena = outlast.Scenario("the arena", (*outlast.variant("ffa_1").modules, Swamp()), "a duel in a swamp")
again = arena
three = 3


def quick():
    return arena.replace(ending_limit=50)


def wrong():
    return len(3)
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    (tmp_path / "bog.py").write_text(BOG)
    (tmp_path / "swamp_of_bog.py").write_text(SWAMP)
    before = set(sys.modules)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    yield tmp_path
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "/").is_relative_to(tmp_path):
            del sys.modules[name]


def test_a_file_is_imported_once_and_its_mechanics_are_one_class(folder: Path) -> None:
    file = folder / "bog.py"
    arena = named(f"{file}:arena")
    assert arena.name == "the arena"
    assert named(str(file)) is named("bog:arena") is resolve(f"{folder}/../{folder.name}/bog.py:again") is arena
    assert named(f"{file}:quick").numbers()["ending_limit"] == 50
    assert type(pickle.loads(pickle.dumps(arena))["swamp"]) is type(arena["swamp"])
    (folder / "c++ or d:e").mkdir()
    (folder / "c++ or d:e" / "fen.py").write_text("from bog import arena as a")
    assert named(f"{folder}/c++ or d:e/fen.py:a") is named(f"{folder}/c++ or d:e/fen.py") is arena
    assert named(f"{file}:arena+steering").name == "the arena+steering"


def test_a_game_without_a_name_of_its_own_is_called_as_it_is_named(folder: Path) -> None:
    """Two derived games of one file have short names, which differ, and numbers go on following their first values."""
    (folder / "hunts.py").write_text(
        "import outlast\nHUNT = outlast.variant('teams_3').without('boxes').replace(safe_zone_radii=(8, 4))\n"
        "CHASE = HUNT.replace(n_heals=3)\n"
    )
    hunt, chase = (named(f"{folder}/hunts.py:{name}") for name in ("HUNT", "CHASE"))
    assert (hunt.file_name, chase.file_name, named(f"{folder}/bog.py:quick").name) == ("HUNT", "CHASE", "quick")
    changed = resolve(f"{folder}/hunts.py:HUNT", {"room_size": 30})
    assert changed.name == "HUNT-room_size=30"
    assert changed.about == f"{hunt.about.replace('safe', 'room_size=30, safe')}"
    assert changed.numbers()["safe_zone_radii"] == (8, 4)
    assert fingerprint(changed)["name"] == "teams_3"
    changed.save(folder / "long.json")
    again = named(f"{folder}/long.json")
    assert (again.name, again.replace(room_size=25).name) == ("long", "long-room_size=25")
    assert again.replace(room_size=25).numbers() == hunt.numbers()
    assert hunt.known_as("other") is hunt


def test_other_processes_load_its_pickles(folder: Path) -> None:
    """As those that multiprocessing spawns: they get `sys.path` and no module."""
    content = pickle.dumps(named(f"{folder}/bog.py")["swamp"])
    script = f"import pickle, sys; sys.path[:] = {sys.path!r}; print(pickle.loads({content!r}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "Swamp(drag=0.5)\n"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("{}/bo.py:arena", r"there is no file .*/bo\.py; did you mean bog\.py\?"),
        ("{}/bog.py:three", "bog.py:three is int 3: a Scenario is needed, or a function"),
        ("{}/bog.py:quik", "has no 'quik'; did you mean quick"),
        ("{}/bog.py:wrong", r"bog\.py, line 15: TypeError: object of type 'int' has no len\(\)"),
        ("{}/bog.py:arena+steerin", "there is no ablation 'steerin'"),
        (
            "{}/swamp_of_bog.py",
            r"holds no Scenario: add one, as in GAME = .*\.with_\(Swamp\(\)\), or name what makes one",
        ),
        ("{}/two.py", "holds ONE, TWO: name one, as in .*two.py:ONE"),
        ("{}/broken.py:x", r"broken\.py, line 3: ZeroDivisionError: division by zero"),
        ("{}/leaves.py:x", r"leaves\.py, line 2: SystemExit: 3"),
        ("{}/declares.py:x", r"declares\.py, line 3: DeclarationError: "),
        ("{}/json.py:x", r"cannot be imported: 'json' is .*json/__init__\.py; rename it"),
        ("{}/a-b.py:x", "'a-b' is not a name of a module; rename the file"),
        ("no.such.module:x", "there is no module no.such.module"),
        ("ffa_33", "there is no variant 'ffa_33'; did you mean ffa_3 or"),
    ],
)
def test_what_cannot_be_named(folder: Path, name: str, message: str) -> None:
    (folder / "two.py").write_text("import outlast\nONE, TWO = outlast.variant('ffa_1'), outlast.variant('ffa_2')")
    (folder / "broken.py").write_text("import numpy\n\n1 / 0")
    (folder / "leaves.py").write_text("import sys\nsys.exit(3)")
    (folder / "declares.py").write_text("from outlast.ecs import Module\n\nclass Bad(Module): name = 'No Name'")
    (folder / "json.py").write_text("x = 3")
    (folder / "a-b.py").write_text("x = 3")
    path = sys.path.copy()
    with pytest.raises(ScenarioError, match=message) as caught:
        named(name.format(folder))
    assert "\n" not in str(caught.value)
    if "bog.py" not in name and "two.py" not in name:
        assert sys.path == path


def test_a_file_in_a_package_is_a_module_of_it(folder: Path) -> None:
    package = folder / "games_of_bog" / "inner"
    package.mkdir(parents=True)
    for place in (package, package.parent):
        (place / "__init__.py").touch()
    (package / "marsh.py").write_text("from .. import inner\nimport outlast\nM = outlast.variant('ffa_1')")
    assert named(f"{package}/marsh.py") is named("games_of_bog.inner.marsh:M")


@pytest.fixture
def entries(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[EntryPoint]]:
    entries = list[EntryPoint]()
    monkeypatch.setattr(entry_points, "entry_points", lambda group: [e for e in entries if e.group == group])
    monkeypatch.syspath_prepend(folder)
    entry_points.installed.cache_clear()
    yield entries
    entry_points.installed.cache_clear()


def test_scenarios_of_installed_packages(entries: list[EntryPoint], capsys: pytest.CaptureFixture[str]) -> None:
    entries += [
        EntryPoint("hunt", "bog:arena", entry_points.GROUP),
        EntryPoint("gone", "bog_that_is_gone:arena", entry_points.GROUP),
    ]
    assert named("hunt").name == "the arena"
    assert main(["variants"]) == 0
    out, err = capsys.readouterr()
    assert "\nhunt  bog  a duel in a swamp\n" in out
    assert "outlast: the scenario 'gone' of the package bog_that_is_gone: there is no module bog_that_is_gone" in err
    with pytest.raises(ScenarioError, match="the scenario 'gone' of the package"):
        named("gone")
    with pytest.raises(ScenarioError, match="did you mean hunt"):
        named("hnt")


def test_registered_by_name(entries: list[EntryPoint], monkeypatch: pytest.MonkeyPatch) -> None:
    from outlast.envs.adapters import registry

    entries.append(EntryPoint("hunt", "bog:quick", entry_points.GROUP))
    registered: dict[str, Any] = dict(gymnasium.registry)
    monkeypatch.setattr(gymnasium.envs.registration, "registry", registered)
    monkeypatch.setattr(gymnasium, "registry", registered)
    registry.register()
    env = gymnasium.make("outlast/hunt-v1")
    assert env.unwrapped.metadata["name"] == "hunt"
