"""The command line does what the README says, and says what is wrong in one line."""

import pytest

from outlast import FIXES
from outlast.envs import main as cli
from outlast.envs.policies import POLICIES
from tests.conftest import interrupted_after


def run(capsys, *arguments: str) -> tuple[int, str, str]:
    status = cli.main(arguments)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_variants_lists_all_eight_with_their_original_names(capsys):
    status, out, _ = run(capsys, "variants")
    assert status == 0
    variants, fixes = out.split("\n\n")
    assert len(variants.splitlines()) == 8
    assert len(fixes.splitlines()) == 1 + len(FIXES)
    assert "teams_4   2v2_all_high" in out


def test_schedule_prints_the_tick(capsys):
    status, out, _ = run(capsys, "schedule", "1v1_heals_low")
    assert status == 0
    assert out.index("motors.drive") < out.index("physics.collide") < out.index("zone.burn")
    assert "boxes." not in out


def test_rollout_prints_rates_and_a_table_of_means_with_errors(capsys):
    arguments = ("rollout", "ffa_2", "--worlds", "3", "--steps", "150", "--policy", "noop", "--set", "zone_harm=50")
    status, out, err = run(capsys, *arguments)
    assert status == 0
    assert "world-step" in err  # the progress bar
    assert "450 world-steps in" in out
    assert "agent-steps/s" in out
    assert "std. error" in out
    assert "deaths_zone" in out
    assert out.split("length")[1].split()[0].replace(".", "").isdigit()


def test_the_same_seed_gives_the_same_table(capsys):
    arguments = ("rollout", "ffa_2", "--worlds", "2", "--steps", "120", "--set", "zone_harm=100", "--quiet")
    tables = [run(capsys, *arguments, "--seed", seed)[1].split("ended")[1] for seed in ("5", "5", "6")]
    assert tables[0] == tables[1] != tables[2]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("rollout", "ffa_9"), ("ffa_9", "did you mean", "ffa_1")),
        (("rollout", "ffa_1", "--set", "n_agents=100"), ("115 bodies", "64 cells")),
        (("rollout", "ffa_1", "--set", "mele_damage=3"), ("mele_damage", "melee_damage")),
        (("schedule", "nothing"), ("nothing", "known")),
    ],
)
def test_mistakes_are_told_in_one_line(capsys, arguments, words):
    status, _, err = run(capsys, *arguments)
    assert status == 2
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err


@pytest.mark.parametrize(
    ("option", "value", "least"), [("--worlds", "0", 1), ("--steps", "many", 1), ("--seed", "-1", 0)]
)
def test_numbers_that_cannot_be_are_refused(capsys, option, value, least):
    with pytest.raises(SystemExit):
        cli.main(("rollout", "ffa_1", option, value))
    assert f"{value}: an integer of at least {least} is needed" in capsys.readouterr().err


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_ctrl_c_prints_what_there_is(capsys, monkeypatch, quiet):
    monkeypatch.setitem(POLICIES, "random", interrupted_after(110))
    arguments = ("rollout", "ffa_1", "--worlds", "2", "--steps", "500", "--set", "zone_harm=100", *quiet)
    status, out, _ = run(capsys, *arguments)
    assert status == 130
    assert "220 world-steps" in out


def test_deaths_are_logged_on_request(capsys, caplog):
    with caplog.at_level("INFO", "outlast.deaths"):
        run(capsys, "rollout", "ffa_1", "--worlds", "4", "--steps", "103", "--policy", "noop", "--set", "zone_harm=100")
    assert "died of zone" in caplog.text
