"""A server of one page that plays episodes as they are made."""

import contextlib
import json
import logging
import sys
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Protocol

from ...inspect.world_json import Json
from ..assets import SHARED, STYLE, assemble
from ..gate import HEADERS, REFUSED, Gate, Site, listening
from .pack import PACKING
from .write import PLAYING

SCRIPTS = (*SHARED, *PLAYING, "watch.js")
STYLES = (STYLE, "watch.css")
PATIENCE = 10  # seconds that a request may take to arrive
logger = logging.getLogger(__name__)


class Feed(Protocol):
    """The source of what the page shows. Its methods are called from several threads."""

    def status(self) -> Json:
        """Return the state of the run, see watch.js: message, newest {steps, age}, episode {number, steps}, figures."""

    def episode(self) -> Json | None:
        """Return the newest episode, {number, steps, game, ticks, whole, data: base64 of `pack`}; None: none yet.

        ticks: how many it has so far; whole: whether these are all.
        """


@contextlib.contextmanager
def serving(feed: Feed, title: str, site: Site | None = None) -> Iterator[str]:
    """Serve the page from threads of its own until the context ends, and yield the address to open.

    site: Where it is served; None: at any free port of 127.0.0.1. Raises PlayError if that is not available.
    """
    # the page's policy lets only its inlined scripts run, and lets them connect to this server only
    page = assemble(title, SCRIPTS, styles=STYLES, connect="'self'", PACKING=PACKING).encode()
    with listening(site or Site()) as (listener, gate):
        server = _Server(listener.getsockname(), _Handler, bind_and_activate=False)
        server.socket.close()
        server.socket = listener
        server.gate, server.logged = gate, set()
        server.answers = {  # the type and the content, by the path after the token
            "": lambda: ("text/html", page),
            "status.json": lambda: ("application/json", _json(feed.status())),
            "episode.json": lambda: ("application/json", _json(feed.episode())),
        }
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)
        thread.start()
        try:
            yield gate.address
        finally:
            server.shutdown()
            thread.join()


def _json(value: Json | None) -> bytes:
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()


class _Server(ThreadingHTTPServer):
    gate: Gate
    answers: dict[str, Callable[[], tuple[str, bytes]]]
    logged: set[type]

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log an error in a request, the first of each type, as pages repeat their requests.

        OSErrors are left out: browsers drop connections as they like.
        """
        error = sys.exception()
        if not isinstance(error, OSError) and type(error) not in self.logged:
            self.logged.add(type(error))
            logger.error("a request failed", exc_info=error)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = PATIENCE

    def do_GET(self) -> None:  # http.server calls it by this name
        path = self.server.gate.path(self)
        if path is None:
            self._reply(HTTPStatus.FORBIDDEN, "text/plain", REFUSED.encode())
        elif path not in self.server.answers:
            self._reply(HTTPStatus.NOT_FOUND, "text/plain", b"This file does not exist.\n")
        else:
            self._reply(HTTPStatus.OK, *self.server.answers[path]())

    def _reply(self, status: HTTPStatus, kind: str, body: bytes) -> None:
        self.send_response(status)
        headers = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body))}
        for name, value in (HEADERS | headers).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def version_string(self) -> str:
        return "outlast"

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  # as http.server names it
        """Log nothing: http.server would write every request to stderr."""
