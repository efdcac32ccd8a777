"""Bounds of observations: true in play, real where there are any, infinite elsewhere, and so read by wrappers."""

import math
from typing import Any

import pytest

import outlast
from outlast import Scenario, make_vec, variant
from outlast.ecs import DeclarationError
from outlast.envs.rollout.policies import random_policy, scripted_policy
from outlast.envs.scenarios.hide_and_seek import HIDE_2V2
from outlast.systems import DropLast
from tests.conftest import few_by_day, scaled
from tests.helpers.execution_modes import SHORT, short
from tests.helpers.mechanics import mechanic

INF = math.inf
HARD: dict[str, Any] = {
    "boxes_width_deviation": 3.0,
    "boxes_least": 0.003,
    "boxes_offset": 3.0,
    "death_drop_radius": 2.0,
}
CASES: dict[str, Scenario] = {
    **{name: short(name) for name in outlast.VARIANTS},
    "far away": short("teams_4").with_(DropLast(offset=4.0)).replace(**HARD, death_drop_scatter="rim"),
    "pushed boxes": short("ffa_4").replace(boxes_dynamic=True, cameras_mode="revealed"),
    "no boxes left": variant("teams_3").replace(**SHORT, boxes_toughness=1, melee_reach=8.0),
    "crowd": short("ffa_3").replace(n_agents=12, heals_amount=3, mortality_limit=50, agents_health=50),
    "zones alike": short("ffa_1").replace(safe_zone_radii=(12.5, 12.5, 12.5), safe_zone_stand=1, safe_zone_shrink=29),
    "hall": short("ffa_3").replace(room_width=30.0, room_height=9.0, safe_zone_radii=(4.5, 2.0)),
    "small room": short("ffa_3").replace(room_size=9.0, safe_zone_radii=(4.5, 1e-6), spawn_grid_cells=5, n_heals=4),
    "no walls": short("ffa_1").replace(room_walls=False),
}
BY_DAY = ("ffa_1", "teams_3", "hall", "far away", "zones alike", "crowd", "no walls")


@pytest.mark.parametrize("name", few_by_day(CASES, BY_DAY))
def test_every_observation_lies_within(name: str) -> None:
    env = make_vec(CASES[name], scaled(48, least=2), seed=3)
    single: Any = env.single_observation_space
    lows, highs = ({key: getattr(box, end) for key, box in single.items()} for end in ("low", "high"))
    for make_policy in (random_policy, scripted_policy):
        policy, (observations, _) = make_policy(env, 1), env.reset()
        for _ in range(scaled(150, least=30)):
            for key, values in observations.items():
                assert ((lows[key] <= values) & (values <= highs[key])).all(), key
            observations, *_ = env.step(policy(observations))
    assert env.observation_space.contains({key: values.copy() for key, values in observations.items()})
    assert env.observation_space.contains(env.observation_space.sample())
    assert all((box.low <= 0).all() and (box.high >= 0).all() for box in single.values())  # what is not there


def row(game: Any, key: str) -> list[tuple[float, float]]:
    """The bounds of the last axis for the first agent (and entity)."""
    box: Any = make_vec(game, 1).single_observation_space[key]
    low, high = (end.reshape(-1, end.shape[-1])[0].astype(float) for end in (box.low, box.high))
    return list(zip(low.tolist(), high.tolist(), strict=True))


def holds(exact: list[tuple[float, float]], game: Any, key: str) -> bool:
    """Whether bounds reach the exact ones, and exceed them by the rounding of float32 only."""
    found = row(game, key)
    assert found == [pytest.approx(ends, rel=1e-6) for ends in exact]
    return all(low <= least and most <= high for (low, high), (least, most) in zip(found, exact, strict=True))


def test_bounds_are_the_numbers_of_the_scenario() -> None:
    """By the rules: a room of 25 m; 4 agents in 2 teams; heals of 75; radii of the zone up to 12.5 m."""
    free, place, bit, ffa_1 = (-INF, INF), (-12.5, 12.5), (0, 1), variant("ffa_1")
    own = [(0, 3), bit, free, place, place, *[free] * 4]
    assert row("teams_3", "own") == row("teams_3", "others") == own
    assert row(variant("teams_3").roles(a=outlast.role(1), b=outlast.role(3)), "own") == [*own, bit, bit]
    assert row("ffa_1", "own") == [bit, free, place, place, *[free] * 4]
    assert row(ffa_1.replace(mortality_limit=120), "own")[1] == (-INF, 120)
    assert row(ffa_1.replace(room_walls=False), "own")[2:4] == [free, free]
    assert row("ffa_1", "heals_mask")[0] == bit
    assert row("ffa_1", "heal_slot") == [(0, 75)]
    assert holds([place, place, (0, 12.5)] * 2, "ffa_1", "zone")
    assert holds([(-13, 13)] * 2, "ffa_1", "heals")  # scattered by 0.5 m at most
    assert holds([(-14.5, 14.5)] * 2, ffa_1.with_(DropLast(offset=2.0)), "heals")
    corner = [(-4.8, 4.8), (-7.2, 7.2)] * 4  # half of 1 + 8.6 * 1, half of 1.5 + 8.6 * 1.5
    boxes = variant("ffa_3").replace(boxes_offset=0.75)
    assert holds([*corner, *[(-13.25, 13.25)] * 2, free], boxes, "boxes")
    assert holds([*corner, *[(-13.25, 13.25)] * 2], boxes, "box_items")
    assert holds(corner, boxes, "box_slot")
    thing, place = [bit, (-1, 1)], (-3, 3)
    assert row(HIDE_2V2, "own") == [(0, 3), bit, place, place, *[free] * 4, (0, 12), bit, (0, 96)]
    assert row(HIDE_2V2, "lidar") == [(0, 6)] * 30
    assert row(HIDE_2V2, "ramps") == [place, place, *[free] * 4, *thing]
    assert row(HIDE_2V2, "crates") == [place, place, *[free] * 6, *thing]  # and two sides


def test_a_single_value_leaves_room_for_another_one() -> None:
    """Or wrappers that rescale would divide by 0."""
    scenario = variant("ffa_1").replace(n_agents=1, heals_amount=0)
    assert row(scenario, "own")[0] == (0, 1)
    assert row(scenario, "heal_slot") == [(0, 1)]


def said(key: str, ends: Any) -> Scenario:
    return variant("ffa_1").with_(mechanic("Said", bounds=lambda self, layout: {key: ends}))


def test_of_what_several_modules_say_the_widest_counts() -> None:
    assert row(said("heal_slot", {"amount": (-5, 20)}), "heal_slot") == [(-5, 75)]
    assert row(said("heal_slot", {"amount": (0, 200)}), "heal_slot") == [(0, 200)]
    assert row(said("heals_mask", (-5, 5)), "heals_mask")[0] == (0, 1)
    assert row(said("boxes", {"x": (0, 1)}), "own") == row("ffa_1", "own")  # which are left out here
    further = said("own", {"x": (-20, 1)})
    assert row(further, "own")[2:4] == row(further, "others")[2:4] == [(-20, 12.5), (-12.5, 12.5)]
    narrow = [(-5, 5) if k == 7 else pair for k, pair in enumerate(row("ffa_1", "own"))]
    assert row(said("own", {"omega": (-5, 5)}), "own") == narrow


def test_bounds_that_cannot_be_are_refused() -> None:
    for key, ends, words in (
        ("others_mask", ([0, 0, 0], 1), r"of 'others_mask' do not fit its shape \(2, 1\)"),
        ("heals", {"x": ([0, 0], 1)}, r"of 'x' in 'heals' do not fit its shape \(2, 15, 1\)"),
        ("own", {"x": (1, 0)}, "of 'x' in 'own' have a low end above the high one"),
        ("own", (0, 1), r"of 'own' are \(0, 1\): {field: \(low, high\)} is needed; its fields are id, health, x"),
        ("zone", {"z": (0, 1)}, "of 'zone' have no field 'z' to be of; there are: x, y, radius"),
    ):
        with pytest.raises(DeclarationError, match=r"said.bounds\(\) " + words):
            make_vec(said(key, ends), 1)
