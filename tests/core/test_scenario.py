"""Scenarios as data: the paper's eight variants, number by number, and what can be derived from them."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import VARIANTS, Scenario, make_vec, variant
from outlast.components import Bag, Body, Guard, Heal, Health, Hit, Item, Shape, Spawned
from outlast.components.health import hurt
from outlast.distributions import integers

from outlast.ecs import (  # isort: skip
    Action, Archetype, DeclarationError, Entity, Event, Module, NumberError, Observation, ScheduleError, Statistic,
    Worlds, column, number, ref,
)  # fmt: skip
from outlast.envs.cli.games import uses
from outlast.envs.cli.main import main
from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.variants import ALIASES
from outlast.systems import Boxes, DropLast, FreeForAll, Melee, Teams
from tests.conftest import draw_actions, nightly_compiled
from tests.helpers.mechanics import DUEL, mechanic

HERE = Path(__file__).parents[1]


# A number of the original's files: the number that stands for it here, and how to get the one from the other.
MEANING: dict[str, Any] = {
    "reward_scheme.r_alive": ("rewards_alive", float),
    "reward_scheme.r_dead": ("rewards_dead", float),
    "reward_scheme.r_kill": ("rewards_kill", float),
    "reward_scheme.r_death": ("rewards_death", float),
    "gameover.mode": ("ending_rule", {"alldead": "all dead", "lastalive": "last alive"}.get),
    "safe_zone.phases": ("safe_zone_radii", lambda phases: (12.5, 10, 7.5, 5, 4, 2, 1, 0)[: phases - 1]),
    "safe_zone.cooldown": ("safe_zone_stand", int),
    "safe_zone.damage": ("safe_zone_damage", int),
    "safe_zone.radiuses": ("safe_zone_radii", tuple),
    "safe_zone.centers": ("safe_zone_centres", str),
    "spawn_grid.grid_size": ("spawn_grid_cells", int),
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
    scenario = variant(original)
    config = dict(leaves(json.loads((HERE / "data" / "variants" / f"{original}.json").read_text())))
    has_boxes = config["boxes.reset_spawns.n_boxes"] > 0
    assert (Boxes in scenario) == has_boxes
    assert (Teams in scenario, FreeForAll in scenario) == (config["teams.twoteams"], not config["teams.twoteams"])
    assert config.pop("observation.omniscent") is False
    numbers = scenario.numbers()
    assert numbers["cameras_mode"] == "masked"
    assert numbers.get("teams_count", 2) == 2
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
        "motors_turn": 0.0125, "inventory_slots": 4, "pickup_reach": 0.5, "give_last_reach": 2,
        "death_drop_radius": 0.5, "melee_cooldown": 0,
        "physics_rate": 60, "physics_substeps": 2, "physics_velocity_iterations": 10, "physics_position_iterations": 10,
        "physics_friction": 0.2, "physics_restitution": 0, "physics_linear_damping": 0.8,
        "physics_angular_damping": 0.8, "room_thickness": 0.01, "safe_zone_shrink": 100, "ending_limit": 0,
    }  # fmt: skip
    assert {key: numbers[key] for key in expected} == expected
    # Section 6: where the code differs from the paper, the variants follow the code.
    choices = {
        "motors_give": "at once", "melee_blocked": True, "pickup_touch": False, "give_last_nearest": "any",
        "give_last_passes_on": True, "death_drop_scatter": "rim", "cameras_cone": "kite", "cameras_items_occlude": True,
        "rewards_posthumous": name.startswith("teams"),
    }  # fmt: skip
    if Boxes in variant(name):
        choices |= {"boxes_settles": True, "boxes_corners": "rolled"}
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


@pytest.mark.parametrize("given", [Melee, "melee", None])
def test_what_is_no_mechanic_is_refused(given: Any) -> None:
    for make in (lambda: variant("ffa_1").with_(given), lambda: Scenario("ffa_1", (Melee(), given))):
        with pytest.raises(ScenarioError, match=r"ffa_1: .*elee.* is not a mechanic: pass an|None is not a mechanic"):
            make()


BOX_KEYS = {"boxes", "boxes_mask", "box_items", "box_items_mask", "box_slot", "box_slot_mask"}
HEAL_KEYS = {"heals", "heals_mask", "heal_slot", "heal_slot_mask"}
ALL = [3, 3, 3, 2, 2, 2]
LEFT_OUT: dict[tuple[str, ...], tuple[set[str], list[int]]] = {  # modules: (keys that go with them, actions that stay)
    ("boxes",): (BOX_KEYS, ALL),
    ("cameras",): (set(), ALL),
    ("death_drop",): (set(), ALL),
    ("give_last",): (set(), [3, 3, 3, 2, 2]),
    ("heals",): (HEAL_KEYS, ALL),
    ("mortality",): (set(), ALL),
    ("melee",): (set(), [3, 3, 3, 2, 2]),
    ("motors",): (set(), [2, 2, 2]),
    ("physics",): (set(), ALL),
    ("pickup",): (set(), ALL),
    ("record",): (set(), ALL),
    ("spawn_grid",): (set(), ALL),
    ("safe_zone",): ({"zone"}, ALL),
    ("heals", "boxes"): (BOX_KEYS | HEAL_KEYS, ALL),  # what deals with items has nothing to do
    ("inventory", "give_last", "pickup", "death_drop"): (set(), [3, 3, 3, 2]),
    ("room", "spawn_grid", "safe_zone"): ({"zone"}, ALL),
    ("inventory", "give_last", "pickup", "death_drop", "heals", "boxes", "melee", "safe_zone", "cameras"): (
        BOX_KEYS | HEAL_KEYS | {"zone"}, [3, 3, 3],
    ),
}  # fmt: skip
NEEDED = {  # the error without each of them
    ("agents",): (DeclarationError, "extend the archetype 'agent', but none declares how many .*add Agents"),
    ("ending",): (ScheduleError, "needs Score .*add .*Ending, or leave (record|rewards) out"),
    ("rewards",): (ScheduleError, "record.note needs Reward .*add .*Rewards.*, or leave record out"),
    ("inventory",): (ScheduleError, "needs Bag .*add .*Inventory, or leave (give_last|pickup|death_drop) out"),
    ("room",): (ScheduleError, "needs Floor .*add .*Room, or leave (spawn_grid|safe_zone) out"),
    ("teams",): (DeclarationError, "the dimension 'sides'.* Kills.kills needs it: add FreeForAll or Teams"),
}


def derived(names: tuple[str, ...]) -> Scenario:
    return variant("teams_3").without(*names)


def test_every_module_is_left_out_once() -> None:
    one = {names[0] for names in [*LEFT_OUT, *NEEDED] if len(names) == 1}
    assert one == {module.name for module in variant("teams_3").modules}


@pytest.mark.parametrize("names", LEFT_OUT, ids="-".join)
def test_what_is_left_out_takes_only_its_own_keys_away(names: tuple[str, ...]) -> None:
    keys, sizes = LEFT_OUT[names]
    full, rest = make_vec("teams_3", 1), make_vec(derived(names), 1)
    assert set(full.single_observation_space) - set(rest.single_observation_space) == keys
    assert rest.single_action_space.nvec.tolist() == [sizes] * 4
    assert rest.single_observation_space["own"].shape == (4, 9 - ("mortality" in names))  # no health


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


def test_the_schedule_is_the_golden_one() -> None:
    """To take a new one: python -m outlast schedule teams_3 > tests/golden/schedule.txt"""
    printed = str(Worlds(variant("teams_3").modules, 1).schedule).replace(
        "(python)", ""
    )  # uncompiled, Box2D is called by one
    golden = (HERE / "golden" / "schedule.txt").read_text()
    assert [line.rstrip() for line in printed.splitlines()] == golden.splitlines()


@pytest.mark.parametrize("name", ["ffa_1", "teams_4", "teams_4+steering"])
def test_the_table_of_components_agrees_with_the_schedule(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    worlds = Worlds(variant(name).modules, 1)
    rows = {component.__name__: uses(worlds, component) for component in worlds.components}
    written = [(name, label) for name, (_, writers, _) in rows.items() for label in writers]
    given = {(component, label.removesuffix(" (adds)"), "(adds)" in label) for component, label in written}
    declared = {
        (component.__name__, system.label, parameter.kind)
        for system in worlds.schedule.systems
        for parameter in system.parameters
        for component in parameter.components
    }
    assert given == {(name, label, kind == "add") for name, label, kind in declared if kind in ("write", "add")}
    read = {(name, label) for name, (*_, readers) in rows.items() for label in readers}
    assert read == {(name, label) for name, label, kind in declared if kind == "read"}
    assert main(["schedule", name, "--components"]) == 0
    printed = capsys.readouterr().out
    assert all(word in printed for name, (_, *users) in rows.items() for word in (name, *users[0], *users[1]))


def test_two_mechanics_of_one_name_are_refused() -> None:
    namesake = type("Melee", (Module,), {})
    with pytest.raises(ScenarioError, match=r"'melee' is a name of both outlast\.systems\.melee\.Melee and .*Melee"):
        variant("ffa_1").with_(namesake())
    renamed = type("Melee", (Module,), {"name": "claws"})
    assert variant("ffa_1").with_(renamed()).without("melee")["claws"] == renamed()
    with pytest.raises(ScenarioError, match="'room_size' is a name of both"):
        variant("ffa_1").with_(type("Drop", (Module,), {"name": "room_size"})())


def test_scenarios_of_the_same_mechanics_are_equal_in_any_order() -> None:
    duel = variant("ffa_3")
    assert duel.with_(duel["melee"]) == duel
    assert Scenario("ffa_3", duel.modules[::-1], duel.about) == duel
    assert Scenario("ffa_3", iter(duel.modules), duel.about) == duel
    one, other = (duel.without("melee", "boxes").with_(*each) for each in ((Melee(), Boxes()), (Boxes(), Melee())))
    assert one == other
    assert one.name == other.name
    assert one.to_json() == other.to_json()


@pytest.mark.parametrize(
    ("base", "name", "made", "words"),
    [
        (Observation, "depth", column("f4", 8), "Mine.depth: .*'depth' has the dimensions .*first one is \"agents\""),
        (Observation, "mood", column("f4", "agents"), r'a number for each agent; .* column\("f4", "agents", 1\)'),
        (Observation, "zone", column("f4", "agents", 3), "Mine.zone and .*ZoneView.zone|ZoneView.zone and .*Mine.zone"),
        (Observation, "image", column("f4", "agents", 2), r"no system writes the observation Mine.image.*"),
        (Statistic, "deaths_zone", column("i4"), "two entries of info are called 'deaths_zone'"),
        (Statistic, "alive", column("i4"), "two entries of info are called 'alive'"),
        (Statistic, "melee_damage", column("i4"), "two entries of info are called 'melee_damage'"),
        (Statistic, "world", column("i4"), "the statistic 'world' is in tables and logs already; rename it"),
        (Statistic, "gold", column("i4", key="gold_1"), "'gold_1' ends in a digit, which marks sides in these"),
        (Statistic, "laps", column("i4", "agents"), r"no system writes the statistic Mine.laps, .* Write\[Mine\]"),
        (Action, "attack", column("i1", "agents", low=0, high=1), "are both the action 'attack'"),
        (Action, "jump", column("i1", "agents", low=0, high=1), r"no system reads the action Mine.jump, "),
        (Event, "loud", column("u1"), r"no system emits the event Mine, so it would never happen; .* Write\[Mine\]"),
    ],
)
def test_what_would_be_hidden_or_belong_to_nobody_is_refused(base: Any, name: str, made: Any, words: str) -> None:
    component = type("Mine", (base,), {name: made}, **({"capacity": 1} if base is Event else {}))
    with pytest.raises(DeclarationError, match=words):
        make_vec(DUEL.vary(melee_damage=integers(5, 9)).with_(mechanic("Brings", singletons=[component()])), 1)


@dataclasses.dataclass(frozen=True)
class Apples(Module):
    """Another item that heals, whose rows lie between those of boxes and of box items."""

    count: int = number(2, low=1)

    def archetypes(self) -> Any:
        parts = (Body(), Shape(radius=0.25), Spawned(), Item())
        return [Archetype("apple", (*parts, Heal(amount=10)), ref("count"), order=25)]

    def dims(self) -> dict[str, int | str]:
        return {"heals": ref("count")}


def test_a_second_kind_of_item_is_none_of_the_first() -> None:
    """Held, a box item is no heal, though rows of heals lie on both sides of its own; an apple is one."""
    env = make_vec(variant("ffa_3").with_(Apples()), 1, seed=0)
    env.reset()
    rows = {item: env.worlds.span(item).start for item in ("apple", "box_item", "heal")}
    assert rows["apple"] < rows["box_item"] < rows["heal"]
    bag, alive = env.worlds[Bag], env.worlds[Entity].alive
    for item, slots in (("box_item", (0, 1)), ("apple", (1, 0)), ("heal", (1, 0))):
        bag.items[0, 0, 0], bag.count[0, 0] = rows[item], 1
        alive[0, rows[item]] = 0
        seen, *_ = env.step(np.array([[[1, 1, 1, 0, 0, 0]] * 2]))
        assert (int(seen["heal_slot_mask"][0, 0, 0]), int(seen["box_slot_mask"][0, 0, 0])) == slots, item
        assert seen["heal_slot"][0, 0, 0, 0] == {"box_item": 0, "apple": 10, "heal": 75}[item]


def test_hit_points_stay_what_they_are_however_hard_the_blows() -> None:
    """They are 32-bit integers: numbers are limited, and what hurts ends at the largest."""
    with pytest.raises(NumberError, match=r"agents.health = 2147483647: must be .*<= 1e"):
        variant("ffa_3").replace(agents_health=2**31 - 1)
    most = variant("ffa_1").replace(n_heals=2147, heals_amount=1_000_000, agents_health=483_647, spawn_grid_cells=60)
    make_vec(most, 1)
    with pytest.raises(NumberError, match=r"count = 2147 times heals.amount = 1000000 is more than the 2147483647"):
        make_vec(most.replace(agents_health=483_648), 1)
    health = Health.Table(*(np.zeros(1, column.dtype) for column in Health.columns.values()))
    guard = Guard.Table(np.full(1, -1), np.full(1, -1))
    least, most = 1 - 2**31, 2**31 - 1
    for points, amount, left in ((least + 4, 100, least), (most - 5, -100, most), (100, most, 100 - most)):
        health.points[0] = points
        hits = Hit.Table(*(np.zeros(1, column.dtype) for column in Hit.columns.values()))
        assert hurt(health, guard, hits, 0, amount, 0, -1, 1)
        assert int(health.points[0]) == left


def test_counts_can_be_zero() -> None:
    scenario = variant("teams_3").replace(n_boxes=0, n_heals=0)
    assert outlast.check(scenario) == []
    observations, _ = make_vec(scenario, 2, seed=0).reset()
    assert observations["boxes"].shape[2] == observations["heals"].shape[2] == 0
    env = make_vec(scenario.vary(n_boxes=integers(0, 2), n_heals=integers(0, 2)), 64, seed=0)
    env.reset()
    for thing, name in (("box", "boxes_count"), ("heal", "heals_count")):
        drawn = env.numbers()[name]
        assert {*drawn} == {0, 1, 2}
        assert (env.worlds[Entity].alive[:, env.worlds.span(thing)].sum(1) == drawn).all()
    assert outlast.check(env.scenario) == []
