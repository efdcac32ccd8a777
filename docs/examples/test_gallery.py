"""Tests of the small games of the gallery. Run them: python -m pytest docs/examples/test_gallery.py."""

import numpy as np
import pytest
from quadrant import QUADRANT

import outlast
from outlast.components import Body

GAMES = [QUADRANT]


def made(scenario, worlds=1):
    """Worlds at the start of an episode."""
    env = outlast.make_vec(scenario, worlds, seed=0)
    env.reset()
    return env, env.worlds[Body], env.worlds.span


def play(env, ticks, *actions):
    """Ticks in which the agents do this."""
    for _ in range(ticks):
        step = env.step(np.array([actions] * env.num_worlds))
    return step


@pytest.mark.parametrize("scenario", GAMES, ids=lambda scenario: scenario.name)
def test_nothing_is_wrong_with_it(scenario):
    assert outlast.check(scenario) == []


def test_crates_start_in_a_quadrant_that_is_drawn_and_agents_outside():
    _, body, span = made(QUADRANT, 64)
    crates, agents = span("crate"), span("agent")
    assert (np.maximum(body.x[:, crates], body.y[:, crates]) < 0).all()
    assert (np.maximum(body.x[:, agents], body.y[:, agents]) > 0).all()
    walls = body.x[:, span("inner_wall")]
    assert len(np.unique(walls[:, 0])) == 64
    assert outlast.check(QUADRANT.replace(crates_count=0)) == []
