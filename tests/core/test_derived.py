"""Derived scenarios say what was changed, and numbers that depend on the room change with it."""

import copy
import dataclasses
import pickle

import pytest

from outlast import Scenario, role, variant
from outlast.distributions import choice, integers, log_uniform, uniform
from outlast.ecs import Module, number
from outlast.envs.errors import ScenarioError
from outlast.envs.scenarios.fingerprint import classes, difference, fingerprint, rebuilt
from outlast.systems import DropLast, Teams

DUEL = variant("ffa_3")


@pytest.mark.parametrize(
    ("derived", "name"),
    [
        (DUEL, "ffa_3"),
        (
            DUEL.without("boxes").replace(n_agents=10, melee_damage=20),
            "ffa_3-without_boxes-n_agents=10-melee_damage=20",
        ),
        (
            DUEL.replace(n_agents=10, melee_damage=20).without("boxes"),
            "ffa_3-without_boxes-n_agents=10-melee_damage=20",
        ),
        (DUEL.with_(DropLast(offset=2.0)), "ffa_3-with_drop_last-drop_last_offset=2"),
        (DUEL.with_(Teams()), "ffa_3-with_teams"),
        (DUEL.replace(melee_damage=20).replace(melee_damage=5), "ffa_3"),
        (DUEL.replace(ending_rule="all dead", room_walls=False), "ffa_3-ending_rule=all_dead-room_walls=False"),
        (DUEL.ordered("heals", "melee"), "ffa_3-ordered_heals_melee"),
        (DUEL.replace(room_size=20.0), "ffa_3-room_size=20"),
        (variant("ffa_3+steering").replace(steering_speed=2.5), "ffa_3+steering-steering_speed=2.5"),
        (dataclasses.replace(DUEL.replace(n_agents=3), name="mine").replace(heals_amount=1), "mine-heals_amount=1"),
        (DUEL.vary(n_agents=integers(2, 6), melee_damage=integers(5, 20)), "ffa_3-n_agents=2..6-melee_damage=5..20"),
        (
            DUEL.vary(motors_ahead=uniform(0.1, 1)).observe_numbers(),
            "ffa_3-motors_ahead=0.1..1.0-observed_motors_ahead",
        ),
        (DUEL.replace(n_agents=6).vary(n_agents=integers(2, 6)), "ffa_3-n_agents=2..6"),
        (DUEL.vary(motors_ahead=log_uniform(0.1, 1)), "ffa_3-motors_ahead=log_0.1..1.0"),
        (DUEL.vary(melee_blocked=choice(True, False)), "ffa_3-melee_blocked=True_or_False"),
        (DUEL.roles(a=role(1, melee_damage=integers(1, 2)), b=role(1)), "ffa_3-roles_1_a_and_1_b_a_melee_damage=1..2"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_names_say_what_was_changed(derived: Scenario, name: str) -> None:
    assert derived.name == derived.file_name == name
    assert pickle.loads(pickle.dumps(derived)) == copy.deepcopy(derived) == derived
    again = rebuilt(fingerprint(derived), classes(derived))
    assert again.name == name
    assert not difference(fingerprint(derived), fingerprint(again))


def test_the_sentence_says_it_too() -> None:
    assert variant("teams_3").replace(n_agents=6).without("heals").about == (
        "two teams of two, heals and boxes; outliving pays; changed: without heals, n_agents=6"
    )
    assert dataclasses.replace(DUEL, about="").replace(n_agents=3).about == "changed: n_agents=3"


def test_many_changes_have_a_short_name_that_no_others_have() -> None:
    many = {"agents_health": 3, "give_last_reach": 1.5, "rewards_kill": 1e-3, "cameras_mode": "revealed"}
    names = {DUEL.replace(**many, melee_damage=damage).name for damage in range(50)}
    assert len(names) == 50
    assert max(map(len, names)) <= len("ffa_3") + 60


def test_what_is_drawn_from_otherwise_has_another_name() -> None:
    """Also numbers of roles, who has them, and what is observed."""
    ends = [(1, 2), (1, 3), (2, 3)]
    drawn = [kind(*pair) for kind in (uniform, log_uniform, integers, choice) for pair in ends] + [choice(1, 1, 2)]
    names = [DUEL.vary(melee_reach=each).name for each in drawn]
    names += [DUEL.roles(a=role(1, melee_reach=each), b=role(1)).name for each in (*drawn, 1, 2)]
    names += [DUEL.roles(a=role(agents=(i,), melee_reach=1), b=role()).name for i in range(2)]
    both = DUEL.vary(melee_reach=uniform(1, 2), n_heals=integers(1, 2))
    names += [both.name, *(both.observe_numbers(each).name for each in ("melee_reach", "n_heals"))]
    assert len({*names}) == len(names)


def test_names_of_files_have_no_other_characters() -> None:
    named = [dataclasses.replace(DUEL, name=name).file_name for name in ("../a b/c:é", "..", "")]
    assert named == ["_a_b_c_é", "scenario", "scenario"]


def test_files_identify_a_derived_scenario_as_before() -> None:
    """By the name of what it was derived from, and its numbers: so did all versions."""
    derived = fingerprint(DUEL.replace(melee_damage=20))
    assert (derived["name"], derived["label"]) == ("ffa_3", "ffa_3-melee_damage=20")
    before = {key: value for key, value in derived.items() if key != "label"}
    assert not difference(before, derived)
    assert fingerprint(DUEL.replace(cameras_mode="revealed").titled_as(DUEL)).keys() == {"name", "numbers"}


@dataclasses.dataclass(frozen=True)
class Misspelt(Module):
    good: float = number(5.0, scales_with="rom_size")


def test_a_number_scales_with_one_that_there_is() -> None:
    with pytest.raises(ScenarioError, match=r"misspelt_good scales with 'rom_size', .*; did you mean room_size\?"):
        DUEL.with_(Misspelt())
