"""The page of outlast watch: who can reach it, what it plays, and how it goes on to the next episode."""

import base64
import json
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

import outlast
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.policies import scripted_policy
from outlast.envs.web.pages import PageRoom, pack, record_ticks
from outlast.envs.web.server import PATIENCE, serving
from tests.web.browser import TITLE, listen, wait
from tests.web.clients import answer

FIGURES = [
    {"group": "speed", "name": "collecting", "text": "90.1k/s", "points": None},
    {"group": "episodes", "name": "length", "text": "812", "points": [[1000, 300.0], [2000, 500.0], [4000, 812.0]]},
    {"group": "episodes", "name": "kills", "text": "0.00", "points": [[1000, 0.0], [2000, 0.0]]},
    {"group": "wins", "name": "scripted", "text": "12 % (310)", "points": [[1000, 0.12]]},
    {"group": "learning", "name": "KL", "text": "0.0113", "points": None},
]


class Run:
    """A run that does what a test says."""

    def __init__(self) -> None:
        self.message, self.figures = "", FIGURES
        self.newest: dict[str, Any] | None = None
        self.made: dict[str, Any] | None = None
        self.asked: list[str] = []

    def status(self) -> dict[str, Any]:
        self.asked.append("status")
        made = self.made and {key: self.made[key] for key in ("number", "steps")}
        return {"message": self.message, "newest": self.newest, "episode": made, "figures": self.figures}

    def episode(self) -> dict[str, Any] | None:
        self.asked.append("episode")
        return self.made

    def make(self, number: int, steps: int, length: int = 12, whole: bool = True) -> None:
        """An episode of a checkpoint of so many steps is there, or its first `length` ticks."""
        env = outlast.make_vec("ffa_2", 1, seed=number)
        data = pack([PageRoom("", record_ticks(env.worlds, ticks(env, scripted_policy(env), length), [0]))])
        self.newest = {"steps": steps, "age": 200.0}
        encoded = base64.b64encode(data).decode()
        known = {"number": number, "steps": steps, "game": "ffa_2", "data": encoded}
        self.made = known | {"ticks": length + 1, "whole": whole}


@pytest.fixture
def run() -> Run:
    return Run()


@pytest.fixture
def place(run: Run) -> Iterator[str]:
    with serving(TITLE, {"status": lambda: run.status(), "episode": run.episode}) as address:
        yield address


# ---- the server


def test_the_page_and_its_data_are_served_with_strict_headers(place: str, run: Run) -> None:
    assert json.loads(answer(place, urlsplit(place).path + "episode.json")[2]) is None
    run.make(3, 2048)
    kinds = {"": "text/html", "status.json": "application/json", "episode.json": "application/json"}
    bodies = {}
    for name, kind in kinds.items():
        status, headers, bodies[name] = answer(place, urlsplit(place).path + name)
        assert (status, headers["Content-Type"]) == (200, f"{kind}; charset=utf-8")
        assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
        assert (headers["X-Content-Type-Options"], headers["X-Frame-Options"]) == ("nosniff", "DENY")
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    page = bodies[""].decode()
    assert "connect-src 'self'" in page
    assert "default-src 'none'" in page
    assert TITLE not in page
    assert json.loads(bodies["status.json"])["figures"] == FIGURES
    assert json.loads(bodies["episode.json"]) == run.made


def test_only_what_is_served_is_served_and_only_read(place: str, run: Run) -> None:
    token = urlsplit(place).path.rstrip("/")
    assert answer(place)[0] == 200
    for path in (token, "/", "/status.json", f"/{token[:0:-1]}/status.json", f"http://127.0.0.1/{token}/"):
        assert answer(place, path)[0] == 403, path
    others = "../status.json ../../../etc/passwd %2e%2e/log.csv log.csv /etc/passwd watch.js status.json?x=1"
    for path in others.split():
        assert answer(place, f"{token}/{path}")[0] == 404, path
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT"):
        assert answer(place, method=method)[0] == 405
    assert not run.asked


def test_a_client_that_says_nothing_holds_up_nobody(place: str) -> None:
    with socket.create_connection(("127.0.0.1", urlsplit(place).port)):
        begun = time.monotonic()
        assert answer(place)[0] == 200
        assert time.monotonic() - begun < PATIENCE / 2


def test_an_error_is_logged_once_although_pages_repeat_their_requests(
    place: str, run: Run, caplog: pytest.LogCaptureFixture
) -> None:
    run.status = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]
    for _ in range(3):
        assert answer(place, urlsplit(place).path + "status.json")[0] == 500
    assert [record.message for record in caplog.records] == ["a request failed"]
    assert "ZeroDivisionError" in caplog.text


# ---- the page


@pytest.fixture
def opened(browser: Any, place: str) -> Iterator[Callable[..., Any]]:
    """Opens the page: opened(**options of the context). It must log nothing and reach no other host."""
    contexts, heard = [], []

    def look(**options: Any) -> Any:
        context = browser.new_context(**({"viewport": {"width": 1400, "height": 900}} | options))
        contexts.append(context)
        page = context.new_page()
        heard.append(listen(page))
        page.goto(place)
        return page

    yield look
    for context in contexts:
        context.close()
    for complaints, contacted in heard:
        assert complaints == []
        assert {urlsplit(url).netloc for url in contacted} - {""} == {urlsplit(place).netloc}


def shown(page: Any) -> str:
    return str(page.inner_text(".checkpoint"))


def test_it_waits_and_then_plays(opened: Any, run: Run) -> None:
    run.message = "There is no checkpoint in <b>runs</b> yet."
    page = opened()
    page.wait_for_selector("#message:visible")
    assert page.inner_text("#message") == run.message
    assert page.is_visible(".empty")
    assert page.is_hidden("footer")
    run.message = ""
    run.make(1, 1_024_000, length=400)
    wait(page, "window.outlast && outlast.state.playing && outlast.state.at > 1")
    assert shown(page).split() == ["1,024,000", "agent-steps", "saved", "3", "min", "ago"]
    assert page.is_hidden("#message")
    assert page.is_hidden(".empty")
    assert page.inner_text("h1") == f"ffa_2: {TITLE}"


@pytest.mark.parametrize("motion", ["no-preference", "reduce"])
def test_the_first_episode_is_shown_from_its_first_tick_and_goes_on(opened: Any, run: Run, motion: str) -> None:
    run.make(1, 1024, length=0, whole=False)
    page = opened(reduced_motion=motion)
    wait(page, "window.outlast")
    assert page.is_hidden(".empty")
    assert page.inner_text("#length") == "0"
    page.keyboard.type("---")  # so slow that no end is reached
    run.make(1, 1024, length=90, whole=False)
    wait(page, "document.querySelector('#length').textContent === '90'")
    if motion == "reduce":  # nothing moves by itself
        assert not page.evaluate("outlast.state.playing")
        page.keyboard.press(" ")
    wait(page, "outlast.state.playing && outlast.state.at > 1")
    run.make(1, 1024, length=180)
    wait(page, "document.querySelector('#length').textContent === '180'")
    assert page.evaluate("outlast.state.playing && outlast.state.at") > 1  # it went on where it was
    page.keyboard.press(" ")
    page.wait_for_timeout(100)
    assert not page.evaluate("outlast.state.playing")


@pytest.mark.nightly
def test_the_numbers_of_the_run_are_beside_it(opened: Any, run: Run) -> None:
    run.make(1, 1024)
    page = opened()
    page.wait_for_selector(".charts div")
    cells = [(cell.inner_text().split("\n"), cell.locator("svg").count()) for cell in page.locator(".charts div").all()]
    assert cells == [(["length", "812"], 1), (["kills", "0.00"], 1), (["wins v scripted", "12 % (310)"], 0)]
    assert page.inner_text(".numbers") == "collecting 90.1k/s · KL 0.0113"
    first = page.locator(".charts svg").nth(0)
    assert first.get_attribute("aria-label") == "300 to 812, from 1,000 to 4,000 agent-steps"
    drawn = [tuple(map(float, point.split(","))) for point in first.locator("polyline").get_attribute("points").split()]
    assert [x for x, _ in drawn] == [0, 33.3, 100]
    assert drawn[0][1] > drawn[1][1] > drawn[2][1] == 1
    run.figures = [{**FIGURES[1], "text": "900"}]
    wait(page, "document.querySelectorAll('.charts div').length === 1")
    assert page.inner_text(".charts dd") == "900"


@pytest.mark.nightly
def test_at_the_end_of_an_episode_the_newest_one_is_played_or_offered(opened: Any, run: Run) -> None:
    run.make(1, 1024, length=40)
    page = opened()
    wait(page, "window.outlast")
    page.evaluate("outlast.follow(1)")
    page.keyboard.press("v")
    run.make(2, 2048, length=60)
    page.wait_for_timeout(200)
    assert page.inner_text("#length") == "40"  # the running episode goes on
    wait(page, "document.querySelector('#length').textContent === '60'")
    assert shown(page).startswith("2,048 agent-steps")
    assert page.evaluate("outlast.state.playing")
    assert page.evaluate("outlast.state.follow") == 1
    assert page.get_attribute("[data-view=cones]", "aria-pressed") == "false"
    page.keyboard.press("End")  # which stops it
    page.keyboard.press("ArrowLeft")
    run.make(3, 4096, length=40)
    page.wait_for_selector(".run > button:visible")
    assert "newest: 4,096 agent-steps, 3 min ago" in shown(page)
    assert page.inner_text("#length") == "60"
    page.click(".run > button")
    wait(page, "document.querySelector('#length').textContent === '40'")
    assert page.is_hidden(".run > button")


@pytest.mark.nightly
def test_a_server_that_has_ended_is_reported_and_the_episode_goes_on(browser: Any, run: Run) -> None:
    run.make(1, 1024, length=20)
    with browser.new_context() as context:
        with serving(TITLE, {"status": lambda: run.status(), "episode": run.episode}) as address:
            page = context.new_page()
            page.goto(address)
            wait(page, "window.outlast")
        page.wait_for_selector("#message:visible")
        assert page.inner_text("#message") == "There is no answer: is outlast watch still running?"
        wait(page, "outlast.atEnd()")
        wait(page, "outlast.state.playing")
