"""outlast play: what it takes, what it refuses, and how it ends."""

import signal
import socket
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from outlast.ecs import Clock
from outlast.envs.cli import main as cli
from tests.web.clients import Page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--agent", "2"), ("agent 2", "0 to 1")),
        (("--set", "mele_damage=3"), ("mele_damage", "melee_damage")),
        (("--record", "/nowhere/at/all.rec"), ("/nowhere/at/all.rec",)),
        (("--host", "203.0.113.7"), ("203.0.113.7", "--host takes an address of this machine")),
    ],
)
def test_mistakes_are_reported_in_one_line(capsys, arguments, words):
    assert cli.main(("play", "ffa_3", "--no-browser", *arguments)) == 2
    err = capsys.readouterr().err
    assert len(err.strip().splitlines()) == 1
    for word in words:
        assert word in err


def test_a_taken_port_is_reported_in_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(("play", "ffa_3", "--no-browser", "--port", str(port))) == 2
    assert f"port {port} of 127.0.0.1 is not to be had" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value", "words"),
    [
        ("--port", "65536", "a port is needed"),
        ("--port", "-1", "a port is needed"),
        ("--port", "http", "a port is needed"),
        ("--allow-host", "localhost", "localhost: NAME:PORT is needed, as in localhost:9000"),
        ("--fps", "0", "a number above 0"),
        ("--fps", "nan", "a number above 0"),
        ("--fps", "1e9", "a number above 0"),
        ("--agent", "-1", "an integer of at least 0"),
        (
            "--others",
            "best",
            "(a model's name, FILE.zip, FILE.safetensors or the folder of a run) is needed",
        ),
        ("--others", "noop:0.5,scriptd", "did you mean scripted"),
    ],
)
def test_numbers_that_cannot_be_are_refused(capsys, option, value, words):
    with pytest.raises(SystemExit):
        cli.main(("play", "ffa_3", f"{option}={value}"))
    assert words in capsys.readouterr().err


def test_without_websockets_the_cure_is_reported():
    code = "import sys; sys.modules['websockets'] = None; from outlast.envs.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "play", "ffa_3"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    assert result.stderr.startswith("outlast: outlast play needs websockets: pip install 'outlast[view]' (")
    assert "websockets>=14" in result.stderr


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT to send")
def test_ctrl_c_ends_it_cleanly_and_the_recording_is_whole(tmp_path):
    from outlast.envs.recording import Recording, Replay

    file: Path = tmp_path / "game.rec"
    options = ("--no-browser", "--fps", "200", "--others", "noop:2,scripted", "--record", str(file))
    command = [sys.executable, "-m", "outlast", "play", "ffa_3", *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().split()[-1]
        with Page(address) as page:
            page.send(held={"ahead": 1}, tapped={})
            page.until(lambda state: state["snapshot"]["tick"] >= 10)
            process.send_signal(signal.SIGINT)
            _, err = process.communicate(timeout=20)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, err.strip()) == (0, "")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", urlsplit(address).port), timeout=2)
    replay = Replay(Recording.open(file))
    assert len(list(replay.ticks())) > 10
    assert replay.worlds[Clock].tick[0, 0] >= 10
    replay.close()
