"""outlast play: what it takes, what it refuses, and how it ends."""

import socket
import subprocess
import sys

from outlast.envs.cli import main as cli


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
