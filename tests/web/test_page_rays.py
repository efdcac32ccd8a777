"""Rays of lidar: what pages, pictures and text show of them is what agents observe."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.drawing import LidarLayer, RoomLayer
from outlast.envs.rendering import style as colors
from outlast.envs.rendering.rgb import draw
from outlast.envs.web.observation_text import observation_text
from outlast.envs.web.pages import METRE, columns, write_page
from outlast.envs.web.world_json import describe, snapshot
from outlast.systems import Lidar, Maze, Preparation
from tests.web.browser import ticks

SIZE = 512
NEAR = outlast.role(1, lidar_depth=3.0, lidar_angle=2.0, agents_radius=0.4)
SCENARIO = (
    outlast.variant("teams_3").with_(Maze(), Lidar(rays=9, targets="solids")).roles(near=NEAR, far=outlast.role())
)


def test_descriptions_and_snapshots_have_the_rays_that_agents_observe() -> None:
    env = outlast.make_vec(SCENARIO, 1, seed=1)
    for _ in range(30):
        observations, _ = env.reset()
        description, now = describe(env.worlds, 0), snapshot(env.worlds, 0)
        assert description["rays"] == 9
        for i, agent in enumerate(now["agents"]):
            np.testing.assert_allclose(agent["rays"], observations["lidar"][0, i], atol=1e-4)
            bearings = np.arctan2(*np.array(description["agents"][i]["rays"]).T[::-1])
            np.testing.assert_allclose(bearings, (2.0, 2 * np.pi)[i > 0] * (np.arange(-4, 5) / 9), atol=1e-3)
        read = np.rint(METRE * observations["lidar"][0]).ravel()
        packed = np.array(columns(description, now)["agent.rays"])
        assert abs(packed[:, None] - read).min(0).max() <= 1


@pytest.mark.nightly
def test_the_page_draws_rays_when_asked_to(look: Any, tmp_path: Path) -> None:
    env = outlast.make_vec(SCENARIO, 1, seed=1)
    write_page(tmp_path / "page.html", env.worlds, ticks(env, 5), [0], title="")
    screen = look(tmp_path / "page.html")
    button = screen.page.locator("[data-view=rays]")
    before = screen.picture()
    assert button.get_attribute("aria-pressed") == "false"
    screen.key("r")
    assert button.get_attribute("aria-pressed") == "true"
    assert screen.picture() != before
    button.click()
    assert screen.picture() == before
    assert look().page.locator("[data-view=rays]").is_hidden()


def test_pictures_have_a_line_along_each_ray() -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Lidar(rays=5, depth=30.0, angle=2.0)), 1, seed=1)
    observations, _ = env.reset()
    image = draw(env.worlds, 0, SIZE, [RoomLayer(), LidarLayer(agents=[0])])
    body, half = env.worlds[Body], colors.SIZES.margin * 12.5

    def spot(k: int, far: float) -> tuple[int, ...]:
        bearing = float(body.angle[0, 0]) + 2.0 * (k - 2) / 5
        x, y = body.x[0, 0] + far * np.cos(bearing), body.y[0, 0] + far * np.sin(bearing)
        column, row = (int(SIZE * (0.5 + length / (2 * half))) for length in (x, -y))
        return tuple(image[row, column].tolist())

    for k, far in enumerate(observations["lidar"][0, 0].tolist()):
        inks = [spot(k, share * far) for share in (0.3, 0.6, 0.9)]
        assert all(ink[2] > ink[0] + 30 for ink in inks), inks
        assert spot(k, far + 0.5) != colors.BLUE
    assert (
        draw(env.worlds, 0, SIZE, [RoomLayer(), LidarLayer(agents=[])]) == draw(env.worlds, 0, SIZE, [RoomLayer()])
    ).all()


def test_the_text_tells_distances() -> None:
    env = outlast.make_vec(SCENARIO.with_(Preparation(ticks=2, sides=(1,), blind=True)), 1, seed=1)
    observations, _ = env.reset()
    texts = [observation_text({key: rows[0, i] for key, rows in observations.items()}, env.fields) for i in range(4)]
    words = " ".join(f"{distance:.1f}" for distance in observations["lidar"][0, 0])
    assert texts[0]["Lidar"] == [f"{words} m, from right to left"]
    assert texts[3]["Lidar"] == ["blind"]
    env = outlast.make_vec(SCENARIO.replace(lidar_rays=50), 1, seed=1)
    observations, _ = env.reset()
    text = observation_text({key: rows[0, 1] for key, rows in observations.items()}, env.fields)
    shortest, longest = observations["lidar"][0, 1].min(), observations["lidar"][0, 1].max()
    assert text["Lidar"] == [f"{shortest:.1f} to {longest:.1f} m along 50 rays"]
