"""The server: the page over HTTP, the game over a websocket, at one port of this machine's loopback."""

import json
import logging
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from email.utils import formatdate
from http import HTTPStatus
from importlib.resources import files
from string import Template
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from ...errors import PlayError
from ...rendering.css import themes
from .. import replay as page
from .game import Game
from .gate import HOST, LIVE, Gate
from .messages import LONGEST
from .session import Session

SCRIPTS = ("keys.js", "sight.js", "play.js")
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
PATIENCE = 2  # seconds for a page to say goodbye
REFUSED = "Not from here: open the address that `outlast play` printed.\n"


async def play(game: Game, fps: float, port: int = 0, opened: Callable[[str], object] = lambda address: None) -> None:
    """Serve `game` at `port` of 127.0.0.1 (0: a free one) until cancelled. opened is told the address to open.

    fps: ticks a second. Raises PlayError if the port is not to be had.
    """
    session = Session(game, fps)
    async with listening(session, port) as gate:
        opened(gate.address)
        await session.run()


@asynccontextmanager
async def listening(session: Session, port: int) -> AsyncIterator[Gate]:
    """Answer requests for `session` meanwhile; all sockets are closed at the end."""
    parts = _parts()
    with _socket(port) as listener:
        gate = Gate(listener.getsockname()[1])

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            """None: go on with the handshake of a websocket."""
            path = gate.path(request)
            if path is None:
                return response(HTTPStatus.FORBIDDEN, REFUSED.encode())
            if getattr(request, "method", "GET") != "GET":  # older versions of websockets refuse others themselves
                return response(HTTPStatus.METHOD_NOT_ALLOWED, b"GET only.\n", extra=gate.headers() | {"Allow": "GET"})
            if path == LIVE:
                return None
            name = path or "index.html"
            if name not in parts:
                return response(HTTPStatus.NOT_FOUND, b"There is no such file.\n", extra=gate.headers())
            return response(HTTPStatus.OK, parts[name], KINDS[name.rpartition(".")[2]], gate.headers())

        async with serve(session.attend, sock=listener, process_request=answer, **_limits()):
            yield gate


def _parts() -> dict[str, bytes]:
    """The page's files by name; index.html is the page. What it shares with the replay page comes from there."""
    here, there = files(__package__ or ""), files(page.__name__)
    parts = {name: here.joinpath(name).read_bytes() for name in ("play.css", *SCRIPTS)}
    parts |= {name: there.joinpath(name).read_bytes() for name in ("style.css", *page.DRAWING)}
    parts["colors.js"] = f"const COLORS = {json.dumps(themes())};".encode()
    tags = (f'<script src="{name}"></script>' for name in ("colors.js", *page.DRAWING, *SCRIPTS))
    template = Template(here.joinpath("play.html").read_text("utf-8"))
    return parts | {"index.html": template.substitute(scripts="\n".join(tags)).encode()}


def _socket(port: int) -> socket.socket:
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise PlayError(f"port {port} of {HOST} is not to be had: {error.strerror or error}") from None


def _limits() -> dict[str, Any]:
    log = logging.getLogger(__name__)
    log.addFilter(_is_ours)
    limits = {"max_size": LONGEST, "max_queue": 16, "close_timeout": PATIENCE}
    return limits | {"compression": None, "server_header": None, "logger": log}


def _is_ours(record: logging.LogRecord) -> bool:
    """Whether it tells of an error in the session; browsers that open spare connections and drop them are no news."""
    return record.msg == "connection handler failed"


def response(
    status: HTTPStatus, body: bytes, kind: str = "text/plain", extra: dict[str, str] | None = None
) -> Response:
    """An answer that ends the connection."""
    headers = {
        "Date": formatdate(usegmt=True),
        "Connection": "close",
        "Content-Length": str(len(body)),
        "Content-Type": f"{kind}; charset=utf-8",
    }
    return Response(status, status.phrase, Headers(headers | (extra or {})), body)
