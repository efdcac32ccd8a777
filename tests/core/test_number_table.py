"""`outlast numbers`: every number with value, range, unit and meaning; and numbers that would hang are refused."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast import variant
from outlast.ecs import Archetype, Module, NumberError, number
from outlast.envs.cli.main import main


@dataclasses.dataclass(frozen=True)
class Crowd(Module):
    """A mechanic of somebody's that brings many entities, or a table of many rows."""

    count: int = 1
    rows: int = number(1, low=1)

    def archetypes(self) -> Any:
        return [Archetype("crowd", (), self.count)]

    def dims(self) -> dict[str, int | str]:
        return {"crowd_rows": self.rows}


@pytest.fixture(autouse=True)
def _piped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are as wide as they need to be; pytest-xdist sets a width of the terminal."""
    monkeypatch.delenv("COLUMNS", raising=False)


def test_the_command_prints_a_row_for_every_number(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["numbers", "teams_4", "--set", "melee_damage=20", "--without", "heals"]) == 0
    out = capsys.readouterr().out
    lines = [line.split() for line in out.splitlines()]
    scenario = variant("teams_4").without("heals").replace(melee_damage=20)
    assert [line[0] for line in lines] == ["name", *scenario.numbers()]
    assert ["melee_damage", "20", "5", "0", "to", "1000000", "hit", "points", "damage", "of", "a", "strike"] in lines
    assert out.isascii()
    assert all(line == line.rstrip() for line in out.splitlines())


@pytest.mark.parametrize("numbers", [{"count": 2**31 - 1}, {"rows": 2**31 - 1}, {"count": 65_537}, {"rows": 65_537}])
def test_tables_that_could_not_be_laid_out_are_refused_at_once(numbers: dict[str, int]) -> None:
    with pytest.raises(NumberError, match=r"at most 65536 (is|are) possible"):
        outlast.make_vec(variant("ffa_1").with_(Crowd(**numbers)), 1)


def test_the_command_says_what_numbers_are_drawn_from(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    scenario = variant("ffa_1").vary(heals_count=outlast.distributions.integers(2, 8))
    prey = outlast.role(melee_damage=outlast.distributions.integers(0, 2))
    scenario.roles(hunter=outlast.role(1, melee_damage=20), prey=prey).save(tmp_path / "game.json")
    assert main(["numbers", str(tmp_path / "game.json")]) == 0
    out = capsys.readouterr().out
    assert "heals_count                  integers(2, 8)  " in out
    assert "melee_damage                 hunter 20, prey integers(0, 2)  " in out
