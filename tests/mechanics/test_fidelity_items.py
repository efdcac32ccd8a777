"""What was measured on the authors' own implementation ([M] in the reference rules): whose the items are."""

import math

import pytest

from tests.helpers.scenario_builder import CORNERS, ScenarioBuilder, duel, mates


def test_pickup_needs_the_centre_within_half_a_metre() -> None:
    for far, taken in ((0.49, True), (0.5, True), (0.51, False)):
        game = ScenarioBuilder()
        game.put("agent", 0, 0, 0)
        game.put("heal", 0, far, 0)
        assert game.step().here("heal", 0) != taken


def test_a_full_bag_leaves_the_item_on_the_ground() -> None:
    game = ScenarioBuilder()
    for k in range(4):
        game.hand(0, "heal", k)
    game.put("heal", 4, *CORNERS[0])
    assert game.step().here("heal", 4)
    assert len(game.bag(0)) == 4
    game.step({0: "use"})
    assert not game.here("heal", 4)


def test_an_item_goes_into_one_bag_only() -> None:
    """In the original, agents pressed together could both get it (rules, section 7, point 3)."""
    game = duel(ScenarioBuilder(), 0.995)
    game.put("heal", 0, 0.4975, 0)
    game.step()
    assert sorted(map(len, (game.bag(0), game.bag(1)))) == [0, 1]


def test_what_one_uses_is_not_what_one_gives() -> None:
    game = duel(ScenarioBuilder(), 1.5)
    for k in (0, 1):
        game.hand(0, "heal", k)
    game.step({0: "use give"})
    assert (game.health(0), game.bag(0), game.bag(1)) == (175, [], [game.row("heal", 0)])


@pytest.mark.parametrize("far", [1.99, 2.0, 2.01])
def test_giving_reaches_two_metres(far: float) -> None:
    game = duel(ScenarioBuilder(), far)
    game.hand(0, "heal", 0)
    assert len(game.step({0: "give"}).bag(1)) == (far <= 2)


@pytest.mark.parametrize("kind", ["heal", "box_item", "box", "opponent"])
def test_giving_fails_if_anything_else_is_nearer(kind: str) -> None:
    game = mates(ScenarioBuilder("teams_4"))
    game.put("agent", 1, -1, 1.9)
    game.hand(0, "heal", 1)
    assert game.step({0: "give"}).bag(1) == [game.row("heal", 1)]
    game.put("agent", 2, -2.5, 0) if kind == "opponent" else game.put(kind, 0, -1.9, 0, size=(0.1, 0.1))
    game.hand(0, "heal", 2)
    assert game.step({0: "give"}).bag(0) == [game.row("heal", 2)]


def test_an_item_given_to_a_full_bag_is_kept() -> None:
    """In the original it was lost (rules, section 7, point 4)."""
    game = duel(ScenarioBuilder(), 1.5)
    for k in range(4):
        game.hand(1, "heal", k)
    game.hand(0, "heal", 4)
    assert game.step({0: "give"}).bag(0) == [game.row("heal", 4)]
    assert len(game.bag(1)) == 4


def test_the_dead_drop_everything_half_a_metre_away() -> None:
    game = ScenarioBuilder("ffa_1")
    for k in range(3):
        game.hand(0, "heal", k)
    game.wound(0, 0)
    game.step()
    assert [math.dist(game.place("heal", k), CORNERS[0]) for k in range(3)] == pytest.approx([0.5] * 3, abs=1e-5)
    assert game.bag(0) == []


# How two agents that stand side by side end up when both give in one tick: the original's own runs, bags from the first
# item to the last, but where its full takers destroyed an item the giver keeps it.
MUTUAL = [
    ("ab", "c", "ab", "c"),  # a's item goes over and comes straight back
    ("a", "c", "a", "c"),
    ("ab", "", "ab", ""),
    ("a", "", "a", ""),
    ("abcd", "ef", "abcd", "ef"),  # its own giving makes room for the way back
    ("abcd", "", "abcd", ""),
    ("", "cd", "d", "c"),
    ("", "cdef", "f", "cde"),
    ("ab", "cdef", "abf", "cde"),  # c is full: a keeps its own, and then gets one
    ("abcd", "efgh", "abcd", "efgh"),
]


@pytest.mark.parametrize(("first", "second", "first_after", "second_after"), MUTUAL)
def test_two_agents_give_to_each_other(first: str, second: str, first_after: str, second_after: str) -> None:
    game = duel(ScenarioBuilder(n_heals=8), 1.5)
    names = {game.row("heal", k): letter for k, letter in enumerate("abcdefgh")}
    for agent, bag in enumerate((first, second)):
        for letter in bag:
            game.hand(agent, "heal", "abcdefgh".index(letter))
    game.step({0: "give", 1: "give"})
    assert ["".join(names[row] for row in game.bag(agent)) for agent in (0, 1)] == [first_after, second_after]


def test_unless_it_passes_on_an_empty_bag_gives_nothing() -> None:
    game = duel(ScenarioBuilder(give_last_passes_on=False), 1.5)
    game.hand(0, "heal", 0)
    game.step({0: "give", 1: "give"})
    assert (game.bag(0), game.bag(1)) == ([], [game.row("heal", 0)])
