"""What must hold holds in random play; tests/robustness/test_soak.py plays longer."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Box, End, Episode, Health, Item, Reward, Zone
from outlast.ecs import Entity
from tests.conftest import COMPILED, scaled
from tests.helpers.invariants import SCENARIOS, CheckedPlay, scenario


@pytest.mark.parametrize("name", SCENARIOS)
@pytest.mark.by_day(3)
def test_what_must_hold_holds_in_random_play(name: str) -> None:
    env = outlast.make_vec(scenario(name), scaled(16, least=2), seed=8)
    play = CheckedPlay(env, seed=9)
    for _ in range(scaled(250, least=50)):
        play.step()
    env.close()
    assert play.deaths > 4 or not COMPILED  # in a short run there may be none


DAMAGE: dict[str, Callable[[Any], Any]] = {  # done to world 1 of teams_4
    "a position that is no number": lambda worlds: worlds[Body].x[1].fill(float("nan")),
    "an agent beyond the wall": lambda worlds: worlds[Body].y[1].fill(13),
    "an agent without health that lives": lambda worlds: worlds[Health].points[1].fill(0),
    "agents that are gone, and did not die": lambda worlds: worlds[Entity].alive[1, worlds.span("agent")].fill(0),
    "an item that is nowhere": lambda worlds: worlds[Entity].alive[1, worlds.span("heal")].fill(0),
    "an item in a bag and on the ground": lambda worlds: worlds[Bag].count[1, worlds.span("agent")].fill(1),
    "an item that is held, but in no bag": lambda worlds: worlds[Item].holder[1, worlds.span("heal")].fill(0),
    "a box that has broken and stands": lambda worlds: worlds[Box].broken[1, worlds.span("box")].fill(1),
    "a zone beyond the room": lambda worlds: worlds[Zone].next_x[1].fill(13),
    "another reward": lambda worlds: worlds[Reward].reward[1].__iadd__(1),
    "another return": lambda worlds: worlds[Episode].returns[1].__iadd__(1),
    "another length": lambda worlds: worlds[Episode].length[1].__iadd__(1),
    "an end without a reason": lambda worlds: worlds[End].terminated[1].fill(1),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_does_not_hold_is_noticed(damage: str) -> None:
    env = outlast.make_vec("teams_4", 3, seed=8)
    play = CheckedPlay(env, seed=9)
    play.step()
    play.checker.check(env.observe(), ran=np.zeros(3, bool))
    DAMAGE[damage](env.worlds)
    with pytest.raises(AssertionError):
        play.checker.check(env.observe(), ran=np.zeros(3, bool))
