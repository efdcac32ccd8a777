"""The game's server talks to its own page only."""

import contextlib
import http.client
import socket
from urllib.parse import urlsplit

import pytest

from tests.web.clients import HANDSHAKE, answer, served


def test_the_page_and_its_parts_are_served_with_strict_headers(address):
    status, headers, body = answer(address)
    assert status == 200
    policy = dict(part.strip().partition(" ")[::2] for part in headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == policy["frame-ancestors"] == policy["form-action"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == "'self'"
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    assert (headers["X-Content-Type-Options"], headers["X-Frame-Options"]) == ("nosniff", "DENY")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    sources = [part.split('"')[0] for part in body.decode().split('src="')[1:]]
    assert {"world.js", "play.js"} < set(sources)
    for name in (*sources, "style.css", "play.css"):
        status, headers, body = answer(address, urlsplit(address).path + name)
        assert status == 200
        assert headers["Content-Type"] == f"text/{'css' if name.endswith('css') else 'javascript'}; charset=utf-8"
        assert len(body) > 100


@pytest.mark.parametrize("change", ["none", "short", "long", "other", "cased", "encoded", "query", "double"])
@pytest.mark.parametrize("live", [False, True])
def test_without_the_token_nothing_is_served(address, change, live):
    parts = urlsplit(address)
    token = parts.path.strip("/")
    path = {
        "none": "/",
        "short": f"/{token[:-1]}/",
        "long": f"/{token}x/",
        "other": f"/{'A' * len(token)}/",
        "cased": f"/{token.swapcase()}/",
        "encoded": f"/%{ord(token[0]):02x}{token[1:]}/",
        "query": f"/?{token}/",
        "double": f"//{token}/",
    }[change]
    headers = HANDSHAKE | {"Origin": f"http://{parts.netloc}"} if live else {}
    assert answer(address, path + ("live" if live else ""), **headers)[0] == 403


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}", 101),
        ("localhost:{port}", "http://localhost:{port}", 101),
        ("127.0.0.1:{port}", None, 403),
        ("127.0.0.1:{port}", "null", 403),
        ("127.0.0.1:{port}", "", 403),
        ("127.0.0.1:{port}", "http://example.com", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1:1", 403),
        ("127.0.0.1:{port}", "https://127.0.0.1:{port}", 403),
        ("127.0.0.1:{port}", "http://127.0.0.1:{port}.example.com", 403),
        ("127.0.0.1:{port}", ("http://127.0.0.1:{port}", "http://example.com"), 403),
        ("example.com:{port}", "http://example.com:{port}", 403),
        ("example.com:{port}", "http://127.0.0.1:{port}", 403),
        ("127.0.0.1", "http://127.0.0.1:{port}", 403),
        ("127.0.0.1.example.com:{port}", "http://127.0.0.1.example.com:{port}", 403),
        (("127.0.0.1:{port}", "example.com"), "http://127.0.0.1:{port}", 403),
        ((), "http://127.0.0.1:{port}", 403),
    ],
)
def test_websockets_are_for_the_own_page_only(address, host, origin, status):
    parts = urlsplit(address)

    def filled(value):
        return tuple(map(filled, value)) if isinstance(value, tuple) else value.format(port=parts.port)

    headers = HANDSHAKE | {"Host": filled(host)} | ({} if origin is None else {"Origin": filled(origin)})
    assert answer(address, f"{parts.path}live", **headers)[0] == status


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"Host": "example.com"}, 403),
        ({"Origin": "http://example.com"}, 403),
        ({"Origin": "null"}, 403),
        ({"Host": ()}, 403),
    ],
)
def test_pages_are_for_this_host_only(address, headers, status):
    assert answer(address, **headers)[0] == status


@pytest.mark.parametrize(
    ("path", "status"), [("../server.py", 404), ("server.py", 404), ("/etc/passwd", 404), ("play.html", 404)]
)
def test_only_the_files_of_the_page_are_served(address, path, status):
    assert answer(address, urlsplit(address).path + path)[0] == status


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "HEAD", "OPTIONS"])
def test_other_methods_are_refused(address, method):
    with contextlib.suppress(http.client.RemoteDisconnected):  # which is how older versions of websockets refuse
        assert answer(address, method=method)[0] == 405
    assert answer(address)[0] == 200


@pytest.mark.parametrize("noise", [b"\x16\x03\x01\x02", b"GET\r\n\r\n", b"GET / HTTP/9\r\n\r\n", b"A" * 100_000, b""])
def test_noise_on_the_line_ends_nothing(address, noise):
    with socket.create_connection(("127.0.0.1", urlsplit(address).port)) as line, contextlib.suppress(OSError):
        line.sendall(noise)
        line.shutdown(socket.SHUT_WR)
        line.recv(100)
    assert answer(address)[0] == 200


def test_only_loopback_is_bound(address):
    port = urlsplit(address).port
    others = {"::1"}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, contextlib.suppress(OSError):
        line.connect(("192.0.2.1", 9))  # sends nothing, but gives the address of this machine that it would send from
        others.add(line.getsockname()[0])
    for other in others - {"127.0.0.1"}:
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((other, port), timeout=2)


def test_tokens_differ(game):
    with served(game) as one, served(game) as other:
        tokens = {urlsplit(address).path for address in (one, other)}
    assert len(tokens) == 2
    assert all(len(token.strip("/")) >= 32 for token in tokens)
