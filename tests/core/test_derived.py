"""Derived scenarios say what was changed, and numbers that depend on the room change with it."""

import copy
import dataclasses
import pickle

import pytest

from outlast import Scenario, role, variant
from outlast.distributions import choice, integers, log_uniform, uniform
from outlast.envs.scenarios.fingerprint import classes, difference, fingerprint, rebuilt
from outlast.systems import DropLast

DUEL, AHEAD = variant("ffa_3"), uniform(0.1, 1)
TEN = "ffa_3-without_boxes-n_agents=10-melee_damage=20"


@pytest.mark.parametrize(
    ("derived", "name"),
    [
        (DUEL, "ffa_3"),
        (DUEL.without("boxes").replace(n_agents=10, melee_damage=20), TEN),
        (DUEL.replace(n_agents=10, melee_damage=20).without("boxes"), TEN),
        (DUEL.with_(DropLast(offset=2.0)), "ffa_3-with_drop_last-drop_last_offset=2"),
        (DUEL.replace(ending_rule="all dead", room_walls=False), "ffa_3-ending_rule=all_dead-room_walls=False"),
        (variant("ffa_3+steering").replace(steering_speed=2.5), "ffa_3+steering-steering_speed=2.5"),
        (dataclasses.replace(DUEL.replace(n_agents=3), name="mine").replace(heals_amount=1), "mine-heals_amount=1"),
        (DUEL.vary(n_agents=integers(2, 6), melee_damage=integers(5, 20)), "ffa_3-n_agents=2..6-melee_damage=5..20"),
        (DUEL.vary(motors_ahead=AHEAD).observe_numbers(), "ffa_3-motors_ahead=0.1..1.0-observed_motors_ahead"),
        (DUEL.replace(n_agents=6).vary(n_agents=integers(2, 6)), "ffa_3-n_agents=2..6"),
        (DUEL.vary(motors_ahead=log_uniform(0.1, 1)), "ffa_3-motors_ahead=log_0.1..1.0"),
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


def test_what_is_drawn_from_otherwise_has_another_name() -> None:
    ends = [(1, 2), (1, 3), (2, 3)]
    drawn = [kind(*pair) for kind in (uniform, log_uniform, integers, choice) for pair in ends] + [choice(1, 1, 2)]
    names = [DUEL.vary(melee_reach=each).name for each in drawn]
    names += [DUEL.roles(a=role(1, melee_reach=each), b=role(1)).name for each in (*drawn, 1, 2)]
    names += [DUEL.roles(a=role(agents=(i,), melee_reach=1), b=role()).name for i in range(2)]
    both = DUEL.vary(melee_reach=uniform(1, 2), n_heals=integers(1, 2))
    names += [both.name, *(both.observe_numbers(each).name for each in ("melee_reach", "n_heals"))]
    assert len({*names}) == len(names)


def test_files_identify_a_derived_scenario_as_before() -> None:
    derived = fingerprint(DUEL.replace(melee_damage=20))
    assert (derived["name"], derived["label"]) == ("ffa_3", "ffa_3-melee_damage=20")
    before = {key: value for key, value in derived.items() if key != "label"}
    assert not difference(before, derived)
    assert fingerprint(DUEL.replace(cameras_mode="revealed").titled_as(DUEL)).keys() == {"name", "numbers"}
