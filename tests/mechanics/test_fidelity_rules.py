"""What was measured on the authors' own implementation ([M] in the reference rules): fights, boxes, zone and pay."""

import math

import pytest

from outlast.ecs import Entity
from tests.conftest import COMPILED
from tests.helpers.scenario_builder import ScenarioBuilder, duel, mates

OUTSIDE = (11.0, 11.0)  # in the room, but not in the first zone


def owned_box(game: ScenarioBuilder) -> ScenarioBuilder:
    """Agent 0 has broken box 0, picked it up and set it up again."""
    game.put("agent", 0, 0, 0)
    game.put("box", 0, 1.3, 0)
    game.step({0: "attack"}).step()
    game.put("agent", 0, 1.3, 0)
    game.step()
    assert game.bag(0) == [game.row("box_item", 0)]
    game.put("agent", 0, 0, 0)
    game.step({0: "use"})
    assert game.here("box", 0)
    return game


def test_the_zone_kills_one_step_after_health_is_gone() -> None:
    game = ScenarioBuilder("ffa_1")
    game.put("agent", 0, *OUTSIDE)
    assert game.step().health(0) == 99
    game.step(times=99)
    assert (game.health(0), game.here("agent", 0), game.rewards[0]) == (0, True, 1)
    game.step()
    assert (game.here("agent", 0), game.rewards[0], game.death(0)) == (False, 0, ("zone", -1))
    assert game.tick == 101


def test_melee_reaches_a_centre_two_and_a_half_ahead() -> None:
    for far, health in ((2.49, 95), (2.51, 100)):
        assert duel(ScenarioBuilder(), far).step({0: "attack"}).health(1) == health


@pytest.mark.parametrize("kind", ["heal", "box_item", "box"])
def test_what_lies_between_takes_the_strike(kind: str) -> None:
    game = duel(ScenarioBuilder())
    game.put(kind, 0, 1, 0, size=(0.2, 0.2))
    assert game.step({0: "attack"}).health(1) == 100
    game.put(kind, 0, 0.1, 0, size=(0.5, 0.5))  # but not what the attacker stands in
    game.column(Entity).alive[0, game.row("box_item", 0)] = kind == "box_item"
    assert duel(game).step({0: "attack"}).health(1) == 95


def test_the_vertices_of_what_broke_once_begin_one_corner_later() -> None:
    """In the paper's runs: a broken box is a copy, whose hull begins at the rightmost and then lowest vertex.

    The default of the mechanic is that they always begin at the lower left.
    """
    lower_left = [-0.5, -1, 0.5, -1, 0.5, 1, -0.5, 1]
    for numbers, after in (({}, lower_left[2:] + lower_left[:2]), ({"boxes_corners": "lower left"}, lower_left)):
        game = ScenarioBuilder(**numbers)
        game.put("agent", 0, 0, 0)
        game.put("box", 0, 1.5, 0, size=(1, 2))
        game.step()
        assert game.observation["boxes"][0, 0, 0, :8].tolist() == lower_left
        game.step({0: "attack"}).step()
        assert game.observation["box_items"][0, 0, 0, :8].tolist() == after
        game.put("agent", 0, 1.5, 0)
        game.step()
        assert game.observation["box_slot"][0, 0, 0].tolist() == after
        game.step({0: "use"})
        game.put("agent", 0, 0, 0)
        game.step()
        assert game.observation["boxes"][0, 0, 0, :8].tolist() == after
        assert game.sees(0, "boxes") == [1, 0]


@pytest.mark.parametrize(("settles", "stands"), [(True, True), (False, False)])
def test_a_box_takes_no_harm_in_the_tick_in_which_it_is_set_up(settles: bool, stands: bool) -> None:
    """In the paper's runs. It shields agents behind it at once, and can be broken from the next tick on."""
    game = duel(owned_box(ScenarioBuilder(boxes_settles=settles, boxes_offset=1.0)), 2.0)
    game.step({0: "attack"}).step()
    game.put("agent", 0, *game.place("box_item", 0))
    game.step()
    duel(game, 2.0)
    game.step({0: "use attack", 1: "attack"})
    assert game.here("box", 0) == stands
    assert game.health(1) == 100
    game.step({0: "attack"})
    assert not game.here("box", 0)


def test_only_its_owner_breaks_an_owned_box_for_good() -> None:
    game = owned_box(ScenarioBuilder())
    game.put("agent", 1, 0.75, 2, -math.pi / 2)
    assert game.step({1: "attack"}, 5).here("box", 0)
    assert not game.step({0: "attack"}).here("box", 0)
    game.step()
    game.put("agent", 1, *game.place("box_item", 0))  # it stays agent 0's, even if another sets it up
    game.step()
    game.put("agent", 1, 0.75, 4, -math.pi / 2)
    game.step({1: "use"})
    assert game.here("box", 0)
    assert game.step({1: "attack"}, 5).here("box", 0)


@pytest.mark.skipif(not COMPILED, reason="1500 steps")
def test_the_longest_life_without_heals() -> None:
    """The zone is void from the end of step 1400, hurts from 1401, and the last agent is removed in 1501."""
    game = ScenarioBuilder("ffa_1", safe_zone_centres="middle")
    game.put("agent", 0, 0, 0)
    game.step(times=1400)
    assert (game.health(0), game.zone) == (100, [0] * 6)
    assert game.step().health(0) == 99
    game.step(times=99)
    assert (game.health(0), game.here("agent", 0), game.done) == (0, True, False)
    game.step()
    assert (game.here("agent", 0), game.done) == (False, True)


def test_teams_are_paid_for_the_kills_of_their_dead() -> None:
    game = mates(ScenarioBuilder("teams_4"))
    for agent in (0, 2):
        game.wound(agent, 5)
    assert game.step({0: "attack", 2: "attack"}).rewards == [1, 1, 1, 1]
    game = mates(ScenarioBuilder("teams_4"))
    for agent in range(4):
        game.wound(agent, 5)
    game.step(dict.fromkeys(range(4), "attack"))
    assert game.rewards == [-1] * 4  # two kills, two deaths, and no agent is alive


def test_a_death_in_the_zone_is_nobodys_kill() -> None:
    """Also of an agent that a melee left with a single point."""
    game = duel(ScenarioBuilder("ffa_4", safe_zone_radii=(1.0,)))
    game.wound(1, 6)
    game.step({0: "attack"})
    assert game.health(1) == 0
    assert game.step().rewards == [1, -101]
    assert game.death(1) == ("zone", -1)
