"""Servers of live pages over HTTP: of a game, with a websocket at the same port, and of the episodes of a run."""

import asyncio
import contextlib
import functools
import json
import logging
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from .assets import SHARED, STYLE, assemble
from .gate import HEADERS, LIVE, REFUSED, Gate, Listener, Site, listening
from .pages import PACKING, PLAYING
from .world_json import Json

LONGEST = 512  # bytes of a message: more than the longest valid one
PATIENCE, CLOSE_TIMEOUT = 10, 2  # seconds that a request may take to arrive, and a page to close its websocket
FAILED = "a request failed"
LOG = logging.getLogger(__name__)
# keep own errors: others come from browsers, which open spare connections and drop them
LOG.addFilter(lambda record: record.msg in ("connection handler failed", FAILED))
OPTIONS: dict[str, Any] = {"max_size": LONGEST, "max_queue": 16, "compression": None, "server_header": None}
OPTIONS |= {"open_timeout": PATIENCE, "close_timeout": CLOSE_TIMEOUT, "logger": LOG}

Answer = Callable[[], tuple[str, str]]  # returns type and content


@contextlib.asynccontextmanager
async def answering(
    listener: Listener,
    gate: Gate,
    answers: Mapping[str, Answer],
    live: Callable[[ServerConnection], Awaitable[None]] = ServerConnection.close,
) -> AsyncIterator[None]:
    """Answer requests until the context ends; then all sockets are closed.

    answers: By the path after the token; called in other threads. An error is logged, the first of each type, as pages
    repeat their requests.
    live: Serves the websocket of a page until the page leaves; by default, it is closed.
    """
    logged = set[type]()

    async def answer(connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer to a request; None to go on with the handshake of a websocket."""
        path = gate.path(request)
        if path is None:
            return _answered(connection, HTTPStatus.FORBIDDEN, REFUSED)
        # older versions of websockets have no `method`: they only accept GET
        if getattr(request, "method", "GET") != "GET":
            return _answered(connection, HTTPStatus.METHOD_NOT_ALLOWED, "GET only.\n", Allow="GET")
        if path == LIVE:
            return None
        if path not in answers:
            return _answered(connection, HTTPStatus.NOT_FOUND, "This file does not exist.\n")
        try:
            kind, text = await asyncio.to_thread(answers[path])
        except Exception as error:
            if type(error) not in logged:
                logged.add(type(error))
                LOG.exception(FAILED)
            return _answered(connection, HTTPStatus.INTERNAL_SERVER_ERROR, "The server failed.\n")
        return _answered(connection, HTTPStatus.OK, text, kind)

    async with serve(live, sock=listener, process_request=answer, **OPTIONS):
        yield


def _answered(
    connection: ServerConnection, status: HTTPStatus, text: str, kind: str = "text/plain", **more: str
) -> Response:
    """Return an answer after which the connection is closed. more: further headers."""
    found = connection.respond(status, text)
    del found.headers["Content-Type"]
    found.headers.update(HEADERS | {"Content-Type": f"{kind}; charset=utf-8", **more})
    return found


@contextlib.contextmanager
def serving(title: str, sources: Mapping[str, Callable[[], Json | None]], site: Site | None = None) -> Iterator[str]:
    """Serve the page of a run from threads of its own until the context ends, and yield the address to open.

    sources: What watch.js asks for, by its name, see RunWatcher; called in several threads. site: Where the page is
    served; None: at any free port of 127.0.0.1. Raises PlayError if that is not available.
    """
    scripts, styles = (*SHARED, *PLAYING, "watch.js"), (STYLE, "watch.css")
    page = assemble(title, "replay", scripts, styles, connect="'self'", PACKING=PACKING)
    answers: dict[str, Answer] = {"": lambda: ("text/html", page)}
    answers |= {f"{name}.json": functools.partial(_json, source) for name, source in sources.items()}
    loop, stopped = asyncio.new_event_loop(), asyncio.Event()

    async def run(listener: Listener, gate: Gate) -> None:
        async with answering(listener, gate, answers):
            await stopped.wait()

    with listening(site or Site()) as (listener, gate):
        thread = threading.Thread(target=loop.run_until_complete, args=(run(listener, gate),), daemon=True)
        thread.start()
        try:
            yield gate.address
        finally:
            loop.call_soon_threadsafe(stopped.set)
            thread.join()
            loop.close()


def _json(source: Callable[[], Json | None]) -> tuple[str, str]:
    return "application/json", json.dumps(source(), separators=(",", ":"), allow_nan=False)
