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


def test_a_taken_port_is_reported_in_one_line(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(("play", "ffa_3", "--no-browser", "--port", str(port))) == 2
    assert f"port {port} of 127.0.0.1 is not to be had" in capsys.readouterr().err


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
