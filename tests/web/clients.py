"""Clients of a game's server: what the page's script does, and what others might."""

import asyncio
import contextlib
import http.client
import json
import threading
import time
from urllib.parse import urlsplit

import cv2
import numpy as np
from websockets.sync.client import connect

from outlast.components import Body, Heal, Side
from outlast.ecs import Entity
from outlast.envs.rendering.style import HEAL, of_side
from outlast.envs.web.game import play

FPS = 200
HANDSHAKE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec_WebSocket_Version": "13",
    "Sec_WebSocket_Key": "dGhlIHNhbXBsZSBub25jZQ==",
}


@contextlib.contextmanager
def served(game, fps=FPS, site=None):
    """The address of a server in a thread of its own."""
    addresses, loops = [], []
    up = threading.Event()

    async def run():
        loops.append((asyncio.get_running_loop(), asyncio.current_task()))
        await play(game, fps, site, lambda address: (addresses.append(address), up.set()))

    def background():
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(run())

    thread = threading.Thread(target=background)
    thread.start()
    try:
        assert up.wait(10)
        yield addresses[0]
    finally:
        loop, task = loops[0]
        loop.call_soon_threadsafe(task.cancel)
        thread.join(20)
        assert not thread.is_alive()


class Page:
    """What the page's script does."""

    def __init__(self, address):
        parts = urlsplit(address)
        self.line = connect(f"ws://{parts.netloc}{parts.path}live", origin=f"http://{parts.netloc}")
        self.world = None

    def __enter__(self):
        self.socket = self.line.__enter__()
        return self

    def __exit__(self, *error):
        self.line.__exit__(*error)

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def receive(self):
        """The next state."""
        message = json.loads(self.socket.recv(timeout=10))
        if "world" not in message:
            return message
        self.world = message["world"]
        return self.receive()

    def until(self, condition):
        """The first state for which the condition holds."""
        end = time.monotonic() + 10
        while time.monotonic() < end:
            state = self.receive()
            if condition(state):
                return state
        raise AssertionError("the condition never held")


def answer(address, path=None, method="GET", port=0, **headers):
    """Status of a request. Header names are with _ for -; Host and port are the right ones unless given."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection("127.0.0.1", port or parts.port, timeout=10)
    connection.putrequest(method, parts.path if path is None else path, skip_host=True)
    for name, value in ({"Host": parts.netloc} | headers).items():
        for one in value if isinstance(value, tuple) else (value,):
            connection.putheader(name.replace("_", "-"), one)
    connection.endheaders()
    with contextlib.closing(connection):
        response = connection.getresponse()
        return response.status, dict(response.getheaders()), response.read() if response.status != 101 else b""


def picture(page):
    """What the canvas shows, (height, width, 3) RGB; and nothing that lies over it."""
    page.evaluate("document.querySelector('#card').style.display = 'none'")
    encoded = np.frombuffer(page.locator("#stage").screenshot(), np.uint8)
    return cv2.cvtColor(cv2.imdecode(encoded, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def has(game, image, color, x, y):
    """Whether the picture has this colour at (x, y) metres."""
    height, width = image.shape[:2]
    scale = min(width, height) / (2 * game.world["half"])
    pixel = image[round(height / 2 - scale * y), round(width / 2 + scale * x)].astype(int)
    return bool(np.abs(pixel - color).max() < 12)


def heals_shown(game, image):
    """Whether it shows the heal, by row, of all that lie on the ground."""
    body, alive = game.worlds[Body], game.worlds[Entity].alive[0]
    rows = [row for row in game.worlds.layout.rows(Heal).tolist() if alive[row]]
    return {
        row: has(game, image, HEAL, body.x[0, row] + 0.1, body.y[0, row] + 0.1) for row in rows
    }  # beside its white cross


def enemy_shown(game, image):
    body, row = game.worlds[Body], game.worlds.layout.rows(Side)[1]
    return has(game, image, of_side(1), body.x[0, row] - 0.33, body.y[0, row])  # beside its number
