"""What was measured on the authors' own implementation ([M] in the reference rules): trajectories, motion and sight."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast.ecs import Entity
from tests.helpers.scenario_builder import CORNERS, ScenarioBuilder

CHECKS = json.loads((Path(__file__).parents[1] / "data" / "check-values.json").read_text())
FREE = ("forward", "left_at_45deg", "random_motion")  # nothing touches anything
FREE_TOLERANCE, CONTACT_TOLERANCE = 2e-4, 2e-2
WIDE = {"room_size": 8000.0, "safe_zone_damage": 0}  # where no agent meets a wall


def perform(game: ScenarioBuilder, check: dict[str, Any]) -> list[tuple[int, list[list[float]]]]:
    """Play a check's script; (step, states of both agents) at each step that it lists."""
    script = check["actions"]
    actions = script if isinstance(script, list) else [script["every_step"]] * script["n"]
    listed = {row[0] for row in states(check)}
    found = [(0, [game.state(0), game.state(1)])]
    for number, action in enumerate(actions, 1):
        game.env.step(np.array(action)[None])
        if number in listed:
            found.append((number, [game.state(0), game.state(1)]))
    return found


def states(check: dict[str, Any]) -> list[Any]:
    return next(value for key, value in check.items() if key.startswith("states"))


@pytest.mark.parametrize("name", CHECKS)
def test_trajectories_of_the_original(name: str) -> None:
    check, game = CHECKS[name], ScenarioBuilder()
    for agent, (x, y, angle) in enumerate(check["initial_xyθ"]):
        game.put("agent", agent, x, y, angle)
    for k, (x, y, *size) in enumerate(check["boxes_cx_cy_w_h"] or []):
        game.put("box", k, x, y, size=size)
    if name == "place_box":
        game.put("box", 0, 9, 9, size=(1, 1.5))
        game.column(Entity).alive[0, game.row("box", 0)] = 0
        game.hand(0, "box_item", 0)
    tolerance = FREE_TOLERANCE if name in FREE else CONTACT_TOLERANCE
    found = perform(game, check)
    assert len(found) == len(states(check)) > 4
    for (step, got), (number, *want) in zip(found, states(check), strict=True):
        assert step == number
        np.testing.assert_allclose(got, want, atol=tolerance, err_msg=f"step {step}")


def test_the_first_step_of_full_thrust() -> None:
    """The old form of damping: the newer one would give 0.30999."""
    x, _, _, vx, _, omega = ScenarioBuilder().step({0: "ahead turn"}).state(0)
    assert (vx, omega) == pytest.approx((0.30988, 0.12395), abs=5e-6)
    assert x - CORNERS[0][0] == pytest.approx(0.0104, abs=5e-5)


def test_terminal_speed() -> None:
    game = ScenarioBuilder(**WIDE)
    game.put("agent", 0, -3900, 0)
    game.put("agent", 1, -3900, 50)
    game.step({0: "ahead", 1: "turn"}, 200)
    assert game.state(1)[5] == pytest.approx(4.659, abs=2e-3)  # the curve is at 4.6576
    game.step({0: "ahead"}, 100)
    assert game.state(0)[3] == pytest.approx(11.695, abs=1e-3)


def test_agents_rest_against_each_other_at_almost_their_diameter() -> None:
    game = ScenarioBuilder()
    game.put("agent", 0, -1, 0)
    game.put("agent", 1, 1, 0, math.pi)
    game.step({0: "ahead", 1: "ahead"}, 60)
    assert game.state(1)[0] - game.state(0)[0] == pytest.approx(0.995, abs=3e-3)


def test_a_placed_box_pushes_its_user_out_at_once() -> None:
    game = ScenarioBuilder()
    game.put("agent", 0, 0, 0, 1.0)
    game.put("box", 0, 9, 9, size=(1, 1.5))
    game.column(Entity).alive[0, game.row("box", 0)] = 0
    game.hand(0, "box_item", 0)
    game.step({0: "use"})
    assert game.state(0)[0] == pytest.approx(-0.60, abs=5e-3)
    assert game.place("box", 0) == pytest.approx((0.75 * math.cos(1), 0.75 * math.sin(1)), abs=1e-6)


@pytest.mark.parametrize(("degrees", "depth"), [(0, 10), (18, 9.51), (-18, 9.51), (35.9, 9.99)])
def test_the_cone_of_the_runs_is_a_kite(degrees: float, depth: float) -> None:
    """Its far sides are chords: between the axis and the edge it is 9.51 deep."""
    for far, seen in ((depth - 0.02, 1), (depth + 0.02, 0)):
        game = ScenarioBuilder()
        game.put("agent", 0, -7, -7, math.radians(45 - degrees))
        game.put("agent", 1, -7 + far * math.sqrt(0.5), -7 + far * math.sqrt(0.5))
        assert game.step().sees(0, "others") == [seen]


def test_agents_exactly_on_the_edge_of_the_cone_are_seen() -> None:
    game = ScenarioBuilder(cameras_fov=math.pi / 2)
    game.put("agent", 0, 0, 0)
    for place, seen in (((3, 3), 1), ((3, -3), 1), ((10, 0), 1), ((-3, 3), 0), ((3, 3.01), 0), ((10.01, 0), 0)):
        game.put("agent", 1, *place)
        assert game.step().sees(0, "others") == [seen], place
