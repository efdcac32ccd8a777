"""Scripted styles: what each of them does in staged scenes and in whole games, and that they play every game."""

import itertools
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import columns_of
from outlast.envs.cli import main as cli
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.policies import POLICIES
from outlast.errors import UsageError
from outlast.systems import Behaviour, Boxes, Cameras, Heals, Lidar, Maze, SafeZone, Teams

STYLES = ("scripted", "camper", "hunter", "hoarder", "healer")
BACK, STILL, AHEAD, LEFT = 0, 1, 2, 2  # of motors


def scene(env: Any, **rows: list[dict[str, Any]]) -> dict[str, Any]:
    """What the one agent in the middle of a room observes that sees only these rows; the zone is around it."""
    seen = {key: np.zeros_like(array[:1, :1]) for key, array in env.reset(seed=0)[0].items()}
    zone = {"radius": 5.0, "next_radius": 4.0}
    for key, given in ({"own": [{"health": 100}], "zone": [zone]} | rows).items():
        for k, row in enumerate(given):
            for name, value in row.items():
                table = seen[key][0, 0] if key in ("own", "zone") else seen[key][0, 0, k]
                table[..., columns_of(env.fields[key], name)] = value
            if f"{key}_mask" in seen:
                seen[f"{key}_mask"][0, 0, k] = 1
    return seen


def decided(name: str, game: str, **rows: list[dict[str, Any]]) -> dict[str, int]:
    """What a style does there, by the name of the action."""
    env = outlast.make_vec(game, 1, seed=0)
    actions = POLICIES[name](env, 0)(scene(env, **rows))
    return dict(zip((key for key, _ in env.action_columns), actions[0, 0].tolist(), strict=True))


def enemy(x: float, y: float = 0.0) -> dict[str, Any]:
    return {"team": 1, "health": 100, "x": x, "y": y}


def mate(x: float, health: float) -> dict[str, Any]:
    return {"team": 0, "health": health, "x": x}


WEAK, HELD, BOX = [{"health": 20}], [{"amount": 75}], [{"vertices": 0.5}]
OUT = [{"health": 100, "x": 7.0}]  # metres: outside of the zone
SCENES: list[tuple[str, dict[str, Any], dict[str, int]]] = [
    ("scripted", {"others": [enemy(3)]}, {"ahead": AHEAD, "attack": 0}),
    ("camper", {"others": [enemy(3)]}, {"ahead": STILL, "left": STILL, "attack": 0, "use": 0}),
    ("camper", {"others": [enemy(2)]}, {"ahead": STILL, "attack": 1}),
    ("camper", {"heals": [{"x": 2.0}]}, {"ahead": AHEAD}),
    ("camper", {"heals": [{"x": 4.0}]}, {"ahead": STILL}),
    ("camper", {"boxes": [{"x": 4.0}]}, {"ahead": AHEAD, "attack": 1}),
    ("camper", {"boxes": [{"x": 1.0}]}, {"ahead": STILL, "attack": 0}),  # cover
    ("camper", {"boxes": [{"x": 4.0}], "box_slot": BOX}, {"ahead": STILL, "use": 0}),
    ("camper", {"others": [enemy(4)], "box_slot": BOX}, {"use": 1}),
    ("camper", {"others": [enemy(3, 3)], "box_slot": BOX}, {"use": 0}),  # not straight ahead
    ("hunter", {"others": [enemy(8)]}, {"ahead": AHEAD, "attack": 0}),
    ("hunter", {"others": [enemy(8)], "heals": [{"x": -2.0}]}, {"ahead": AHEAD}),
    ("hunter", {"others": [enemy(8)], "heals": [{"x": -2.0}], "own": WEAK}, {"ahead": BACK, "use": 0}),
    ("hunter", {"heal_slot": HELD, "own": [{"health": 60}]}, {"use": 0}),
    ("hunter", {"heal_slot": HELD, "own": WEAK}, {"use": 1}),
    ("hunter", {"others": [enemy(9)], "own": OUT}, {"ahead": AHEAD}),
    ("hunter", {"others": [enemy(9)], "own": [OUT[0] | WEAK[0]]}, {"ahead": BACK}),
    ("hoarder", {"others": [enemy(3)], "heals": [{"x": 6.0}]}, {"ahead": BACK, "attack": 0}),
    ("hoarder", {"others": [enemy(8)], "heals": [{"x": 6.0}]}, {"ahead": AHEAD}),
    ("hoarder", {"box_items": [{"y": 2.0}], "heals": [{"x": 6.0}]}, {"left": LEFT}),
    ("hoarder", {"heal_slot": HELD, "own": [{"health": 60}]}, {"use": 0}),
    ("hoarder", {"heal_slot": HELD, "own": WEAK}, {"use": 1}),
    ("hoarder", {"heal_slot": HELD, "heals": [{"x": 0.3}]}, {"use": 1}),  # it stays there: the bag is full
    ("healer", {"others": [mate(6, 100)]}, {"ahead": AHEAD, "give": 0}),
    ("healer", {"others": [mate(1.5, 50)], "heal_slot": HELD}, {"give": 1, "use": 0}),
    ("healer", {"others": [mate(1.5, 50)], "heal_slot": HELD, "own": WEAK}, {"give": 0, "use": 1}),
    ("healer", {"others": [mate(1.5, 100)], "heal_slot": HELD}, {"give": 0}),
    ("healer", {"others": [mate(1.5, 50)]}, {"give": 0}),
    ("healer", {"others": [enemy(1.5)], "heal_slot": HELD}, {"give": 0, "attack": 1}),
]


@pytest.mark.parametrize(("name", "rows", "expected"), SCENES)
def test_what_a_style_does_in_a_scene(name: str, rows: dict[str, Any], expected: dict[str, int]) -> None:
    found = decided(name, "teams_3", **rows)
    assert {key: found[key] for key in expected} == expected


def test_without_teams_a_healer_heals_itself_early_and_gives_to_nobody() -> None:
    found = decided("healer", "ffa_2", own=[{"health": 85}], others=[{"health": 50, "x": 1.5}], heal_slot=HELD)
    assert (found["use"], found["give"]) == (1, 0)


@pytest.mark.parametrize("name", STYLES)
def test_who_sees_nobody_turns_around(name: str) -> None:
    assert decided(name, "teams_3")["turn"] == LEFT


LIMIT, WORLDS = 500, 96  # LIMIT: ticks; hoarders play on for twice as many


@pytest.fixture(scope="module")
def descriptors() -> Any:
    """Statistics of a rollout in which all play alike, of each world and agent."""
    game = outlast.variant("teams_3").with_(Behaviour()).replace(ending_limit=LIMIT)
    return {name: outlast.rollout(game, name, worlds=WORLDS, seed=0, keep=True).arrays() for name in STYLES}


@pytest.mark.parametrize(
    ("name", "statistic", "factor"),
    [
        ("camper", "distance_travelled", 0.75),
        ("camper", "cells_visited", 0.75),
        ("camper", "boxes_between", 10),
        ("hunter", "length", 0.75),
        ("hunter", "heals_used", 0.6),
        ("hoarder", "deaths_melee", 0.1),
        ("hoarder", "heals_used", 0.5),
        ("healer", "heals_given", 10),
        ("healer", "mate_distance", 0.85),
    ],
)
@pytest.mark.nightly
def test_a_style_differs_from_the_script(descriptors: Any, name: str, statistic: str, factor: float) -> None:
    """In the same worlds, by that factor at least, and by five standard errors."""
    own, other = (descriptors[each][statistic].reshape(WORLDS, -1).mean(1) for each in (name, "scripted"))
    more = 1 if factor > 1 else -1
    assert more * (own.mean() - factor * other.mean()) > 0
    assert more * (own - other).mean() > 5 * (own - other).std() / np.sqrt(WORLDS)


def ablated_games() -> list[str]:
    """All variants, plain and with each ablation that would change something."""
    names = ["+".join(filter(None, pair)) for pair in itertools.product(outlast.VARIANTS, ("", *outlast.ABLATIONS))]
    return [name for name in names if not (name.startswith("ffa") and "team_share" in name)]


def other_games() -> list[outlast.Scenario]:
    hunt = outlast.variant("teams_3").with_(Teams(count=2, sizes=(1, 3)))
    return [
        outlast.variant("teams_3").without(Boxes, SafeZone),
        outlast.variant("ffa_3").without(Heals, Cameras),
        outlast.variant("ffa_3").without("inventory", "heals", "boxes", "give_last", "pickup", "death_drop"),
        outlast.variant("ffa_3+steering").with_(Maze(), Lidar()).vary(n_agents=outlast.integers(1, 4)),
        outlast.variant("teams_3").replace(cameras_mode="omniscient", n_agents=6),
        outlast.variant("teams_3").replace(cameras_mode="revealed"),
        hunt.roles(hunter=outlast.role(1, agents_health=300, motors_ahead=0.1), prey=outlast.role()),
    ]


@pytest.mark.parametrize("game", [*ablated_games(), *other_games()], ids=lambda game: getattr(game, "name", game))
@pytest.mark.by_day(8)
def test_styles_play_every_game(game: Any) -> None:
    env = outlast.make_vec(game, 3, seed=0)
    observations, _ = env.reset()
    for k, name in enumerate(STYLES * 8):
        act = POLICIES[name](env, 0)
        actions = act(observations)
        assert env.action_space.contains(actions.astype(env.action_space.dtype))
        few = {key: array[1:, -1:] for key, array in observations.items()}
        np.testing.assert_array_equal(act(few), actions[1:, -1:])  # whoever else is asked about
        if k > 0:
            np.testing.assert_array_equal(act({key: array[0] for key, array in observations.items()}), actions[0])
        observations = env.step(actions)[0]


def test_names_are_known_wherever_policies_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    names = ", ".join(POLICIES)
    assert set(STYLES) < set(POLICIES)
    assert parse_lineup("camper:2,healer") == {"camper": 2.0, "healer": 1.0}
    with pytest.raises(UsageError, match=f"kamper: did you mean camper.*{names} or a saved policy"):
        parse_lineup("kamper")
    for command in ("rollout", "frames", "train", "evaluate"):
        with pytest.raises(SystemExit):
            cli.main((command, "--help"))
        assert names in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("name", STYLES)
def test_makers_are_public(name: str) -> None:
    assert getattr(outlast, f"{name}_policy") is POLICIES[name]


def test_a_policy_of_another_game_is_refused() -> None:
    """Its numbers would be read from the wrong columns."""
    one, other = outlast.make_vec("ffa_3", 2, seed=0), outlast.make_vec("teams_3", 2, seed=0)
    with pytest.raises(UsageError, match="are of another game than ffa_3, for which this policy was made"):
        outlast.rollout(other, outlast.scripted_policy(one), steps=3)
    with pytest.raises(UsageError, match=r"as in scripted_policy\(env\), not for dict: give env.unwrapped"):
        outlast.rollout("ffa_3", outlast.scripted_policy, steps=3)
