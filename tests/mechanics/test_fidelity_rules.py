"""What was measured on the authors' own implementation ([M] in the reference rules): fights, boxes, zone and pay."""

import math
from itertools import pairwise

import pytest

from outlast.components import HealsUsed
from outlast.ecs import Entity
from tests.conftest import COMPILED
from tests.helpers.scenario_builder import ScenarioBuilder, duel, mates

OUTSIDE = (11.0, 11.0)  # in the room, but not in the first zone


def owned_box(stage: ScenarioBuilder) -> ScenarioBuilder:
    """Agent 0 has broken box 0, picked it up and set it up again."""
    stage.put("agent", 0, 0, 0)
    stage.put("box", 0, 1.3, 0)
    stage.step({0: "attack"}).step()
    stage.put("agent", 0, 1.3, 0)
    stage.step()
    assert stage.bag(0) == [stage.row("box_item", 0)]
    stage.put("agent", 0, 0, 0)
    stage.step({0: "use"})
    assert stage.here("box", 0)
    return stage


def test_the_zone_kills_one_step_after_health_is_gone() -> None:
    stage = ScenarioBuilder("ffa_1")
    stage.put("agent", 0, *OUTSIDE)
    assert stage.step().health(0) == 99
    stage.step(times=99)
    assert (stage.health(0), stage.here("agent", 0), stage.rewards[0]) == (0, True, 1)
    stage.step()
    assert (stage.here("agent", 0), stage.rewards[0], stage.death(0)) == (False, 0, ("zone", -1))
    assert stage.tick == 101


def test_a_heal_saves_who_has_no_health_left() -> None:
    stage = ScenarioBuilder("ffa_1")
    stage.put("agent", 0, *OUTSIDE)
    stage.hand(0, "heal", 0)
    stage.wound(0, 1)
    assert stage.step().health(0) == 0
    stage.step({0: "use"})
    assert (stage.health(0), stage.here("agent", 0)) == (74, True)


def test_who_has_no_health_left_can_still_kill() -> None:
    stage = duel(ScenarioBuilder())
    stage.wound(0, 0)
    stage.wound(1, 5)
    stage.step({0: "attack"})
    assert not stage.here("agent", 0)
    assert not stage.here("agent", 1)
    assert stage.death(1) == ("melee", 0)


def test_health_has_no_maximum() -> None:
    stage = ScenarioBuilder()
    stage.hand(0, "heal", 0)
    assert stage.step({0: "use"}).health(0) == 175
    assert stage.column(HealsUsed).heals_used[0, 0] == 1


def test_a_fresh_agent_takes_twenty_strikes() -> None:
    stage = duel(ScenarioBuilder())
    stage.step({0: "attack"}, 19)
    assert (stage.health(1), stage.here("agent", 1)) == (5, True)
    assert not stage.step({0: "attack"}).here("agent", 1)


def test_melee_reaches_a_centre_two_and_a_half_ahead() -> None:
    for far, health in ((2.49, 95), (2.51, 100)):
        assert duel(ScenarioBuilder(), far).step({0: "attack"}).health(1) == health


def test_who_strikes_together_dies_together() -> None:
    stage = duel(ScenarioBuilder())
    for agent in (0, 1):
        stage.wound(agent, 5)
    stage.step({0: "attack", 1: "attack"})
    assert stage.rewards == [-101, -101]
    assert stage.over


@pytest.mark.parametrize("kind", ["heal", "box_item", "box"])
def test_what_lies_between_takes_the_strike(kind: str) -> None:
    stage = duel(ScenarioBuilder())
    stage.put(kind, 0, 1, 0, size=(0.2, 0.2))
    assert stage.step({0: "attack"}).health(1) == 100
    stage.put(kind, 0, 0.1, 0, size=(0.5, 0.5))  # but not what the attacker stands in
    stage.column(Entity).alive[0, stage.row("box_item", 0)] = kind == "box_item"
    assert duel(stage).step({0: "attack"}).health(1) == 95


def test_walls_and_team_mates_take_the_strike() -> None:
    stage = mates(ScenarioBuilder("teams_4"))
    stage.put("agent", 1, 0.1, 0.4)
    stage.step({0: "attack"})
    assert [stage.health(agent) for agent in range(4)] == [100] * 4
    stage = ScenarioBuilder(melee_cooldown=40, melee_damage=20)
    stage.put("agent", 0, 11.5, 0)
    stage.put("agent", 1, 11.5, 1.2, -math.pi / 2)
    stage.step({0: "attack", 1: "attack"})
    stage.put("agent", 0, 11.5, 0, math.pi / 2)
    stage.step({0: "attack", 1: "attack"}, 40)
    assert (stage.health(0), stage.health(1)) == (80, 100)  # both rest, agent 0 because it struck the wall
    stage.step({0: "attack"})
    assert stage.health(1) == 80


def test_one_strike_breaks_a_box_and_its_item_comes_a_step_later() -> None:
    stage = ScenarioBuilder()
    stage.put("agent", 0, 0, 0)
    stage.put("box", 0, 1.5, 0.3)
    stage.step({0: "attack"})
    assert (stage.here("box", 0), stage.here("box_item", 0), stage.broken) == (False, False, [1, 0])
    assert stage.sees(0, "boxes") == stage.sees(0, "box_items") == [0, 0]
    stage.step()
    assert (stage.here("box", 0), stage.here("box_item", 0), stage.broken) == (False, True, [0, 0])
    assert stage.place("box_item", 0) == pytest.approx((1.5, 0.3))


def test_boxes_broken_together_leave_items_where_each_stood() -> None:
    """In the original both lay at the first one's place (rules, section 7, point 1)."""
    stage = ScenarioBuilder()
    for agent, x in enumerate((-5.0, 5.0)):
        stage.put("agent", agent, x, 0)
        stage.put("box", agent, x + 1.5, 0)
    stage.step({0: "attack", 1: "attack"}).step()
    assert [stage.place("box_item", k) for k in (0, 1)] == [(-3.5, 0), (6.5, 0)]


def test_the_vertices_of_what_broke_once_begin_one_corner_later() -> None:
    """In the paper's runs: a broken box is a copy, whose hull begins at the rightmost and then lowest vertex.

    The default of the mechanic is that they always begin at the lower left.
    """
    lower_left = [-0.5, -1, 0.5, -1, 0.5, 1, -0.5, 1]
    for numbers, after in (({}, lower_left[2:] + lower_left[:2]), ({"boxes_corners": "lower left"}, lower_left)):
        stage = ScenarioBuilder(**numbers)
        stage.put("agent", 0, 0, 0)
        stage.put("box", 0, 1.5, 0, size=(1, 2))
        stage.step()
        assert stage.observation["boxes"][0, 0, 0, :8].tolist() == lower_left
        stage.step({0: "attack"}).step()
        assert stage.observation["box_items"][0, 0, 0, :8].tolist() == after
        stage.put("agent", 0, 1.5, 0)
        stage.step()
        assert stage.observation["box_slot"][0, 0, 0].tolist() == after
        stage.step({0: "use"})
        stage.put("agent", 0, 0, 0)
        stage.step()
        assert stage.observation["boxes"][0, 0, 0, :8].tolist() == after
        assert stage.sees(0, "boxes") == [1, 0]


@pytest.mark.parametrize(("settles", "stands"), [(True, True), (False, False)])
def test_a_box_takes_no_harm_in_the_tick_in_which_it_is_set_up(settles: bool, stands: bool) -> None:
    """In the paper's runs. It shields whoever is behind it at once, and can be broken from the next tick on."""
    stage = duel(owned_box(ScenarioBuilder(boxes_settles=settles, boxes_offset=1.0)), 2.0)
    stage.step({0: "attack"}).step()
    stage.put("agent", 0, *stage.place("box_item", 0))
    stage.step()
    duel(stage, 2.0)
    stage.step({0: "use attack", 1: "attack"})
    assert stage.here("box", 0) == stands
    assert stage.health(1) == 100
    stage.step({0: "attack"})
    assert not stage.here("box", 0)


def test_only_its_owner_breaks_an_owned_box_for_good() -> None:
    stage = owned_box(ScenarioBuilder())
    stage.put("agent", 1, 0.75, 2, -math.pi / 2)
    assert stage.step({1: "attack"}, 5).here("box", 0)
    assert not stage.step({0: "attack"}).here("box", 0)
    stage.step()
    stage.put("agent", 1, *stage.place("box_item", 0))  # whoever sets it up, it stays agent 0's
    stage.step()
    stage.put("agent", 1, 0.75, 4, -math.pi / 2)
    stage.step({1: "use"})
    assert stage.here("box", 0)
    assert stage.step({1: "attack"}, 5).here("box", 0)


def test_the_box_of_a_dead_owner_is_indestructible() -> None:
    stage = owned_box(ScenarioBuilder(ending_rule="all dead"))
    stage.put("agent", 1, 0.75, 2, -math.pi / 2)
    stage.wound(0, 0)
    assert not stage.step().here("agent", 0)
    assert stage.step({1: "attack"}, 20).here("box", 0)


@pytest.mark.skipif(not COMPILED, reason="1500 steps")
def test_the_longest_life_without_heals() -> None:
    """The zone is void from the end of step 1400, hurts from 1401, and the last agent is removed in 1501."""
    stage = ScenarioBuilder("ffa_1", safe_zone_centres="middle")
    stage.put("agent", 0, 0, 0)
    stage.step(times=1400)
    assert (stage.health(0), stage.zone) == (100, [0] * 6)
    assert stage.step().health(0) == 99
    stage.step(times=99)
    assert (stage.health(0), stage.here("agent", 0), stage.over) == (0, True, False)
    stage.step()
    assert (stage.here("agent", 0), stage.over) == (False, True)


def test_the_zone_stands_a_hundred_steps_and_shrinks_a_hundred() -> None:
    stage = ScenarioBuilder("ffa_1")
    radii = [stage.zone[2]] + [stage.step().zone[2] for _ in range(200)]
    assert radii[:101] == [12.5] * 101
    assert [a - b for a, b in pairwise(radii[100:])] == pytest.approx([0.025] * 100, abs=1e-5)
    assert stage.zone[2] == 10


def test_a_kill_pays_the_killer() -> None:
    stage = duel(ScenarioBuilder())
    stage.wound(1, 5)
    assert stage.step({0: "attack"}).rewards == [101, -101]


def test_a_kill_pays_the_team_and_its_victims_team_mates_are_charged() -> None:
    stage = mates(ScenarioBuilder("teams_4"))
    stage.wound(2, 5)
    assert stage.step({0: "attack"}).rewards == [101, 101, -99, -99]


def test_teams_are_paid_for_the_kills_of_their_dead() -> None:
    stage = mates(ScenarioBuilder("teams_4"))
    for agent in (0, 2):
        stage.wound(agent, 5)
    assert stage.step({0: "attack", 2: "attack"}).rewards == [1, 1, 1, 1]
    stage = mates(ScenarioBuilder("teams_4"))
    for agent in range(4):
        stage.wound(agent, 5)
    stage.step(dict.fromkeys(range(4), "attack"))
    assert stage.rewards == [-1] * 4  # two kills, two deaths, and nobody is alive


def test_a_death_in_the_zone_is_nobodys_kill() -> None:
    """Also of an agent that a melee left with a single point."""
    stage = duel(ScenarioBuilder("ffa_4", safe_zone_radii=(1.0,)))
    stage.wound(1, 6)
    stage.step({0: "attack"})
    assert stage.health(1) == 0
    assert stage.step().rewards == [1, -101]
    assert stage.death(1) == ("zone", -1)


def test_who_strikes_the_doomed_in_a_later_step_gets_no_credit() -> None:
    """Unlike the original (rules, section 7, point 6)."""
    stage = duel(ScenarioBuilder("ffa_4", safe_zone_radii=(1.0,)))
    stage.wound(1, 1)
    assert stage.step().health(1) == 0
    assert stage.step({0: "attack"}).rewards == [1, -101]
    assert stage.death(1) == ("zone", -1)
