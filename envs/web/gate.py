"""Access control: only pages that a server gave out, on this machine, with its token, reach what it serves.

Other programs of this machine, other users and other web pages can reach a port on 127.0.0.1. The token is
needed against those; the Host header is checked against names that were made to point here (DNS rebinding), the Origin
header against other web pages, from which browsers let anybody open a websocket.
"""

import os
import secrets
import socket
from typing import Any

from ..errors import PlayError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
LIVE = "live"  # the websocket's path, behind the token

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Gate:
    """Of a server at `port`. Its token is new and random, and is the first part of every path."""

    def __init__(self, port: int) -> None:
        self.port, self.token = port, secrets.token_urlsafe(24)

    @property
    def address(self) -> str:
        """What to open."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def path(self, request: Any) -> str | None:
        """The path behind the token; None if the request is refused.

        request: websockets.http11.Request, or a handler of http.server. Only websockets must name their origin:
        browsers always do for them, and never for a page that somebody opens.
        """
        hosts, origins = (request.headers.get_all(name) or [] for name in ("Host", "Origin"))
        if len(hosts) != 1 or hosts[0] not in self._names():
            return None
        token, slash, path = str(request.path).removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()) or not slash:
            return None
        if path == LIVE and not origins:
            return None
        return path if all(origin == f"http://{hosts[0]}" for origin in origins) else None

    def headers(self) -> dict[str, str]:
        """Of every answer of a game. The page may load from, and connect to, this server only."""
        live = " ".join(f"ws://{name}" for name in self._names())
        policy = {
            "default-src": "'none'",
            "script-src": "'self'",
            "style-src": "'self'",
            "img-src": "'self' data:",
            "connect-src": live,
            "base-uri": "'none'",
            "form-action": "'none'",
            "frame-ancestors": "'none'",
        }
        return HEADERS | {"Content-Security-Policy": "; ".join(f"{key} {value}" for key, value in policy.items())}

    def _names(self) -> tuple[str, ...]:
        return tuple(f"{name}:{self.port}" for name in NAMES)


def listen(port: int) -> socket.socket:
    """A socket that listens at `port` of HOST (0: a free one). Raises PlayError if that is not to be had."""
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        cure = "leave --port out for one that is free"
        raise PlayError(f"port {port} of {HOST} is not to be had: {os.strerror(error.errno or 0)}; {cure}") from None
