"""Drawn vision cones and the simulation agree on what is seen."""

import math

import numpy as np
import pytest

from outlast.components import Body, Shape, Sight
from outlast.drawing import CamerasLayer
from outlast.ecs import Entity
from outlast.ecs.kernels.simd import SIMD_WIDTH
from outlast.envs.rendering import style as colors
from outlast.envs.rendering.rgb import draw
from tests.helpers.scenario_builder import ScenarioBuilder

SIZE = 1024
HALF = colors.SIZES.margin * 12.5  # metres
PROBES, PROBE = 400, 0.02  # places; metres, the radius of the heal that lies there: float32 still hits it from afar
BORDER = 0.12  # metres around the border of a cone that are not compared: some pixels, and the step between rays


def probed(game: ScenarioBuilder, places: np.ndarray) -> list[bool]:
    """Which of these places agent 0 sees, by a heal that lies there, as the simulation says."""
    body, shape = game.column(Body), game.column(Shape)
    row, seen = game.row("heal", 0), []
    shape.radius[0, row] = shape.bound[0, row] = PROBE
    for x, y in places:
        game.put("heal", 0, x, y)
        before = body.x[0].copy(), body.y[0].copy()
        game.step()
        assert np.array_equal(before, (body.x[0], body.y[0]))  # the picture is of where all stand still
        seen.append(bool(game.column(Sight).visible[0, 0][row // SIMD_WIDTH] >> row % SIMD_WIDTH & 1))
    game.column(Entity).alive[0, row] = 0
    return seen


def covered(game: ScenarioBuilder) -> np.ndarray:
    cone = [CamerasLayer(agents=[0], lines=False, opacity=0.9)]
    return (draw(game.env.worlds, 0, SIZE, cone) != draw(game.env.worlds, 0, SIZE, [])).any(-1)


@pytest.mark.parametrize("cone", ["kite", "sector"])
@pytest.mark.parametrize("occlude", [True, False])
def test_what_is_in_the_drawn_cone_is_what_the_simulation_sees(cone: str, occlude: bool) -> None:
    """Boxes, another agent, items and the walls hide; a place is compared unless it lies on the cone's border."""
    game = ScenarioBuilder(
        "ffa_4", n_heals=10, cameras_cone=cone, cameras_items_occlude=occlude, safe_zone_damage=0, pickup_reach=0.001
    )
    game.put("agent", 0, -3, -2, 0.4)
    game.put("agent", 1, 1.5, -1.5, 2.0)
    game.put("box", 0, 0.5, 1.5, 0.7, size=(2, 0.5))
    game.put("box", 1, 3.5, 1.5, 0.2, size=(0.6, 1.5))
    game.put("heal", 9, 0.0, 0.2)
    rng = np.random.default_rng(0)
    bearings, far = rng.uniform(-0.8, 0.8, PROBES), rng.uniform(0.7, 11, PROBES)
    places = np.stack([-3 + far * np.cos(0.4 + bearings), -2 + far * np.sin(0.4 + bearings)], 1)
    places = places[(np.abs(places) < 12.3).all(1)]
    drawn, seen = covered(game), probed(game, places)
    reach, compared = math.ceil(BORDER * SIZE / (2 * HALF)), []
    for (x, y), visible in zip(places, seen, strict=True):
        column, row = (int(SIZE * (0.5 + length / (2 * HALF))) for length in (x, -y))
        around = drawn[row - reach : row + reach + 1, column - reach : column + reach + 1]
        if around.all() or not around.any():
            assert bool(around.all()) == visible, (x, y)
            compared.append(visible)
    assert len(compared) > 0.7 * len(places)
    assert 0.2 < np.mean(compared) < 0.8
