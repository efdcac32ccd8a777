"""Scenarios as data: the paper's eight variants, number by number, and what can be derived from them."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import ALIASES, VARIANTS, Scenario, make_vec, variant
from outlast.ecs import DeclarationError, ScheduleError, Worlds
from outlast.envs.spaces import action_space, observation_space
from outlast.systems import AutoPickup, Boxes, DropLast, FreeForAll, Melee, Teams
from tests.conftest import draw_actions, nightly_compiled

HERE = Path(__file__).parent


# ---- the eight variants (tests/data/variants: the original's own configurations)

# A number of the original's files: the number that stands for it here, and how to get the one from the other.
MEANING: dict[str, Any] = {
    "reward_scheme.r_alive": ("rewards_alive", float),
    "reward_scheme.r_dead": ("rewards_dead", float),
    "reward_scheme.r_kill": ("rewards_kill", float),
    "reward_scheme.r_death": ("rewards_death", float),
    "gameover.mode": ("ending_rule", {"alldead": "all dead", "lastalive": "last alive"}.get),
    "safe_zone.phases": ("zone_radii", lambda phases: (12.5, 10, 7.5, 5, 4, 2, 1, 0)[: phases - 1]),
    "safe_zone.cooldown": ("zone_stand", int),
    "safe_zone.damage": ("zone_harm", int),
    "safe_zone.radiuses": ("zone_radii", tuple),
    "safe_zone.centers": ("zone_centres", str),
    "spawn_grid.grid_size": ("spawn_cells", int),
    "spawn_grid.floor_size": ("room_size", float),
    "agents.n_agents": ("agents_count", int),
    "agents.agent_size": ("agents_radius", lambda size: size / 2),
    "health.health": ("agents_health", int),
    "melee.range": ("melee_reach", float),
    "melee.damage": ("melee_damage", int),
    "heals.reset_spawns.n_items": ("heals_count", int),
    "heals.reset_spawns.item_size": ("heals_radius", lambda size: size / 2),
    "heals.heal.healing": ("heals_amount", int),
    "boxes.reset_spawns.n_boxes": ("boxes_count", int),
    "boxes.ownership": ("boxes_owned", bool),
    "boxes.randomized_shape.avg_w": ("boxes_width", float),
    "boxes.randomized_shape.std_w": ("boxes_width_deviation", float),
    "boxes.randomized_shape.avg_h": ("boxes_height", float),
    "boxes.randomized_shape.std_h": ("boxes_height_deviation", float),
    "boxes.item.item_size": ("boxes_item_radius", lambda size: size / 2),
    "boxes.item.offset": ("boxes_offset", float),
    "boxes.health": ("boxes_toughness", int),
}
WITHOUT_MEANING = {
    "rng.seed": 42,  # the original ignores it
    "boxes.reset_spawns.box_size": 1,  # shapes are random
    "melee.drift": True,  # forces, not set velocities: the only kind of motors here
}


def leaves(tree: dict[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}{key}.")
        else:
            yield path + key, value


@pytest.mark.parametrize("original", ALIASES)
def test_variants_have_the_numbers_of_the_original(original: str) -> None:
    """Every one in its file, none left out."""
    scenario = variant(original)
    config = dict(leaves(json.loads((HERE / "data" / "variants" / f"{original}.json").read_text())))
    has_boxes = config["boxes.reset_spawns.n_boxes"] > 0
    assert (Boxes in scenario) == has_boxes
    assert (Teams in scenario, FreeForAll in scenario) == (config["teams.twoteams"], not config["teams.twoteams"])
    assert config.pop("observation.omniscent") is False
    numbers = scenario.numbers()
    assert numbers["cameras_mode"] == "masked"
    assert numbers.get("sides_count", 2) == 2
    del config["teams.twoteams"]
    for key, value in config.items():
        if key in WITHOUT_MEANING:
            assert WITHOUT_MEANING[key] == value
        elif has_boxes or not key.startswith("boxes."):
            name, convert = MEANING[key]
            assert numbers[name] == convert(value), key


@pytest.mark.parametrize("name", VARIANTS)
def test_variants_have_what_the_files_leave_to_defaults(name: str) -> None:
    """Reference rules, section 0 (inherited from the class default) and section 1."""
    numbers = variant(name).numbers()
    expected = {
        "cameras_fov": 0.4 * np.pi, "cameras_depth": 10, "motors_ahead": 0.25, "motors_left": 0.25,
        "motors_turn": 0.0125, "inventory_slots": 4, "pickup_reach": 0.5, "give_reach": 2, "drop_radius": 0.5,
        "melee_cooldown": 0,
        "physics_rate": 60, "physics_substeps": 2, "physics_velocity_iterations": 10, "physics_position_iterations": 10,
        "physics_density": 1, "physics_friction": 0.2, "physics_restitution": 0, "physics_linear_damping": 0.8,
        "physics_angular_damping": 0.8, "room_thickness": 0.01, "zone_shrink": 100, "ending_limit": 0,
    }  # fmt: skip
    assert {key: numbers[key] for key in expected} == expected
    # Section 6: where the code differs from the paper, the variants follow the code.
    choices = {
        "motors_give": "at once", "melee_blocked": True, "pickup_touch": False, "give_nearest": "any",
        "drop_scatter": "rim", "cameras_cone": "kite", "cameras_items_occlude": True,
        "rewards_posthumous": name.startswith("teams"),
    }  # fmt: skip
    assert {key: numbers[key] for key in choices} == choices
    assert DropLast not in variant(name)
    assert not numbers.get("boxes_dynamic", False)


def test_aliases_are_the_originals_names() -> None:
    assert sorted(ALIASES) == sorted(path.stem for path in (HERE / "data" / "variants").glob("*.json"))
    assert len(ALIASES) == 8
    assert sorted(ALIASES.values()) == sorted(VARIANTS)
    for alias, name in ALIASES.items():
        assert variant(alias) is variant(name) is VARIANTS[name]
        assert variant(name).name == name
        assert variant(name).about


# ---- deriving


def test_without_takes_mechanics_away() -> None:
    """By class or by name; the original stays as it is."""
    scenario = variant("teams_3")
    less = scenario.without(Melee, "boxes")
    assert (Melee in less, "boxes" in less, Melee in scenario, Boxes in scenario) == (False, False, True, True)
    assert len(less.modules) == len(scenario.modules) - 2
    assert scenario.without() == scenario
    assert FreeForAll in scenario.without(Teams)  # there is always a rule for sides


def test_with_adds_or_replaces() -> None:
    scenario = variant("ffa_3")
    assert scenario.with_(Melee(damage=20))[Melee] == Melee(damage=20)
    assert len(scenario.with_(Melee(damage=20)).modules) == len(scenario.modules)
    assert DropLast in scenario.with_(DropLast())
    teams = scenario.with_(Teams(count=2))
    assert (Teams in teams, FreeForAll in teams) == (True, False)
    assert teams.with_(FreeForAll()).numbers() == scenario.numbers()


def test_replace_changes_numbers_only() -> None:
    scenario = variant("teams_3")
    changed = scenario.replace(n_agents=10, melee_damage=20, zone_radii=[3, 2])
    expected = scenario.numbers() | {"agents_count": 10, "melee_damage": 20, "zone_radii": (3.0, 2.0)}
    assert changed.numbers() == expected
    assert scenario.numbers()["agents_count"] == 4
    assert scenario.replace(**scenario.numbers()) == scenario  # numbers() is what replace() takes
    assert scenario.replace(n_heals=3, n_boxes=2).numbers()["heals_count"] == 3


def test_scenarios_cannot_be_changed_in_place() -> None:
    scenario = variant("ffa_1")
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.name = "mine"  # type: ignore[misc]
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario["melee"].damage = 9000  # type: ignore[attr-defined]


# ---- leaving mechanics out of teams_3

BOX_KEYS = {"boxes", "boxes_mask", "box_items", "box_items_mask", "box_slot", "box_slot_mask"}
HEAL_KEYS = {"heals", "heals_mask", "heal_slot", "heal_slot_mask"}
ALL = [3, 3, 3, 2, 2, 2]
LEFT_OUT: dict[tuple[str, ...], tuple[set[str], list[int]]] = {  # modules: (keys that go with them, actions that stay)
    ("boxes",): (BOX_KEYS, ALL),
    ("cameras",): (set(), ALL),
    ("drop",): (set(), ALL),
    ("give",): (set(), [3, 3, 3, 2, 2]),
    ("heals",): (HEAL_KEYS, ALL),
    ("health",): (set(), ALL),
    ("melee",): (set(), [3, 3, 3, 2, 2]),
    ("motors",): (set(), [2, 2, 2]),
    ("physics",): (set(), ALL),
    ("pickup",): (set(), ALL),
    ("record",): (set(), ALL),
    ("sides",): (set(), ALL),
    ("spawn",): (set(), ALL),
    ("zone",): ({"zone"}, ALL),
    ("heals", "boxes"): (BOX_KEYS | HEAL_KEYS, ALL),  # what deals with items is dormant
    ("inventory", "give", "pickup", "drop"): (set(), [3, 3, 3, 2]),
    ("room", "spawn", "zone"): ({"zone"}, ALL),
    ("inventory", "give", "pickup", "drop", "heals", "boxes", "melee", "zone", "cameras"): (
        BOX_KEYS | HEAL_KEYS | {"zone"}, [3, 3, 3],
    ),
}  # fmt: skip
NEEDED = {  # by whom
    ("agents",): (DeclarationError, "extend the archetype 'agent', but none declares how many"),
    ("ending",): (ScheduleError, "needs Score .*leave (record|rewards) out"),
    ("rewards",): (ScheduleError, "record.note needs Reward .*leave record out"),
    ("inventory",): (ScheduleError, "needs Bag .*leave (give|pickup|drop) out"),
    ("room",): (ScheduleError, "needs Floor .*leave (spawn|zone) out"),
}


def derived(names: tuple[str, ...]) -> Scenario:
    return variant("teams_3").without(*names)


def test_every_module_is_left_out_once() -> None:
    one = {names[0] for names in [*LEFT_OUT, *NEEDED] if len(names) == 1}
    assert one == {module.name() for module in variant("teams_3").modules}


@pytest.mark.parametrize("names", LEFT_OUT, ids="-".join)
def test_what_is_left_out_takes_only_its_own_keys_away(names: tuple[str, ...]) -> None:
    keys, sizes = LEFT_OUT[names]
    full, rest = (Worlds(scenario.modules, 1) for scenario in (variant("teams_3"), derived(names)))
    assert set(observation_space(full)) - set(observation_space(rest)) == keys
    assert action_space(rest).nvec.tolist() == [sizes] * 4
    assert observation_space(rest)["self"].shape == (4, 8 if "sides" in names else 9)


@pytest.mark.parametrize("names", LEFT_OUT, ids="-".join)
@nightly_compiled  # 20 s for each
def test_what_is_left_runs(names: tuple[str, ...]) -> None:
    env = make_vec(derived(names), 3, seed=0)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(40):
        observations, reward, *_ = env.step(draw_actions(env, rng))
        assert env.observation_space.contains(observations)
        assert all(np.isfinite(values).all() for values in observations.values())
        assert np.isfinite(reward).all()


@pytest.mark.parametrize("names", NEEDED, ids="-".join)
def test_modules_that_others_need_cannot_be_left_out_alone(names: tuple[str, ...]) -> None:
    error, words = NEEDED[names]
    with pytest.raises(error, match=words):
        make_vec(derived(names), 1)


def test_an_extra_module_adds_its_action() -> None:
    assert AutoPickup in variant("teams_3")
    worlds = Worlds(variant("teams_3").with_(DropLast()).modules, 1)
    assert action_space(worlds).nvec.tolist() == [[3, 3, 3, 2, 2, 2, 2]] * 4


# ---- the tick


def test_the_schedule_is_the_golden_one() -> None:
    """To take a new one: python -m outlast schedule teams_3 > tests/golden/schedule.txt"""
    printed = str(Worlds(variant("teams_3").modules, 1).schedule).replace(
        "(python)", ""
    )  # uncompiled, Box2D is called by one
    golden = (HERE / "golden" / "schedule.txt").read_text()
    assert [line.rstrip() for line in printed.splitlines()] == golden.splitlines()
