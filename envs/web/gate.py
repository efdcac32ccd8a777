"""Access control: a page is reached where its user meant it to be, with its token, from pages that its server gave out.

Other programs and users of this machine, and other web pages, can reach a port on 127.0.0.1, and with another host,
other machines can: the token keeps them out. The check of the Host header keeps out foreign names that were made to
point here (DNS rebinding). The check of the Origin header keeps out other web pages, as browsers let any page open a
websocket to any server.
"""

import contextlib
import errno
import logging
import re
import secrets
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ..errors import PlayError
from ..progress import Messages

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
ANY = ("0.0.0.0", "::")  # hosts that stand for all interfaces, and so are not names of pages
LIVE = "live"  # the path of the websocket, after the token
USUAL = {"http": 80, "https": 443}  # ports that browsers leave out of addresses and headers
PLACE = re.compile(r"([\w.-]+|\[[0-9a-f:.]+\]):([1-9]\d{0,4})", re.ASCII | re.IGNORECASE)  # NAME:PORT
MOST = 32  # connections at once: each of a session's pages has one, and loads its files over a few more
PAUSE = 0.1  # seconds without new connections if a descriptor is missing for one
SCARCE = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
REFUSED = (
    "Not from here: open the address that outlast printed. Where a tunnel, a container or a proxy changes its name or "
    "port, start outlast with --allow-host NAME:PORT, as the address bar of the browser has them.\n"
)
logger = logging.getLogger(__name__)

HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Content-Security-Policy": "frame-ancestors 'none'",  # pages bring the rest of it along, see assets.assemble
}


@dataclass(frozen=True)
class Site:
    """The address of a page.

    Attributes:
        port: The port to listen at; 0: any free one.
        host: The address of the interface to listen at; 0.0.0.0: all of them.
        allowed: Further places NAME:PORT at which browsers reach the page, through a tunnel, a container or a proxy.

    Raises:
        PlayError: An allowed place is not of the form NAME:PORT.
    """

    port: int = 0
    host: str = HOST
    allowed: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for text in self.allowed:
            found = PLACE.fullmatch(text)
            if not found or int(found[2]) > 65535:
                raise PlayError(f"{text}: NAME:PORT is needed, as in localhost:9000")


class Gate:
    """The access control of a server at `port` of a site. Its token is new and random: the first part of every path."""

    def __init__(self, port: int, site: Site | None = None) -> None:
        self.token = secrets.token_urlsafe(24)
        site = site or Site()
        own = [name for name in dict.fromkeys((site.host, *NAMES)) if name not in ANY]
        self._hosts: list[str] = []  # values of the Host header
        self._origins: list[str] = []
        for text in site.allowed:
            name, _, outside = text.lower().rpartition(":")
            for scheme in ("https", "http") if int(outside) == USUAL["https"] else ("http", "https"):
                self._allow(scheme, name, int(outside))
        for name in own:
            self._allow("http", f"[{name}]" if ":" in name else name.lower(), port)

    def _allow(self, scheme: str, name: str, port: int) -> None:
        """Accept requests for this name and port, and pages from there."""
        forms = [f"{name}:{port}"] if port != USUAL[scheme] else [name, f"{name}:{port}"]
        self._hosts += forms
        self._origins += [f"{scheme}://{form}" for form in forms]

    @property
    def address(self) -> str:
        """The address to open: the first one that is allowed."""
        return f"{self._origins[0]}/{self.token}/"

    def path(self, request: Any) -> str | None:
        """Return the path after the token; None if the request is refused.

        request: websockets.http11.Request. Only a websocket must name its origin: browsers always send it for
        websockets, but not for a page that a user opens.
        """
        hosts, origins = (request.headers.get_all(name) or [] for name in ("Host", "Origin"))
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return None
        token, slash, path = str(request.path).removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()) or not slash:
            return None
        if path == LIVE and not origins:
            return None
        # a proxy may replace the name in one of the two headers only
        return path if all(origin.lower() in self._origins for origin in origins) else None

    @property
    def live(self) -> str:
        """The addresses of websockets to this server, as a source of a Content-Security-Policy."""
        return " ".join(origin.replace("http", "ws", 1) for origin in self._origins)


class Listener(socket.socket):
    """A listening socket that has at most MOST connections at once, and waits while descriptors are missing.

    Servers report each connection that cannot be accepted: asyncio with a traceback for every attempt, thousands in a
    second. Both get the error of a closed connection, and the log a line each.
    """

    def __init__(self, bound: socket.socket) -> None:
        super().__init__(fileno=bound.detach())
        self._accepted: list[socket.socket] = []
        self._logged: set[str] = set()

    def accept(self) -> tuple[socket.socket, Any]:
        """Return a new connection. Raises BlockingIOError if none is available now."""
        try:
            connection, address = super().accept()
        except OSError as error:
            if error.errno not in SCARCE:
                raise
            self._log("no connection can be accepted (%s): new ones wait until others end", error.strerror)
            time.sleep(PAUSE)
            raise BlockingIOError from error
        self._accepted = [each for each in self._accepted if each.fileno() >= 0]
        if len(self._accepted) >= MOST:
            connection.close()
            self._log("%d connections are open: no more are accepted until some of them end", MOST)
            raise BlockingIOError
        self._accepted.append(connection)
        return connection, address

    def _log(self, text: str, *values: object) -> None:
        if text not in self._logged:
            self._logged.add(text)
            logger.warning(text, *values)


@contextlib.contextmanager
def listening(site: Site) -> Iterator[tuple[Listener, Gate]]:
    """Listen at a site until the context ends; yield the socket and its access control.

    Raises PlayError if port or host are not available.
    """
    try:
        family = socket.getaddrinfo(site.host, site.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
        bound = socket.create_server((site.host, site.port), family=family)
    except (OSError, UnicodeError) as error:
        unknown = not isinstance(error, OSError) or isinstance(error, socket.gaierror)
        own = not unknown and error.errno != errno.EADDRNOTAVAIL  # type: ignore[union-attr]
        cure = "leave --port out for one that is free" if own else "--host takes an address of this machine"
        why = getattr(error, "strerror", None) or error
        raise PlayError(f"port {site.port} of {site.host} is not to be had: {why}; {cure}") from None
    with Listener(bound) as listener:
        yield listener, Gate(listener.getsockname()[1], site)


def announce(text: str, address: str, browser: bool = True) -> None:
    """Print a text about a page, and open the page's address if a `browser` is wanted."""
    print(text, file=Messages(sys.stdout), flush=True)
    if browser:
        # in a thread, as some calls wait for the browser to close
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
