"""What was measured on the authors' own implementation ([M] in the reference rules): who gets and keeps what."""

import math

import pytest

from tests.helpers.scenario_builder import CORNERS, ScenarioBuilder, duel, mates


def test_pickup_needs_the_centre_within_half_a_metre() -> None:
    for far, taken in ((0.49, True), (0.5, True), (0.51, False)):
        stage = ScenarioBuilder()
        stage.put("agent", 0, 0, 0)
        stage.put("heal", 0, far, 0)
        assert stage.step().here("heal", 0) != taken


def test_a_full_bag_leaves_the_item_on_the_ground() -> None:
    stage = ScenarioBuilder()
    for k in range(4):
        stage.hand(0, "heal", k)
    stage.put("heal", 4, *CORNERS[0])
    assert stage.step().here("heal", 4)
    assert len(stage.bag(0)) == 4
    stage.step({0: "use"})
    assert not stage.here("heal", 4)


def test_an_item_goes_into_one_bag_only() -> None:
    """In the original, agents pressed together could both get it (rules, section 7, point 3)."""
    stage = duel(ScenarioBuilder(), 0.995)
    stage.put("heal", 0, 0.4975, 0)
    stage.step()
    assert sorted(map(len, (stage.bag(0), stage.bag(1)))) == [0, 1]


def test_what_one_uses_is_not_what_one_gives() -> None:
    stage = duel(ScenarioBuilder(), 1.5)
    for k in (0, 1):
        stage.hand(0, "heal", k)
    stage.step({0: "use give"})
    assert (stage.health(0), stage.bag(0), stage.bag(1)) == (175, [], [stage.row("heal", 0)])


@pytest.mark.parametrize("far", [1.99, 2.0, 2.01])
def test_giving_reaches_two_metres(far: float) -> None:
    stage = duel(ScenarioBuilder(), far)
    stage.hand(0, "heal", 0)
    assert len(stage.step({0: "give"}).bag(1)) == (far <= 2)


@pytest.mark.parametrize("kind", ["heal", "box_item", "box", "opponent"])
def test_giving_fails_if_anything_else_is_nearer(kind: str) -> None:
    stage = mates(ScenarioBuilder("teams_4"))
    stage.put("agent", 1, -1, 1.9)
    stage.hand(0, "heal", 1)
    assert stage.step({0: "give"}).bag(1) == [stage.row("heal", 1)]
    stage.put("agent", 2, -2.5, 0) if kind == "opponent" else stage.put(kind, 0, -1.9, 0, size=(0.1, 0.1))
    stage.hand(0, "heal", 2)
    assert stage.step({0: "give"}).bag(0) == [stage.row("heal", 2)]


def test_who_gives_to_a_full_bag_keeps_the_item() -> None:
    """In the original it was lost (rules, section 7, point 4)."""
    stage = duel(ScenarioBuilder(), 1.5)
    for k in range(4):
        stage.hand(1, "heal", k)
    stage.hand(0, "heal", 4)
    assert stage.step({0: "give"}).bag(0) == [stage.row("heal", 4)]
    assert len(stage.bag(1)) == 4


def test_the_dead_drop_everything_half_a_metre_away() -> None:
    stage = ScenarioBuilder("ffa_1")
    for k in range(3):
        stage.hand(0, "heal", k)
    stage.wound(0, 0)
    stage.step()
    assert [math.dist(stage.place("heal", k), CORNERS[0]) for k in range(3)] == pytest.approx([0.5] * 3, abs=1e-5)
    assert stage.bag(0) == []


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
def test_two_who_give_to_each_other(first: str, second: str, first_after: str, second_after: str) -> None:
    stage = duel(ScenarioBuilder(n_heals=8), 1.5)
    names = {stage.row("heal", k): letter for k, letter in enumerate("abcdefgh")}
    for agent, bag in enumerate((first, second)):
        for letter in bag:
            stage.hand(agent, "heal", "abcdefgh".index(letter))
    stage.step({0: "give", 1: "give"})
    assert ["".join(names[row] for row in stage.bag(agent)) for agent in (0, 1)] == [first_after, second_after]


def test_unless_it_passes_on_who_has_nothing_gives_nothing() -> None:
    stage = duel(ScenarioBuilder(give_last_passes_on=False), 1.5)
    stage.hand(0, "heal", 0)
    stage.step({0: "give", 1: "give"})
    assert (stage.bag(0), stage.bag(1)) == ([], [stage.row("heal", 0)])
