"""Scenarios as JSON, and the options of commands that change one."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast import VARIANTS, Scenario, variant
from outlast.components import Health, Phase
from outlast.ecs import EngineError, Module, Read, number
from outlast.envs.cli import options
from outlast.envs.cli.grammar import Parser
from outlast.envs.cli.main import main
from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.fingerprint import classes, fingerprint, rebuilt
from outlast.envs.scenarios.parse import mechanic, named
from outlast.systems import DropLast, Maze, Teams


@dataclass(frozen=True)
class Trap(Module):
    """Numbers that follow: the room's side, each other, and one that is 0."""

    side: float = number(10.0, scales_with="room_size")
    reach: float = number(1.0, scales_with="trap_side")
    deep: float = number(0.0)
    wet: float = number(1.0, scales_with="trap_deep")


@Trap.system(Phase.RECORD)
def set_trap(health: Read[Health], side: float, reach: float, deep: float, wet: float) -> None:
    pass


BARS = outlast.levels.FloorPlan(walls=[(-4, 0, 0.5, 8), (4, 0, 0.5, 8, 0.6)])
OBSERVED_TWICE = {"varied": {"melee_damage": ["integers", 1, 2]}, "observed": ["melee_damage"] * 2}
ROOM_ROLE = {"drawn": "never", "roles": [{"name": "a", "count": None, "numbers": {"room_size": 9}}]}
EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"


@pytest.fixture
def tag(monkeypatch: pytest.MonkeyPatch) -> Scenario:
    monkeypatch.syspath_prepend(str(EXAMPLES))
    return named(f"{EXAMPLES}/tag.py:TAG")


def asked(*words: str) -> Scenario:
    parser = Parser()
    options.add_scenario(parser)
    return options.scenario(parser.parse_args(words))


def test_json_holds_all_of_a_scenario(tag: Scenario, tmp_path: Path) -> None:
    derived = variant("teams_3").without("heals").replace(n_agents=6, ending_rule="all dead").ordered("melee", "boxes")
    for k, scenario in enumerate((*VARIANTS.values(), variant("ffa_1+steering"), derived, tag)):
        scenario.save(tmp_path / f"{k}.json")
        loaded = Scenario.load(tmp_path / f"{k}.json")
        assert loaded == scenario == Scenario.from_json(scenario.to_json())
        assert named(f"{tmp_path}/{k}.json") == scenario.known_as(f"{k}")
        assert type(loaded.modules[0]) is type(scenario.modules[0])
    assert len(list(tmp_path.iterdir())) == len(VARIANTS) + 3
    env = outlast.make_vec(f"{tmp_path}/0.json", 1, seed=0, melee_damage=7)
    assert env.scenario.name == "ffa_1-melee_damage=7"


def test_json_holds_what_differs_between_worlds_and_agents(tmp_path: Path) -> None:
    plain = variant("teams_3").with_(Maze(), Teams(sizes=(1, 3)))
    roles = {
        "hunter": outlast.role(1, melee_damage=outlast.distributions.integers(10, 20)),
        "prey": outlast.role(agents=(1, 2, 3)),
    }
    varied = plain.vary(
        safe_zone_damage=outlast.distributions.choice(1, 5), rewards_kill=outlast.distributions.uniform(0, 1)
    )
    both = varied.observe_numbers("safe_zone_damage").roles(**roles, drawn="side")
    plan = plain.with_(BARS.mechanic(3)).vary(walls_layout=outlast.distributions.choice(BARS.layout(3), BARS.layout(3)))
    for scenario in (varied, plain.roles(**roles), both, plan):
        loaded = Scenario.from_json(scenario.to_json())
        assert loaded == scenario
        assert rebuilt(json.loads(json.dumps(fingerprint(scenario))), classes(scenario)).varied == scenario.varied
        again = loaded.replace(melee_reach=3.0)
        assert (again.varied, again.by_role) == (scenario.varied, scenario.by_role)
        assert again.name == scenario.replace(melee_reach=3.0).name
        env = outlast.make_vec(loaded, 2, seed=0)
        env.reset()


def test_json_holds_which_numbers_follow_others_and_which_were_set_by_hand() -> None:
    by_hand = variant("ffa_1").replace(room_size=40.0, safe_zone_radii=(20.0, 9.0, 3.0))
    added = variant("ffa_1").without("safe_zone").with_(variant("ffa_1")["safe_zone"])
    for scenario in (by_hand, added, variant("ffa_1"), variant("ffa_1").replace(room_size=30.0)):
        loaded = Scenario.from_json(scenario.to_json())
        kept, again = scenario.replace(room_size=60.0), loaded.replace(room_size=60.0)
        assert (again, again.name, again.about) == (kept, kept.name, kept.about)
        assert fingerprint(loaded) == fingerprint(scenario)
        assert Scenario.from_json(loaded.to_json()).to_json() == loaded.to_json() == scenario.to_json()
    assert by_hand.replace(room_size=60.0)["safe_zone"].radii == (20.0, 9.0, 3.0)
    assert added.replace(room_size=60.0)["safe_zone"].radii != added["safe_zone"].radii


def test_numbers_follow_whatever_changes_what_they_follow() -> None:
    game: Any = variant("ffa_1").with_(Trap())
    assert (game.replace(room_size=50.0)["trap"].side, game.replace(room_size=50.0)["trap"].reach) == (20.0, 2.0)
    assert game.replace(trap_side=20.0)["trap"].reach == 2.0
    assert game.replace(trap_deep=3.0)["trap"].wet == 1.0
    room = game["room"].replace(size=50.0)
    assert game.with_(room)["safe_zone"].radii == game.replace(room_size=50.0)["safe_zone"].radii
    assert game.with_(room).replace(room_size=100.0)["trap"].side == 40.0
    assert variant("ffa_1").replace(room_size=50.0).with_(Trap()).replace(room_size=100.0)["trap"].side == 20.0
    assert game.with_(room, game["safe_zone"])["safe_zone"].radii == game["safe_zone"].radii
    varied = game.vary(trap_side=outlast.distributions.uniform(1, 2))
    assert dict(varied.replace(room_size=50.0).varied).keys() == {"trap_side"}


def test_commands_import_what_json_needs_if_they_are_told_to(tag: Scenario, tmp_path: Path, capsys: Any) -> None:
    tag.save(tmp_path / "tag.json")
    for module in [name for name in sys.modules if name == "tag"]:
        del sys.modules[module]
    assert main(["schedule", f"{tmp_path}/tag.json"]) == 2
    assert "tag.Shields is not one of outlast's own" in capsys.readouterr().err
    assert main(["schedule", f"{tmp_path}/tag.json", "--import", f"{EXAMPLES}/tag.py"]) == 0
    assert "stamina.tire" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda form: form | {"varyed": {}}, "it has 'varyed'; its keys are version, .*, varied, observed, roles"),
        (lambda form: form | OBSERVED_TWICE, "a number is observed twice"),
        (lambda form: form | {"name": "a\nb"}, "its names cannot be"),
        (lambda form: form | {"modules": form["modules"] * 2}, "exclude each other|missing"),
        (lambda form: form | {"varied": {"x_y": ["uniform", 1, 2]}}, "unknown number 'x_y'"),
        (lambda form: form | {"varied": {"melee_damage": ["uniform", 1, 2]}}, "melee_damage"),
        (lambda form: form | {"observed": ["melee_damage"]}, "melee_damage is observed there, and does not vary"),
        (lambda form: form | {"roles": ROOM_ROLE}, "role a: the number room_size is the same for all agents"),
        (lambda form: form | {"added": {"safe_zone_radii": [[1, 2], 10**400]}}, "added safe_zone_radii = "),
        (lambda form: form | {"numbers": form["numbers"] | {"x_y": 3}}, "unknown number x_y"),
        (lambda form: form | {"numbers": form["numbers"] | {"melee_damage": -1}}, "melee.damage = -1: must be >= 0"),
    ],
)
def test_json_that_cannot_be(change: Callable[[Any], Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps(change(json.loads(variant("ffa_1").to_json()))))
    with pytest.raises((ScenarioError, EngineError), match=message) as caught:
        Scenario.load(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("words", "number", "value"),
    [
        ("--set safe_zone_radii=5,3,1", "safe_zone_radii", (5.0, 3.0, 1.0)),
        ("--set safe_zone_radii=5,", "safe_zone_radii", (5.0,)),
        ("--set ending_limit=1e3", "ending_limit", 1000),
        ("--set ending_rule=all dead", "ending_rule", "all dead"),
        ("--set room_walls=False", "room_walls", False),
        ("--set n_agents=3", "agents_count", 3),
        ("--set room_size=50", "safe_zone_radii", (25.0, 20.0, 15.0, 10.0, 8.0, 4.0, 2.0)),
    ],
)
def test_every_kind_of_number_can_be_set(words: str, number: str, value: Any) -> None:
    option, _, text = words.partition(" ")
    found = asked("ffa_2", option, text).numbers()[number]
    assert found == value
    assert type(found) is type(value)


def test_mechanics_can_be_left_out_and_added(tag: Scenario) -> None:
    words = ["--without", "safe_zone", "--without", "heals", "--with", "DropLast(offset=2.0)", "--set", "n_boxes=4"]
    scenario = asked("ffa_3", *words, "--with", f"{EXAMPLES}/tag.py:Stamina(most=50)")
    plain = variant("ffa_3").without("safe_zone", "heals").replace(n_boxes=4)
    assert {*scenario.modules} == {*plain.modules, DropLast(offset=2.0), type(tag["stamina"])(most=50)}  # type: ignore[call-arg]
    assert mechanic("Stamina")[0] == type(tag["stamina"])()
    assert asked("ffa_3", "--with", "Teams").name == "ffa_3-with_teams"


def test_numbers_can_be_drawn_anew_in_every_episode() -> None:
    words = "--vary", "safe_zone_damage=uniform(1, 2)", "--vary", "n_heals=integers(2,8)"
    with pytest.raises(EngineError, match="safe_zone_damage"):
        asked("ffa_3", *words)
    words = "--vary", "rewards_kill=uniform(1, 2.5)", "--vary", "n_heals = choice(2, 8)", "--set", "melee_damage=7"
    varied = variant("ffa_3").replace(melee_damage=7)
    assert asked("ffa_3", *words) == varied.vary(
        rewards_kill=outlast.distributions.uniform(1, 2.5), n_heals=outlast.distributions.choice(2, 8)
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--with Teams --set teams_count=0", "for none, leave it out: --without teams"),
        ("--vary n_heals=choice(2,8) --set heals_count=3", "--vary heals_count: --set has it, too; use one of them"),
        ("--vary n_heals=choice(2,8) --vary heals_count=choice(1,3)", "heals_count is given twice; remove one of them"),
        ("--vary melee_damage", "--vary melee_damage: NUMBER=DRAWN is needed, as in --vary 'melee_damage=integers"),
        (
            "--vary melee_damage=integers(1,zone)",
            r"--vary melee_damage: integers\(1, 'zone'\): two integers are needed",
        ),
        ("--vary melee_damage=__import__('os').getpid()", "a distribution of literals is needed"),
        ("--vary melee_damage=normal(1,2)", r"--vary melee_damage: .* is not a distribution: uniform\(low, high\), "),
        ("--layout maze --without maze", "--layout maze: --with or --without takes it out again"),
        ("--with DropLast --without drop_last", "--with DropLast: --without takes it out again; use one of them"),
        ("--set melee_damage=20 --set melee_damage=30", "melee_damage is given twice; remove one of them"),
        ("--with Boxes(count=3) --set n_boxes=4", "--set boxes_count: --with has it, too; use one of them"),
        ("--with DropLast(offset=1.0,offset=2.0)", "numbers are given as in .*, each once"),
        ("--set room_size=20 --set room_width=30 --set room_height=30", "room.size = 20 has no effect beside"),
        ("--with DropLast(offse=2.0)", "there is no number offse; it has: offset"),
        ("--with json:loads", "json:loads is function"),
        ("--import nowhere.py", "there is no file nowhere.py"),
    ],
)
def test_options_that_cannot_be(words: str, message: str) -> None:
    option, _, text = words.partition(" ")
    given = text.split(" ") if " --" in text else [text]
    with pytest.raises((ScenarioError, EngineError), match=message):
        asked("ffa_2", option, *given)


def test_a_scenario_is_saved_by_any_command(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "mine.json"
    words = ["schedule", "ffa_1", "--set", "melee_damage=7", "--without", "heals", "--save-scenario", str(path)]
    for _ in range(2):
        assert main(words) == 0
    assert Scenario.load(path) == variant("ffa_1").without("heals").replace(melee_damage=7)
    assert main(["schedule", "ffa_2", "--save-scenario", str(path)]) == 2
    assert "exists, and holds something else" in capsys.readouterr().err
    assert Scenario.load(path).name == "ffa_1-without_heals-melee_damage=7"
    assert main(["schedule", str(path)]) == 0
    assert [file.name for file in tmp_path.iterdir()] == ["mine.json"]
    capsys.readouterr()
    for name, wrong in (("a.txt", "scenarios are written as NAME.json"), ("none/a.json", "there is no folder")):
        assert main([*words[:-1], str(tmp_path / name)]) == 2
        assert wrong in capsys.readouterr().err
