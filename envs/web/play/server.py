"""The server: the page over HTTP and the game over a websocket, at the same port."""

import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from http import HTTPStatus
from string import Template
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from ..assets import ICON, SHARED, STYLE, asset, constants
from ..gate import LIVE, REFUSED, Gate, Site, listening
from .game import Game
from .messages import LONGEST, SPEEDS
from .session import Session

SCRIPTS = (*SHARED, "keys.js", "visible.js", "play.js")
STYLES = (STYLE, "play.css")
KINDS = {"html": "text/html", "css": "text/css", "js": "text/javascript"}
CLOSE_TIMEOUT = 2  # seconds that a page has to answer when its websocket is closed
LOG = logging.getLogger(__name__)
# keep errors in the session: others come from browsers, which open spare connections and drop them
LOG.addFilter(lambda record: record.msg == "connection handler failed")
LIMITS: dict[str, Any] = {"max_size": LONGEST, "max_queue": 16, "close_timeout": CLOSE_TIMEOUT, "logger": LOG}
LIMITS |= {"compression": None, "server_header": None}


async def play(
    game: Game, fps: float, site: Site | None = None, opened: Callable[[str], object] = lambda address: None
) -> None:
    """Serve `game` at a site until cancelled; `opened` is called with the address.

    fps: ticks per second. Raises PlayError if the site is not available.
    """
    session = Session(game, fps)
    async with answering(session, site or Site()) as gate:
        opened(gate.address)
        await session.run()


@asynccontextmanager
async def answering(session: Session, site: Site) -> AsyncIterator[Gate]:
    """Answer requests for `session` until the context ends; then all sockets are closed."""
    parts = _parts()
    with listening(site) as (listener, gate):

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            """Return the answer to a request; None to go on with the handshake of a websocket."""
            path = gate.path(request)
            if path is None:
                return _answered(connection, HTTPStatus.FORBIDDEN, REFUSED)
            # older versions of websockets have no `method`: they only accept GET
            if getattr(request, "method", "GET") != "GET":
                headers = gate.headers() | {"Allow": "GET"}
                return _answered(connection, HTTPStatus.METHOD_NOT_ALLOWED, "GET only.\n", **headers)
            if path == LIVE:
                return None
            name = path or "index.html"
            if name not in parts:
                return _answered(connection, HTTPStatus.NOT_FOUND, "This file does not exist.\n", **gate.headers())
            return _answered(connection, HTTPStatus.OK, parts[name], KINDS[name.rpartition(".")[2]], **gate.headers())

        async with serve(session.serve_page, sock=listener, process_request=answer, **LIMITS):
            yield gate


def _parts() -> dict[str, str]:
    """Return the page's files by name; index.html is the page."""
    parts = {name: asset("play", name) for name in STYLES} | {"constants.js": constants(SPEEDS=SPEEDS)}
    parts |= {name: f'"use strict";\n{asset("play", name)}' for name in SCRIPTS}
    tags = (f'<script src="{name}"></script>' for name in ("constants.js", *SCRIPTS))
    parts["index.html"] = Template(asset("play", "play.html")).substitute(icon=ICON, scripts="\n".join(tags))
    return parts


def _answered(
    connection: ServerConnection, status: HTTPStatus, text: str, kind: str = "text/plain", **extra: str
) -> Response:
    """Return an answer after which the connection is closed. extra: more headers."""
    found = connection.respond(status, text)
    del found.headers["Content-Type"]
    found.headers.update({"Content-Type": f"{kind}; charset=utf-8", **extra})
    return found
