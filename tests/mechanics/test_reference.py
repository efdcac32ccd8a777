"""Whole episodes against the slow reference, which plays them by itself from what the reset made."""

import math
from typing import Any

import pytest

from outlast import variant
from outlast.ecs.kernels.simd import SIMD_WIDTH
from outlast.envs.rollout.policies import POLICIES
from outlast.systems.geometry.bodies import FEW
from tests.conftest import COMPILED, scaled
from tests.reference.__main__ import main
from tests.reference.episodes import Episode, compare, held, record

POLICY = {"held": held, **POLICIES}
# Fights, deaths and everything else within a hundred ticks.
QUICK: dict[str, Any] = {
    "agents_health": 30, "room_size": 14.0, "safe_zone_radii": (6.0, 3.0), "safe_zone_stand": 20,
    "safe_zone_shrink": 20, "heals_amount": 20, "motors_ahead": 0.5,
}  # fmt: skip


def events(episodes: list[Episode]) -> dict[str, int]:
    """How often what happened, all in all."""
    ends = [episode.ticks[-1].world.statistics for episode in episodes]
    ticks = [tick.world for episode in episodes for tick in episode.ticks]
    return {
        "kills": sum(sum(end["kills"]) for end in ends),
        "deaths": sum(sum(end["deaths"]) for end in ends),
        "heals used": sum(end["heals_used"] for end in ends),
        "boxes placed": sum(end["boxes_placed"] for end in ends),
        "boxes broken": sum(box.broken for world in ticks for box in world.of("box")),
    }


@pytest.mark.parametrize("policy", ["held", "scripted"])
@pytest.mark.parametrize("name", ["ffa_4", "teams_4"])
@pytest.mark.by_day(2)
def test_short_episodes_are_those_of_the_reference(name: str, policy: str) -> None:
    numbers = QUICK | ({} if COMPILED else {"n_heals": 4, "n_boxes": 3})
    episodes = record(variant(name).replace(**numbers), scaled(3, least=1), 1, POLICY[policy])
    results = [compare(episode) for episode in episodes]
    assert all(result.diverged == 0 for result in results), results
    assert sum(result.compared for result in results) > 0.8 * sum(result.ticks for result in results), results
    assert not COMPILED or events(episodes)["deaths"] >= 3


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="whole episodes")
@pytest.mark.parametrize("policy", ["held", "random", "scripted"])
@pytest.mark.parametrize("name", ["ffa_4", "teams_4"])
def test_whole_episodes_are_those_of_the_reference(name: str, policy: str) -> None:
    """With the paper's numbers, until they are over: each tick's whole numbers, rewards, ends and statistics.

    A float's last bit, see the test below, grows with every collision: in the end some episodes differ.
    """
    episodes = record(variant(name), 4, 5, POLICY[policy])
    results = [compare(episode) for episode in episodes]
    assert sum(result.diverged == 0 for result in results) >= 2, results
    assert sum(result.compared for result in results) > 0.2 * sum(result.ticks for result in results)
    assert min(len(episode.ticks) for episode in episodes) > 100
    happened = events(episodes)
    assert min(happened["deaths"], happened["heals used"]) > 0, happened
    assert happened["boxes broken"] > 0 or policy != "held", happened


@pytest.mark.skipif(not COMPILED, reason="a crowd")
def test_a_crowd_is_that_of_the_reference() -> None:
    """With so many bodies and items that cameras, melee, contacts and pickup look them up in a spatial index."""
    many = {"n_agents": 12, "n_boxes": SIMD_WIDTH * FEW + 10, "n_heals": SIMD_WIDTH * FEW + 20, "spawn_grid_cells": 19}
    numbers = many | {"room_size": 30.0, "motors_ahead": 1.0, "pickup_reach": 1.0, "ending_limit": 8}
    (episode,) = record(variant("ffa_4").replace(**numbers), 1, 6, held)
    result, last = compare(episode), episode.ticks[-1].world
    assert (result.diverged, result.ticks) == (0, 8), result
    assert result.compared > 4
    assert sum(len(agent.bag) for agent in last.of("agent")) > 1
    apart = [math.hypot(a.x - b.x, a.y - b.y) for a in last.of("agent") for b in last.of("box") if b.here]
    assert min(apart) < 1  # somebody runs into a box


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="numpy has sines of its own")
def test_motion_is_the_references_to_the_bit() -> None:
    """What flies free moves by Box2D's own arithmetic, in float32: as if Box2D had all bodies."""
    for name in ("ffa_4", "teams_4"):
        (episode,) = record(variant(name), 1, 5, POLICIES["random"])
        assert compare(episode).drift == 0


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="a whole episode")
def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    """Its smallest size; with an hour to spare, ask for more."""
    assert main(["ffa_1", "--episodes", "1", "--seed", "3"]) == 0
    assert "ffa_1 Comparison(ticks=" in capsys.readouterr().out
