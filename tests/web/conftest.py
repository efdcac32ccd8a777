"""Fixtures: a browser, a replay page and the truth about it, a game and the address of its server."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.envs.web.game import Game
from outlast.envs.web.pages import write_page
from tests.web.browser import STEPS, TITLE, WORLDS, Screen, Truth, environment, listen, ticks
from tests.web.clients import served

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


@pytest.fixture(scope="module")  # while it is open, an event loop runs that other tests may not want
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="pages are looked at with playwright")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is on the PATH")
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield launched
        launched.close()


@pytest.fixture(scope="module")
def file(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("page") / "page.html"
    env = environment()
    write_page(target, env.worlds, ticks(env, STEPS), WORLDS, title=TITLE)
    return target


@pytest.fixture(scope="module")
def truths(browser: Any) -> dict[int, Truth]:
    env, truths = environment(), {w: Truth(w) for w in WORLDS}
    for _ in ticks(env, STEPS):
        for truth in truths.values():
            truth.note(env.worlds)
    return truths


@pytest.fixture
def look(browser: Any, file: Path) -> Iterator[Any]:
    """Opens the page: look(path, place, **options of the browser's context) -> Screen.

    It must not log or request anything. place: of the address, from # on.
    """
    screens: list[tuple[Screen, Any]] = []

    def opened(path: Path = file, place: str = "", **options: Any) -> Screen:
        options = {"viewport": {"width": 1400, "height": 900}, "reduced_motion": "reduce", "offline": True} | options
        context = browser.new_context(**options)
        page = context.new_page()
        screen = Screen(page, *listen(page))
        screen.page.goto(path.as_uri() + place)
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


@pytest.fixture
def game() -> Iterator[Game]:
    game = Game(outlast.variant("ffa_3"), others="noop", seed=1)
    yield game
    game.close()


@pytest.fixture
def address(game: Game) -> Iterator[str]:
    with served(game) as address:
        yield address
