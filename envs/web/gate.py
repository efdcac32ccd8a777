"""Access control: what a server serves is reached only on this machine, with its token, from pages that it gave out.

Other programs and users of this machine, and other web pages, can reach a port on 127.0.0.1: the token keeps them out.
The check of the Host header keeps out foreign names that were made to point here (DNS rebinding). The check of the
Origin header keeps out other web pages, as browsers let any page open a websocket to any server.
"""

import os
import secrets
import socket
from typing import Any

from ..errors import PlayError

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
LIVE = "live"  # the path of the websocket, after the token

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


class Gate:
    """The access control of a server at `port`. Its token is new and random, and is the first part of every path."""

    def __init__(self, port: int) -> None:
        self.port, self.token = port, secrets.token_urlsafe(24)

    @property
    def address(self) -> str:
        """The address to open."""
        return f"http://{HOST}:{self.port}/{self.token}/"

    def path(self, request: Any) -> str | None:
        """Return the path after the token; None if the request is refused.

        request: websockets.http11.Request, or a handler of http.server. Only a websocket must name its origin: browsers
        always send it for websockets, but not for a page that somebody opens.
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
        """Return the headers of every answer of a game. Its page may only load from, and connect to, this server."""
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
    """Return a socket that listens at `port` of HOST (0: any free one). Raises PlayError if it is not available."""
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        cure = "leave --port out for one that is free"
        raise PlayError(f"port {port} of {HOST} is not to be had: {os.strerror(error.errno or 0)}; {cure}") from None
