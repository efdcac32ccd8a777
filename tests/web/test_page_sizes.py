"""Pages of many or absent agents, in small windows: nothing is pushed out, and nothing made up."""

from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.envs.core.spaces import present
from outlast.envs.web.pages import write_page
from outlast.systems import SpawnGrid
from tests.web.browser import Screen, ticks

pytestmark = pytest.mark.nightly  # each of them loads a page of its own


def height(screen: Screen, selector: str) -> float:
    return float(screen.page.locator(selector).bounding_box()["height"])


def page_of(path: Path, scenario: outlast.Scenario, steps: int) -> Path:
    env = outlast.make_vec(scenario, 1, seed=0)
    write_page(path, env.worlds, ticks(env, steps), [0], title="one")
    return path


@pytest.mark.parametrize("size", [(390, 844), (736, 780)])
def test_events_are_listed_where_everything_is_in_one_column(look: Any, size: tuple[int, int]) -> None:
    width, tall = size
    screen = look(viewport={"width": width, "height": tall})
    rows = screen.page.locator("#events li").count()
    assert height(screen, "#events") > 20 * min(rows, 8)
    if width > 600:  # the frame of a notebook: what is below the world covers none of it
        stage, footer = (screen.page.locator(name).bounding_box() for name in ("#stage", "footer"))
        assert stage["y"] + stage["height"] <= footer["y"]


def test_a_crowd_leaves_room_for_the_world(look: Any, tmp_path: Path) -> None:
    crowd = outlast.variant("ffa_1").replace(n_agents=160).with_(SpawnGrid(cells=16))
    screen = look(page_of(tmp_path / "crowd.html", crowd, 5), viewport={"width": 1280, "height": 800})
    assert height(screen, "#stage") > 300
    assert screen.page.locator(".agent").count() == 160


def test_absent_agents_cannot_be_followed(look: Any, tmp_path: Path) -> None:
    few = outlast.variant("ffa_1").replace(n_agents=6).vary(n_agents=outlast.distributions.choice(3, 6))
    env, same = (outlast.make_vec(few, 8, seed=0) for _ in range(2))
    same.reset()
    there = present(same.worlds).sum(1).tolist()
    small, whole = there.index(3), there.index(6)
    write_page(tmp_path / "few.html", env.worlds, ticks(env, 20), [small, whole], title="few")
    screen = look(tmp_path / "few.html", f"#tick=0&world={small}&agent=3")
    assert screen.page.locator("#said").inner_text() == "This page does not have agent 3."
    assert screen.page.locator("[aria-pressed=true].agent").count() == 0
    tall = height(screen, "#timeline")
    screen.key("4")
    assert not screen.page.locator("#mind").is_visible()
    screen.key("2")
    assert screen.page.locator("[aria-pressed=true].agent").get_attribute("data-agent") == "2"
    screen.page.locator("#world").select_option("1")
    screen.settle()
    assert height(screen, "#timeline") > tall + 3 * 10  # a strip for each agent that is there
    screen.key("4")
    assert screen.page.locator("[aria-pressed=true].agent").get_attribute("data-agent") == "4"
