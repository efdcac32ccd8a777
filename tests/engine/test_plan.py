"""What batches of worlds of one game share, and when they do not."""

import contextlib
import gc
import weakref
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Phase
from outlast.ecs.running.compiled_game import KEPT
from outlast.systems import Heals
from tests.conftest import digest
from tests.helpers.mechanics import kind

SIZE = 1


Sized = kind("Sized", dims=lambda self: {"sized": SIZE})  # tables that depend on a global


@pytest.mark.parametrize("options", [{"specialize": True}, {"interpret": "heals.heal"}, {"without": (Phase.OBSERVE,)}])
def test_batches_of_a_game_share_its_layout_and_machine_code(options: dict[str, Any]) -> None:
    scenario = outlast.variant("teams_4").replace(ending_limit=77)
    one, other = (scenario.worlds(count) for count in (1, 5))
    assert one.layout is other.layout is not scenario.worlds(1, **options).layout
    assert one.schedule is other.schedule
    assert one.source() == other.source()


def test_equal_numbers_that_differ_have_one_each() -> None:
    """The sign of a zero decides where an atan2 points."""
    zeros = [outlast.variant("ffa_1").replace(rewards_kill=zero) for zero in (0.0, -0.0)]
    assert zeros[0] == zeros[1]
    kept = [next(m for m in zero.worlds(1).layout.modules if m.name == "rewards").kill for zero in zeros]
    assert np.signbit(kept).tolist() == [False, True]


def test_a_mechanic_of_the_users_is_asked_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may compute its tables from what has changed since."""
    scenario = outlast.variant("ffa_1").with_(Sized())
    assert scenario.worlds(1).dims["sized"] == 1
    monkeypatch.setitem(globals(), "SIZE", 3)
    assert scenario.worlds(1).dims["sized"] == 3


def test_systems_that_come_later_are_in_the_next_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = outlast.variant("ffa_1")
    assert "heals.heal" in str(scenario.worlds(1).schedule)
    monkeypatch.setattr(Heals, "registered", [system for system in Heals.registered if system.name != "heal"])
    assert "heals.heal " not in str(scenario.worlds(1).schedule)


def test_nothing_that_changes_is_shared() -> None:
    """Worlds, numbers and spaces of one batch stay what they are when another one's change."""
    one, other = (outlast.make_vec("ffa_3", 2, seed=5) for _ in range(2))
    for env in (one, other):
        env.reset()
    before, bound = digest(one.worlds), one.observation_space["own"].high.copy()
    other.worlds.set_numbers(melee_damage=50)
    other.observation_space["own"].high[:] = 7
    other.step(other.action_space.sample())
    assert digest(one.worlds) == before
    assert one.worlds.number("melee_damage") != 50
    assert np.array_equal(one.observation_space["own"].high, bound)
    assert np.array_equal(outlast.make_vec("ffa_3", 2).observation_space["own"].high, bound)


@pytest.mark.nightly
def test_games_of_before_are_let_go() -> None:
    scenario = outlast.variant("teams_4").roles(strong=outlast.role(1, melee_damage=9), other=outlast.role())
    layouts = []
    for k in range(KEPT + 3):
        with contextlib.closing(outlast.make_vec(scenario.replace(ending_limit=1000 + k), 1)) as env:
            env.reset(seed=0)
            layouts.append(weakref.ref(env.worlds.layout))
    del env
    gc.collect()
    assert [k for k, layout in enumerate(layouts) if layout() is None] == [0, 1, 2]
