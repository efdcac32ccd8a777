"""Fights, deaths, boxes and items: ticks of random worlds against tests/helpers/naive_mechanics.py."""

import pytest

from tests.conftest import few_by_day
from tests.helpers import naive_mechanics, naive_observations
from tests.helpers.ambiguity import collecting
from tests.helpers.naive_world import TOLERANCE
from tests.helpers.random_worlds import COUNT, DAILY, KINDS, disagreements, play
from tests.reference.episodes import MOTION
from tests.reference.physics import move
from tests.reference.random_numbers import scattered

kinds = pytest.mark.parametrize("kind", few_by_day(KINDS, DAILY))


@kinds
def test_a_hit_costs_health_and_names_the_right_source(kind: str) -> None:
    assert disagreements(kind, ["agent"], "health", "damage_type", "source") == []


@kinds
def test_weapons_rest_after_a_strike_that_met_something(kind: str) -> None:
    assert disagreements(kind, ["agent"], "wait") == []


@kinds
def test_agents_without_health_at_the_check_die(kind: str) -> None:
    assert disagreements(kind, ["agent"], "here") == []
    assert [k for k, tick in enumerate(play(kind)) if tick.after.deaths != tick.want.deaths] == []


@kinds
def test_bags_hold_what_was_picked_up_given_and_not_used(kind: str) -> None:
    assert disagreements(kind, ["agent"], "bag") == []
    assert disagreements(kind, ["heal", "box_item"], "holder") == []


@kinds
def test_items_lie_where_they_fell_until_somebody_takes_them(kind: str) -> None:
    assert disagreements(kind, ["heal", "box_item"], "here") == []
    for tick in play(kind):
        pairs = zip(tick.after.of("heal", "box_item"), tick.want.of("heal", "box_item"), strict=True)
        for got, want in pairs:
            assert not want.here or (got.x, got.y) == pytest.approx((want.x, want.y), abs=TOLERANCE)


@kinds
def test_boxes_break_become_items_and_are_set_up_again(kind: str) -> None:
    assert disagreements(kind, ["box"], "here", "broken", "owner") == []
    for tick in play(kind):
        for got, want in zip(tick.after.of("box"), tick.want.of("box"), strict=True):
            if want.here:
                assert (got.health, got.angle) == (want.health, pytest.approx(want.angle, abs=TOLERANCE))
                assert (got.x, got.y) == pytest.approx((want.x, want.y), abs=TOLERANCE)


@kinds
def test_bodies_move_as_in_a_box2d_world_of_all_of_them(kind: str) -> None:
    """Where three overlap, or a box is set up on an agent, order or the last bit decides where they are pushed."""
    gaps = []
    for tick in play(kind):
        with collecting():
            want = naive_mechanics.tick(tick.before, tick.actions, move, scattered, naive_observations.see)
        pairs = zip(tick.after.of("agent", "box"), want.of("agent", "box"), strict=True)
        gaps += [max(abs(getattr(a, c) - getattr(b, c)) for c in MOTION) for a, b in pairs if b.here]
    assert sum(gap > 1e-6 for gap in gaps) <= 0.01 * len(gaps)
    assert len(gaps) > COUNT


@kinds
def test_these_random_worlds_are_eventful(kind: str) -> None:
    """Guards the tests above against having nothing to compare."""
    ticks = play(kind)
    pairs = [pair for t in ticks for pair in zip(t.before.of("agent"), t.want.of("agent"), strict=True)]
    bags = [(before.bag, want.bag) for before, want in pairs]
    events = {
        "deaths": sum(len(tick.want.deaths) for tick in ticks),
        "kills": sum(source >= 0 for tick in ticks for _, _, source in tick.want.deaths),
        "items dropped": sum(len(tick.want.fallen) for tick in ticks),
        "items used": sum(len(tick.want.used) for tick in ticks),
        "boxes broken": sum(box.broken for tick in ticks for box in tick.want.of("box")),
        "bags that changed": sum(old != new for old, new in bags),
    }
    assert min(events.values()) > COUNT / 20, events
