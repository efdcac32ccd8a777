"""The page in a browser: it plays from a file, and what it shows is what happened."""

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Look
from outlast.ecs import Archetype, Array, Component, Module, column
from outlast.envs.rendering import style
from outlast.envs.web.pages import write_page
from tests.web.browser import Screen, Truth

HALF = style.SIZES.margin * 12.5  # metres from the middle of the canvas to its edge


def check(screen: Screen, truth: Truth, episode: int) -> None:
    """The numbers on the page are those of the simulation at the tick that it shows."""
    shown = screen.shown()
    state = truth.states[episode, shown["tick"]]
    for name in ("alive", "health", "bags", "heals", "boxes"):
        assert shown[name] == state[name], name
    assert shown["zone"] == "gone" if state["zone"] <= 0 else abs(float(shown["zone"]) - state["zone"]) < 0.051
    for i, label in enumerate(shown["labels"]):
        if state["living"][i]:
            carried = ", ".join(state["bags"][i]) or "nothing"
            assert label == f"Agent {i}: {state['health'][i]} hit points, carries {carried}"


# ---- what it shows


def test_every_number_is_that_of_the_simulation(look: Any, truths: dict[int, Truth]) -> None:
    screen, truth = look(), truths[0]
    last = max(tick for episode, tick in truth.states if episode == 1)
    for row in sorted({0, 1, last, *np.linspace(0, last, 24).astype(int).tolist()}):
        screen.seek(row)
        assert screen.number("tick") == row
        check(screen, truth, 1)
    assert screen.number("length") == last


def test_agents_are_where_they_are(look: Any, truths: dict[int, Truth]) -> None:
    screen = look()
    screen.key("v", "z", "h", "b")
    looked_at = 0
    for row in (10, 60, 111):
        screen.seek(row)
        state = truths[0].states[1, row]
        for i, (x, y, angle) in enumerate(state["places"]):
            apart = all(np.hypot(x - a, y - b) > 3.2 for k, (a, b, _) in enumerate(state["places"]) if k != i)
            if not (state["living"][i] and apart):
                continue
            behind = pixel(screen, x - 0.36 * np.cos(angle), y - 0.36 * np.sin(angle))
            assert behind == (style.BLUE if i < 2 else style.VERMILLION), (row, i)
            looked_at += 1
    assert looked_at >= 3


def pixel(screen: Screen, x: float, y: float) -> tuple[int, ...]:
    """The colour of the canvas at a point of the world."""
    image = cv2.imdecode(np.frombuffer(screen.picture(), np.uint8), cv2.IMREAD_COLOR_RGB)
    height, width = image.shape[:2]
    scale = min(height, width) / (2 * HALF)
    return tuple(image[int(height / 2 - y * scale), int(width / 2 + x * scale)].tolist())


class Mark(Component):
    ring: Array = column("u1")
    other: Array = column("i4", fill=-1, unit="entity")


class Marking(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("agent", (Mark(),))]

    def looks(self) -> dict[str, Look]:
        return {"agent": Look(ring=Mark.ring, line_to=Mark.other)}


def test_a_ring_and_a_line_are_drawn_where_looks_name_columns(look: Any, tmp_path: Path) -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Marking()), 1, seed=0)

    def two() -> Iterator[int]:
        env.reset()
        for i, x in enumerate((-3.0, 5.0)):
            env.place("agent", i, x=x, y=1.0, angle=0.0)
        yield 0
        env.step(np.tile(env.noop, (1, 2, 1)))
        env.worlds[Mark].ring[0, 0], env.worlds[Mark].other[0, 0] = 1, 1
        yield 1

    write_page(tmp_path / "page.html", env.worlds, two(), [0], title="")
    screen = look(tmp_path / "page.html")
    screen.key("v", "z", "h", "b")
    for row in (0, 1):
        screen.seek(row)
        for x, y in ((-3.0, 1.5 + 3 * style.SIZES.sight_line), (1.0, 1.0)):  # on the ring, and on the line
            assert (sum(pixel(screen, x, y)) < 200) == (row == 1), (x, row)
        assert sum(pixel(screen, 5.0, 1.5 + 3 * style.SIZES.sight_line)) > 600  # no ring around the other one


def test_a_game_without_hit_points_and_bags_shows_none(look: Any, tmp_path: Path) -> None:
    names = ["FreeForAll", "SpawnGrid", "Steering", "Physics", "Rewards"]
    parts = systems.Agents(count=2), systems.Room(size=8.0), systems.Ending("never", 9)
    game = outlast.Scenario("walk", (*parts, *(getattr(systems, name)() for name in names)))
    env = outlast.make_vec(game, 1, seed=0)
    write_page(tmp_path / "page.html", env.worlds, (env.reset() and 0 for _ in range(1)), [0], title="")
    screen = look(tmp_path / "page.html")
    cards = screen.page.locator(".agent").all()
    assert [card.get_attribute("aria-label") for card in cards] == ["Agent 0: alive", "Agent 1: alive"]
    for part in (".points", ".meter", ".bag"):
        assert not cards[0].locator(part).is_visible(), part
    assert screen.page.locator("[data-view=health]").is_disabled()


@pytest.mark.nightly
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_ground_has_the_colours_of_the_pictures(look: Any, scheme: str) -> None:
    screen = look(color_scheme=scheme)
    screen.key("v")
    assert (pixel(screen, 0.3, 0.3) == style.FLOOR) == (scheme == "light")
    assert (pixel(screen, 12, 12) == style.UNSAFE) == (scheme == "light")
    assert (sum(pixel(screen, 0.3, 0.3)) < 200) == (scheme == "dark")


# ---- time


def test_it_plays_and_pauses(look: Any) -> None:
    screen = look(reduced_motion="no-preference")
    screen.wait("Number(document.getElementById('tick').textContent) > 5")
    screen.key("Space")
    still = screen.number("tick")
    screen.page.wait_for_timeout(150)
    assert screen.number("tick") == still
    screen.page.get_by_role("button", name="Play", exact=True).click()
    screen.wait(f"Number(document.getElementById('tick').textContent) > {still + 3}")
    screen.page.get_by_role("button", name="Pause").click()
    screen.key("End", "Space")  # at the end of an episode the next one begins
    screen.wait("document.getElementById('episode').value === '1'")


def test_speed_and_steps(look: Any) -> None:
    """Where motion is not wanted, nothing moves by itself."""
    screen = look()
    screen.page.wait_for_timeout(150)
    assert screen.number("tick") == 0
    speeds = [screen.page.locator("#speed").inner_text()]
    for key in "++----":
        screen.key(key)
        speeds.append(screen.page.locator("#speed").inner_text())
    assert speeds == ["1×", "2×", "4×", "2×", "1×", "½×", "¼×"]
    screen.key("ArrowRight", "ArrowRight", "ArrowLeft", "ArrowRight", "Shift+ArrowRight")
    assert screen.number("tick") == 32
    screen.page.get_by_role("button", name="Step back").click()
    screen.page.get_by_role("button", name="To the next event").click()
    screen.settle()
    event = screen.page.locator("#events [aria-current]")
    assert int(event.get_attribute("data-at")) == screen.number("tick") > 31
    screen.key("Home", "ArrowLeft")
    assert screen.number("tick") == 0


# ---- what it keeps to itself


def test_the_page_may_not_talk_to_anybody(look: Any) -> None:
    screen = look(offline=False)
    with socket.create_server(("127.0.0.1", 0)) as server:
        refused = screen.page.evaluate(
            """async (address) => {
              const blocked = [];
              document.addEventListener("securitypolicyviolation", (event) => blocked.push(event.effectiveDirective));
              await fetch(address).catch(() => {});
              const image = document.createElement("img"), script = document.createElement("script");
              image.src = `${address}picture.png`;
              script.textContent = "window.injected = true";
              document.body.append(image, script);
              await new Promise((done) => setTimeout(done, 100));
              return [blocked.sort(), window.injected === undefined];
            }""",
            f"http://127.0.0.1:{server.getsockname()[1]}/",
        )
        server.settimeout(0.2)
        with pytest.raises(TimeoutError):
            server.accept()
    assert refused == [["connect-src", "img-src", "script-src-elem"], True]
    screen.complaints.clear()  # they are what the browser says of all this
    del screen.requests[1:]
