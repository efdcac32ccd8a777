"""The command line does what the README says, and says what is wrong in one line."""

import contextlib
import logging
import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest

import outlast
from outlast import ABLATIONS, variant
from outlast.ecs import NumberError, Worlds
from outlast.envs.cli import main as cli
from outlast.envs.cli.options import scenario
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.scenario import Scenario
from tests.conftest import interrupted_after, run


def test_variants_lists_all_eight_with_their_original_names(capsys):
    status, out, _ = run(capsys, "variants")
    assert status == 0
    variants, ablations = out.split("\n\n")
    assert len(variants.splitlines()) == 8
    assert len(ablations.splitlines()) == 1 + len(ABLATIONS)
    assert "teams_4  2v2_all_high" in out


def test_schedule_prints_the_generated_code(capsys):
    status, out, _ = run(capsys, "schedule", "ffa_1", "--source")
    assert status == 0
    assert "# ---- MELEE (step): attacks have landed" in out
    assert "def unit(arguments, first, last):  # melee.aim" in out


def test_a_system_runs_as_python(capsys):
    few = ("rollout", "ffa_1", "--worlds", "2", "--steps", "5", "--quiet")
    status, out, _ = run(capsys, *few, "--interpret", "melee.aim", "--interpret", "melee.strike")
    assert status == 0
    assert "10 world-steps" in out
    status, _, err = run(capsys, *few, "--interpret", "melee.ain")
    assert status == 2
    assert "did you mean melee.aim" in err


def test_schedule_prints_the_tick(capsys):
    status, out, _ = run(capsys, "schedule", "1v1_heals_low")
    assert status == 0
    assert out.index("motors.drive") < out.index("physics.collide") < out.index("safe_zone.apply_damage")
    assert "boxes." not in out


def test_rollout_prints_rates_and_a_table_of_means_with_errors(capsys):
    command = "rollout ffa_2 --worlds 3 --steps 150 --policy noop --set safe_zone_damage=50"
    status, out, err = run(capsys, *command.split())
    assert status == 0
    assert "world-step" in err  # the progress bar
    assert "450 world-steps in" in out
    shares = re.search(r"agent-steps/s \(policy (\d+)%, worlds (\d+)%, rest (\d+)%\)", out)
    assert shares
    assert 98 <= sum(map(int, shares.groups())) <= 102
    assert "std. error" in out
    assert "deaths_zone" in out
    assert out.split("length")[1].split()[0].replace(".", "").isdigit()


def test_rollout_plays_whole_episodes_unless_steps_are_given(capsys):
    arguments = ("rollout", "ffa_2", "--worlds", "3", "--policy", "noop", "--set", "safe_zone_damage=100")
    status, out, err = run(capsys, *arguments)
    assert status == 0
    assert "3 worlds x 1 episode\n" in out
    assert "3 whole episodes, the first of every world" in out
    assert "3 of 3 episodes" in err  # the progress
    out = run(capsys, *arguments, "--episodes", "4", "--quiet")[1]
    assert "3 worlds x 4 episodes\n" in out
    assert "12 whole episodes, the first 4 of every world" in out
    out = run(capsys, *arguments, "--steps", "150", "--quiet")[1]
    assert "3 worlds x 150 steps\n" in out
    assert "episodes ended; those cut off at the end are missing, so means lean towards short episodes" in out
    with pytest.raises(SystemExit):
        cli.main((*arguments, "--steps", "150", "--episodes", "4"))
    assert "not allowed with argument" in capsys.readouterr().err


def test_the_same_seed_gives_the_same_table(capsys):
    arguments = ("rollout", "ffa_2", "--worlds", "2", "--steps", "120", "--set", "safe_zone_damage=100", "--quiet")
    tables = [run(capsys, *arguments, "--seed", seed)[1].split("ended")[1] for seed in ("5", "5", "6")]
    assert tables[0] == tables[1] != tables[2]


def others(name: str) -> Iterator[tuple[Any, Scenario]]:
    """Values like that of a number of teams_4, which has all mechanics, and the scenario with each that it takes."""
    asked = variant("teams_4")
    value = asked.numbers()[name]
    if isinstance(value, str):
        (field,) = (f for m in asked.modules for f in fields(m) if f"{m.name}_{f.name}" == name)
        values = field.metadata["choices"]
    elif isinstance(value, bool):
        values = (not value,)
    elif isinstance(value, tuple):
        values = (value[:2], value[:1], tuple(x / 2 for x in value)) if value else ((1.0, 3.0),)
    else:
        values = (value + 1, value / 2)
    for each in values:
        with contextlib.suppress(NumberError):
            yield each, asked.replace(**{name: each})


@pytest.mark.parametrize("name", variant("teams_4").numbers())
@pytest.mark.by_day(20)
def test_set_changes_any_number(name: str) -> None:
    changed = [(value, expected) for value, expected in others(name) if expected != variant("teams_4")]
    assert changed
    for value, expected in changed:
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        for form in (text, f"({text})") if isinstance(value, tuple) else (text,):
            options = cli.parser().parse_args(["rollout", "teams_4", "--set", f"{name}={form}"])
            assert scenario(options) == expected


def test_a_smaller_room_gets_a_smaller_zone(capsys):
    numbers = (
        "--set",
        "room_size=20",
        "--set",
        "safe_zone_radii=8,4",
        "--set",
        "safe_zone_stand=5",
        "--set",
        "safe_zone_shrink=5",
    )
    status, out, _ = run(
        capsys, "rollout", "ffa_2", *numbers, "--set", "safe_zone_damage=100", "--worlds", "2", "--quiet"
    )
    assert status == 0
    assert float(out.split("length")[1].split()[0]) <= 21  # when the last circle is gone


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_ctrl_c_prints_what_there_is(capsys, monkeypatch, quiet):
    monkeypatch.setitem(POLICIES, "random", interrupted_after(110))
    arguments = ("rollout", "ffa_1", "--worlds", "2", "--steps", "500", "--set", "safe_zone_damage=100", *quiet)
    status, out, _ = run(capsys, *arguments)
    assert status == 130
    assert "220 world-steps" in out


def test_deaths_are_logged_on_request(capsys, caplog):
    with caplog.at_level("INFO", "outlast.deaths"):
        run(
            capsys,
            "rollout",
            "ffa_1",
            "--worlds",
            "4",
            "--steps",
            "103",
            "--policy",
            "noop",
            "--set",
            "safe_zone_damage=100",
        )
    assert "died of zone" in caplog.text


def test_the_version_is_printed(capsys):
    with pytest.raises(SystemExit, match="0"):
        cli.main(("--version",))
    assert capsys.readouterr().out == f"outlast {outlast.__version__}\n"


def test_a_compilation_is_announced_on_stderr(capsys, monkeypatch):
    monkeypatch.setattr(Worlds, "uncompiled", ["clock"])
    arguments = ("rollout", "ffa_1", "--worlds", "1", "--steps", "3", "--quiet")
    status, _, err = run(capsys, *arguments)
    assert status == 0
    assert err.startswith("outlast: compiling 1 system of ffa_1 for this machine; machine code is kept in ")
    assert "outlast: compiled in 0 s\n" in err
    assert logging.getLogger("outlast").handlers == []
