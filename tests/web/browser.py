"""A screen: pages in a Chromium that is installed, and the truth to compare them with. The tests of pages use it."""

import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.components import Bag, Body, Death, Health, Zone
from outlast.ecs import Clock, Entity
from outlast.envs.web.replay import write_page
from tests.conftest import COMPILED
from tests.web.test_page import ticks

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)

STEPS = 600
WORLDS = (0, 2)
TITLE = "</title></script><img src=x onerror=alert(1)> & more"


def environment() -> Any:
    return outlast.make_vec("teams_3", 3, seed=1)


@pytest.fixture(scope="module")
def file(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("page") / "page.html"
    env = environment()
    write_page(target, env.worlds, ticks(env, STEPS), WORLDS, title=TITLE)
    return target


@dataclass
class Truth:
    """What the same rollout, run again, holds after each tick of world `w`."""

    w: int
    states: dict[tuple[int, int], dict[str, Any]] = field(default_factory=dict)  # by (episode, tick)
    kills: list[tuple[int, int]] = field(default_factory=list)

    def note(self, worlds: Any) -> None:
        w, alive, body = self.w, worlds[Entity].alive, worlds[Body]
        clock = int(worlds[Clock].episode[w, 0]), int(worlds[Clock].tick[w, 0])
        kinds = {row: kind for kind, span in worlds.layout.spans.items() for row in span}
        bags = [[kinds[e] for e in worlds[Bag].items[w, i, : worlds[Bag].count[w, i]]] for i in range(4)]
        names = {"heal": "heal", "box_item": "box"}
        self.states[clock] = {
            "tick": clock[1],
            "alive": int(alive[w, :4].sum()),
            "health": [int(p) if alive[w, i] else 0 for i, p in enumerate(worlds[Health].points[w, :4])],
            "bags": [[names[kind] for kind in bag] for bag in bags],
            "heals": int(alive[w, worlds.span("heal")].sum()),
            "boxes": int(alive[w, worlds.span("box")].sum()),
            "zone": float(worlds[Zone].radius[w, 0]),
            "places": [(float(body.x[w, i]), float(body.y[w, i]), float(body.angle[w, i])) for i in range(4)],
            "living": [bool(alive[w, i]) for i in range(4)],
        }
        if clock[1] and (worlds[Death].now[w, :4] * (worlds[Death].source[w, :4] >= 0)).any():
            self.kills.append(clock)


@pytest.fixture(scope="module")
def truths(browser: Any) -> dict[int, Truth]:
    env, truths = environment(), {w: Truth(w) for w in WORLDS}
    for _ in ticks(env, STEPS):
        for truth in truths.values():
            truth.note(env.worlds)
    return truths


@pytest.fixture(scope="module")  # while it is open, an event loop runs that other tests may not want
def browser() -> Iterator[Any]:
    if not COMPILED:
        pytest.skip("what a browser shows does not depend on how kernels run, and takes minutes with slow ones")
    sync_api = pytest.importorskip("playwright.sync_api", reason="pages are looked at with playwright")
    if BROWSER is None:
        pytest.skip("no Chromium is installed")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=BROWSER, args=["--no-sandbox"])
        yield launched
        launched.close()


@dataclass
class Screen:
    """A page that is open, and what it complained of and asked for."""

    page: Any
    complaints: list[str]
    requests: list[str]

    def number(self, name: str) -> int:
        return int(self.page.locator(f"#{name}").inner_text())

    def shown(self) -> dict[str, Any]:
        """The numbers on the page."""
        cards = self.page.locator(".agent").all()
        labels = [card.get_attribute("aria-label") for card in cards]
        items = self.page.locator
        return {
            "tick": self.number("tick"),
            "alive": self.number("alive"),
            "health": [int(card.locator(".points").inner_text()) for card in cards],
            "bags": [[sign_name(s) for s in card.locator(".sign").all()] for card in cards],
            "heals": int(items("[data-role=heal]").inner_text()),
            "boxes": int(items("[data-role=box]").inner_text()),
            "zone": items("#zone").inner_text(),
            "labels": labels,
        }

    def key(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)
        self.settle()

    def settle(self) -> None:
        """Two frames later everything has been painted."""
        self.page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def wait(self, condition: str) -> None:
        """Until a JavaScript expression is true. The page's own policy keeps playwright from polling it."""
        deadline = time.monotonic() + 10
        while not self.page.evaluate(f"!!({condition})"):
            assert time.monotonic() < deadline, condition
            self.settle()

    def seek(self, row: int) -> None:
        self.page.evaluate(f"outlast.pause(); outlast.seek({row})")
        self.settle()

    def picture(self) -> bytes:
        self.settle()
        taken: bytes = self.page.locator("#stage").screenshot()
        return taken


def sign_name(sign: Any) -> str:
    return str(sign.get_attribute("title")).split(",")[0]


@pytest.fixture
def look(browser: Any, file: Path) -> Iterator[Any]:
    """Opens the page: look(**options of the browser's context) -> Screen, which must have nothing to complain of."""
    screens: list[tuple[Screen, Any]] = []

    def opened(path: Path = file, **options: Any) -> Screen:
        options = {"viewport": {"width": 1400, "height": 900}, "reduced_motion": "reduce", "offline": True} | options
        context = browser.new_context(**options)
        screen = Screen(context.new_page(), [], [])
        screen.page.on("console", lambda message: screen.complaints.append(message.text))
        screen.page.on("pageerror", lambda error: screen.complaints.append(str(error)))
        screen.page.on("request", lambda request: screen.requests.append(request.url))
        screen.page.goto(path.as_uri())
        screen.wait("window.outlast")
        screen.settle()
        screens.append((screen, context))
        return screen

    yield opened
    for screen, context in screens:
        context.close()
        assert not screen.complaints
        assert {url.split(":")[0] for url in screen.requests} == {"file"}
        assert len(screen.requests) == 1
