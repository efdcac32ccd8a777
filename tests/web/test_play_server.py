"""The game's server: messages of pages reach the game, and nothing that comes in ends it."""

import socket
import time
from urllib.parse import urlsplit

import pytest
from websockets.exceptions import ConnectionClosed

from outlast.ecs import Clock
from outlast.envs.web.game import GamePhase
from tests.web.clients import FPS, HANDSHAKE, Page


@pytest.mark.parametrize(
    ("text", "code"),  # RFC 6455: "violates its policy", "too big for it to process"
    [(b"{}", 1008), ('{"command": "quit"}', 1008), ('{"command": "pause"' + 600 * " " + "}", 1009)],
)
def test_malformed_messages_close_their_connection_and_nothing_else(address, text, code):
    with Page(address) as page:
        page.receive()
        page.socket.send(text)
        with pytest.raises(ConnectionClosed) as closed:
            page.until(lambda state: False)
    assert closed.value.rcvd.code == code
    with Page(address) as page:
        page.send(held={"ahead": 1}, tapped={})
        assert page.until(lambda state: state["snapshot"]["tick"] > 2)["steers"]


def test_an_error_in_the_game_is_logged_and_ends_the_page_only(address, game, caplog):
    state = game.state
    game.state = lambda: 1 / 0
    with Page(address) as page, pytest.raises(ConnectionClosed) as closed:
        page.receive()
    assert closed.value.rcvd.code == 1011
    for _ in range(100):  # it is logged once the page has gone
        time.sleep(0.02 * ("ZeroDivisionError" not in caplog.text))
    assert "ZeroDivisionError" in caplog.text
    game.state = state
    with Page(address) as page:
        assert page.receive()["phase"] == "ready"


def test_time_passes_no_faster_than_it_should(address):
    with Page(address) as page:
        page.send(speed=0.25)
        start = time.monotonic()
        page.send(held={"turn": 1}, tapped={})
        page.until(lambda state: state["snapshot"]["tick"] >= 25)
        assert time.monotonic() - start > 23 * 4 / FPS  # 24 pauses, less what clocks are rounded


def test_the_first_page_steers_and_one_that_watches_may_take_over(address, game):
    with Page(address) as first, Page(address) as second, Page(address) as third:
        assert [page.receive()["steers"] for page in (first, second, third)] == [True, False, False]
        third.send(held={"ahead": 1}, tapped={})
        third.send(command="restart")  # which it may not
        time.sleep(0.1)
        assert (game.phase, int(game.worlds[Clock].episode[0, 0])) == (GamePhase.READY, 1)
        first.send(held={"ahead": 1}, tapped={})
        third.until(lambda state: state["snapshot"]["tick"] > 3)
        third.send(command="steer")
        assert third.until(lambda state: state["steers"])["phase"] == "paused"
        assert first.until(lambda state: not state["steers"])["phase"] == "paused"
        assert game.action() == [1, 1, 1, 0, 0, 0]  # the keys of the first page are up
        third.send(command="steer")  # it does already
        third.send(command="resume")
        third.until(lambda state: state["phase"] == "running")
        third.socket.close()
        assert first.until(lambda state: state["steers"])["phase"] == "paused"  # they stay in order
        second.send(command="steer")
        assert second.until(lambda state: state["steers"])["phase"] == "paused"


def test_a_page_that_does_not_listen_holds_nobody_up(address):
    parts = urlsplit(address)
    headers = HANDSHAKE | {"Host": parts.netloc, "Origin": f"http://{parts.netloc}"}
    lines = [f"GET {parts.path}live HTTP/1.1", *(f"{k.replace('_', '-')}: {v}" for k, v in headers.items()), "", ""]
    with Page(address) as page, socket.socket() as deaf:
        page.send(held={"turn": 1}, tapped={})
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", parts.port))
        deaf.sendall("\r\n".join(lines).encode())
        assert page.until(lambda state: state["snapshot"]["tick"] > 90)["phase"] == "running"
