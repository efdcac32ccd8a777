"""The game's server talks to its own page only."""

import contextlib
import http.client
import re
import socket
import sys
import time
from email.message import Message
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest

from outlast.envs.errors import PlayError
from outlast.envs.web import gate
from outlast.envs.web.gate import MOST, Gate, Site, listening
from outlast.envs.web.server import serving
from tests.web.clients import HANDSHAKE, answer, served


def test_the_page_is_served_with_strict_headers(address):
    status, headers, body = answer(address)
    assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    found = re.search(r'Security-Policy" content="([^"]+)"', body.decode())[1]
    policy = dict(part.strip().partition(" ")[::2] for part in found.split(";"))
    assert policy["default-src"] == policy["form-action"] == "'none'"
    assert policy["script-src"].startswith("'sha256-")
    assert f"ws://{urlsplit(address).netloc}" in policy["connect-src"].split()
    assert (headers["Cache-Control"], headers["Referrer-Policy"]) == ("no-store", "no-referrer")
    assert (headers["X-Content-Type-Options"], headers["X-Frame-Options"]) == ("nosniff", "DENY")
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"


@pytest.mark.parametrize("live", [False, True])
def test_without_the_token_nothing_is_served(address, live):
    parts = urlsplit(address)
    token = parts.path.strip("/")
    headers = HANDSHAKE | {"Origin": f"http://{parts.netloc}"} if live else {}
    for other in (token[:-1], f"{token}x", "A" * len(token), token.swapcase(), f"%{ord(token[0]):02x}{token[1:]}"):
        assert answer(address, f"/{other}/" + "live" * live, **headers)[0] == 403
    for path in ("/", f"/?{token}/", f"//{token}/"):
        assert answer(address, path + "live" * live, **headers)[0] == 403


OWN, OTHER = "127.0.0.1:{port}", "example.com"


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        (OWN, f"http://{OWN}", 101),
        ("localhost:{port}", "http://localhost:{port}", 101),
        *((OWN, origin, 403) for origin in (None, "null", "", f"http://{OTHER}", "http://127.0.0.1", f"https://{OWN}")),
        (OWN, f"http://{OWN}.{OTHER}", 403),
        (OWN, (f"http://{OWN}", f"http://{OTHER}"), 403),
        (f"{OTHER}:{{port}}", f"http://{OTHER}:{{port}}", 403),
        *((host, f"http://{OWN}", 403) for host in (f"{OTHER}:{{port}}", "127.0.0.1", (OWN, OTHER), ())),
    ],
)
def test_websockets_are_for_the_own_page_only(address, host, origin, status):
    parts = urlsplit(address)

    def filled(value):
        return tuple(map(filled, value)) if isinstance(value, tuple) else value.format(port=parts.port)

    headers = HANDSHAKE | {"Host": filled(host)} | ({} if origin is None else {"Origin": filled(origin)})
    assert answer(address, f"{parts.path}live", **headers)[0] == status


both = pytest.mark.parametrize("kind", ["play", "watch"])


@both
def test_pages_are_for_this_host_only(game, kind):
    wrong = [{"Host": host} for host in (OTHER, "127.0.0.1", ())]
    wrong += [{"Origin": origin} for origin in (f"http://{OTHER}", "null")]
    with server(kind, game) as address:
        assert answer(address)[0] == 200
        assert [answer(address, **headers)[0] for headers in wrong] == [403] * 5


def test_only_the_files_of_the_page_are_served_and_only_read(address):
    for path in ("../server.py", "server.py", "/etc/passwd", "page.html", "play.js"):
        assert answer(address, urlsplit(address).path + path)[0] == 404
    for method in ("POST", "PUT", "DELETE", "HEAD", "OPTIONS"):
        with contextlib.suppress(http.client.RemoteDisconnected):  # which is how older versions of websockets refuse
            assert answer(address, method=method)[0] == 405
    assert answer(address)[0] == 200


NOISE = (b"\x16\x03\x01\x02", b"GET\r\n\r\n", b"GET / HTTP/9\r\n\r\n", b"A" * 100_000, b"")


@both
def test_noise_on_the_line_ends_nothing(game, kind, capfd):
    with server(kind, game) as address:
        for noise in NOISE:
            with socket.create_connection(("127.0.0.1", urlsplit(address).port)) as line, contextlib.suppress(OSError):
                line.sendall(noise)
                line.shutdown(socket.SHUT_WR)
                line.recv(100)
            assert answer(address)[0] == 200
    assert capfd.readouterr().err == ""


def asked(made, host, origin):
    """The path of a websocket that a gate lets through."""
    headers = Message()
    headers["Host"], headers["Origin"] = host, origin
    return made.path(SimpleNamespace(headers=headers, path=f"/{made.token}/live"))


@pytest.mark.parametrize(
    ("site", "port", "hosts", "address"),
    [
        (Site(), 80, ["127.0.0.1", "127.0.0.1:80", "localhost"], "http://127.0.0.1/"),
        (Site(), 443, ["127.0.0.1:443"], "http://127.0.0.1:443/"),
        (Site(host="0.0.0.0"), 8000, ["127.0.0.1:8000", "LOCALHOST:8000"], "http://127.0.0.1:8000/"),
        (Site(host="10.0.0.7"), 8000, ["10.0.0.7:8000", "127.0.0.1:8000"], "http://10.0.0.7:8000/"),
        (Site(host="::1"), 8000, ["[::1]:8000", "localhost:8000"], "http://[::1]:8000/"),
        (Site(allowed=("LocalHost:9000",)), 8000, ["localhost:9000", "127.0.0.1:8000"], "http://localhost:9000/"),
        (Site(allowed=("box:80",)), 8000, ["box", "box:80"], "http://box/"),
    ],
)
def test_a_page_is_reached_by_the_names_of_its_site_as_browsers_write_them(site, port, hosts, address):
    made = Gate(port, site)
    assert made.address == f"{address}{made.token}/"
    for host in hosts:
        assert asked(made, host, f"http://{host}") == "live"
        assert f"ws://{host.lower()}" in made.live.split()
    for host in ("", "example.com", "127.0.0.1:1", "0.0.0.0:8000", ":8000", *(f"{host}0" for host in hosts)):
        assert asked(made, host, f"http://{hosts[0]}") is None
        assert asked(made, hosts[0], f"http://{host}") is None


def test_behind_a_proxy_with_https_either_header_may_be_replaced():
    made = Gate(8000, Site(allowed=("name-8000.app.example:443",)))
    outside, inside = "name-8000.app.example", "127.0.0.1:8000"
    assert made.address == f"https://{outside}/{made.token}/"
    assert f"wss://{outside}" in made.live.split()
    for host in (outside, inside):
        for origin in (f"https://{outside}", f"http://{inside}"):
            assert asked(made, host, origin) == "live"
        assert asked(made, host, f"https://{inside}") is None
        assert asked(made, host, "https://other.app.example") is None


@pytest.mark.parametrize(
    "text", ["localhost", "localhost:", ":80", "a b:80", "x:0", "x:65536", "http://x:80", "x:80\n", ""]
)
def test_places_that_are_not_name_and_port_are_refused(text):
    with pytest.raises(PlayError, match="NAME:PORT is needed, as in localhost:9000"):
        Site(allowed=(text,))


@pytest.mark.parametrize("host", ["203.0.113.7", "no.such.host.invalid", "x" * 80, ""])
def test_a_host_that_is_not_of_this_machine_is_refused_with_the_cure(host):
    with pytest.raises(PlayError, match="--host takes an address of this machine"), listening(Site(host=host)):
        pass


@both
def test_a_page_is_served_at_another_name_and_interface(game, kind, monkeypatch):
    site, ports = Site(host="0.0.0.0", allowed=("box:9000",)), []
    monkeypatch.setattr(gate, "Gate", lambda port, site: ports.append(port) or Gate(port, site))
    with server(kind, game, site) as address:
        assert urlsplit(address).netloc == "box:9000"
        for name, status in (("box:9000", 200), (f"127.0.0.1:{ports[0]}", 200), ("other:9000", 403), ("box", 403)):
            status_there, _, body = answer(address, port=ports[0], Host=name)
            assert status_there == status
            assert (b"--allow-host NAME:PORT" in body) == (status == 403)
        if sys.platform == "linux":  # where the whole of 127.0.0.0/8 is this machine
            socket.create_connection(("127.0.0.2", ports[0]), timeout=5).close()


# ---- more connections than there is room for


def server(kind, game, site=None):
    """A server of a game or of a run."""
    return served(game, site=site) if kind == "play" else serving("a run", {}, site)


def complaints(caplog, capfd):
    """What was logged, and what reached stderr."""
    return [record.getMessage() for record in caplog.records], capfd.readouterr().err


@both
def test_connections_beyond_a_limit_are_closed_and_reported_once(game, kind, caplog, capfd):
    with server(kind, game) as address, contextlib.ExitStack() as crowd:
        port = urlsplit(address).port
        crowded = [crowd.enter_context(socket.create_connection(("127.0.0.1", port), 5)) for _ in range(2 * MOST)]
        for late in crowded[MOST:]:
            with contextlib.suppress(ConnectionError):  # closed, or reset
                assert late.recv(1) == b""
        for early in crowded[:MOST]:
            early.close()
        assert until_answered(address)
    text = f"{MOST} connections are open: no more are accepted until some of them end"
    assert complaints(caplog, capfd) == ([text], "")


@both
def test_a_missing_descriptor_is_waited_for_and_reported_once(game, kind, caplog, capfd):
    resource = pytest.importorskip("resource", reason="Windows has no limit of open files")
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with server(kind, game) as address, socket.socket() as client:
        assert answer(address)[0] == 200
        client.settimeout(5)
        resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))  # whatever is open stays so
        try:
            client.connect(("127.0.0.1", urlsplit(address).port))
            deadline = time.monotonic() + 10
            while not caplog.records and time.monotonic() < deadline:
                time.sleep(0.02)
            time.sleep(0.3)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        assert until_answered(address)
    text = "no connection can be accepted (Too many open files): new ones wait until others end"
    assert complaints(caplog, capfd) == ([text], "")


def until_answered(address):
    """Whether it answers within some seconds."""
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with contextlib.suppress(OSError, http.client.HTTPException):
            if answer(address)[0] == 200:
                return True
        time.sleep(0.05)
    return False


@both
def test_only_loopback_is_bound(game, kind):
    others = {"::1"}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line, contextlib.suppress(OSError):
        line.connect(("192.0.2.1", 9))  # sends nothing, but gives the address of this machine that it would send from
        others.add(line.getsockname()[0])
    with server(kind, game) as address:
        for other in others - {"127.0.0.1"}:
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((other, urlsplit(address).port), timeout=2)


def test_tokens_differ(game):
    with served(game) as one, served(game) as other:
        tokens = {urlsplit(address).path for address in (one, other)}
    assert len(tokens) == 2
    assert all(len(token.strip("/")) >= 32 for token in tokens)
