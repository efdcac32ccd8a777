"""One tick of degenerate worlds, made by hypothesis, against the naive forms; on a grid, where nothing is rounded."""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from tests.conftest import COMPILED, few_by_day
from tests.helpers.edge_cases import CASES, SLOTS, Sketch, build, sketches
from tests.helpers.naive_world import TOLERANCE, read
from tests.helpers.random_worlds import TEXT, moved_as_in
from tests.reference import episodes as reference
from tests.reference.episodes import Outcome, facts

KEEP = ("agents_count", "boxes_count", "heals_count", "inventory_slots", "rewards_kill", "rewards_death")
AS_WRITTEN = {key: value for key, value in TEXT.items() if key not in KEEP} | {"boxes_least": 0.003}
GAMES: dict[str, tuple[str, dict[str, Any]]] = {
    "ffa as run": ("ffa_4", {}),
    "teams as run": ("teams_4", {}),
    "ffa as written": ("ffa_4", AS_WRITTEN),
    "teams as written": ("teams_4", AS_WRITTEN | {"mortality_limit": 100, "cameras_mode": "masked"}),
}
SOME = settings(max_examples=350 if COMPILED else 20, deadline=None, derandomize=True)
EVENTS: dict[str, Callable[[Outcome, Outcome], bool]] = {
    "several at the same place": lambda got, want: len(set(places(want))) < len(places(want)),
    "all are dead": lambda got, want: not any(agent.here for agent in got.world.of("agent")),
    "a full bag": lambda got, want: any(len(agent.bag) == SLOTS for agent in got.world.of("agent")),
    "the void": lambda got, want: got.world.zone[2] == 0,
    "a death": lambda got, want: bool(got.world.deaths),
    "a blow": lambda got, want: any(agent.losses[-1:] and agent.source >= 0 for agent in want.world.of("agent")),
    "an ambiguous case": lambda got, want: bool(want.ambiguous),
    "a box broke": lambda got, want: any(box.broken for box in got.world.of("box")),
    "an item was used": lambda got, want: bool(want.world.used),
}


def places(outcome: Outcome) -> list[tuple[float, float]]:
    return [(entity.x, entity.y) for entity in outcome.world.entities if entity.here]


def played(sketch: Sketch, name: str) -> tuple[Outcome, Outcome, bool]:
    """What the engine and what the naive forms make of a tick; and whether all stayed on the grid.

    Contacts move agents off it, and what the dead drop lies anywhere.
    """
    variant, numbers = GAMES[name]
    game = build(sketch, variant, **numbers)
    before = read(game.env, 0)
    choices = [dict(zip(reference.KEYS, (0, 0, 0, *agent.acts), strict=True)) for agent in sketch.agents]
    observations, *_ = game.env.step(np.array([[(1, 1, 1, *agent.acts) for agent in sketch.agents]]))
    got = reference.read_outcome(game.env, 0, observations)
    want = reference.step(before, choices, moved_as_in(got.world))
    still = all((a.x, a.y) == (b.x, b.y) for a, b in zip(before.of("agent"), got.world.of("agent"), strict=True))
    return got, want, still and not want.world.fallen


@pytest.mark.parametrize("name", few_by_day(GAMES, ("teams as written",)))
def test_what_comes_out_of_degenerate_worlds_is_what_the_naive_forms_say(name: str) -> None:
    """All of these events must have happened, and often."""
    counts: Counter[str] = Counter()

    @SOME
    @given(sketches)
    def run(sketch: Sketch) -> None:
        counts.update(check(*played(sketch, name)))

    run()
    if COMPILED:
        assert len(counts) == len(EVENTS) + 2
        assert min(counts.values()) >= 4, counts


@pytest.mark.parametrize("name", GAMES)
@pytest.mark.parametrize("words", CASES)
def test_what_comes_out_of_this_world_is_what_the_naive_forms_say(words: str, name: str) -> None:
    """What hypothesis might not find: each hits an edge to the bit."""
    got, want, _ = played(CASES[words], name)
    check(got, want, on_grid=True)


def check(got: Outcome, want: Outcome, on_grid: bool) -> list[str]:
    """Whole numbers are equal on the grid, or where nothing was close; observations, in the latter case only."""
    events = [event for event, happened in EVENTS.items() if happened(got, want)]
    if on_grid or not want.ambiguous:
        assert facts(got, want) == []
        events.append("facts were compared")
    if not want.ambiguous:
        events.append("observations were compared")
        for key, value in want.observation.items():
            np.testing.assert_allclose(got.observation[key], value, atol=TOLERANCE, err_msg=key)
    return events
