"""What was measured on the authors' own implementation ([M] in the reference rules): whose the items are."""

import pytest

from tests.helpers.scenario_builder import CORNERS, ScenarioBuilder, duel


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


def test_what_one_uses_is_not_what_one_gives() -> None:
    game = duel(ScenarioBuilder(), 1.5)
    for k in (0, 1):
        game.hand(0, "heal", k)
    game.step({0: "use give"})
    assert (game.health(0), game.bag(0), game.bag(1)) == (175, [], [game.row("heal", 0)])


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
