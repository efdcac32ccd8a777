"""outlast.play and `outlast play`: what they take, what they refuse, and how they end."""

import asyncio
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.components import Side
from outlast.envs.cli import main as cli
from outlast.envs.errors import PlayError, ScenarioError, UsageError
from outlast.envs.web import game as server
from outlast.envs.web.game import Game
from outlast.envs.web.gate import Site


@pytest.fixture
def games(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Game, float]]:
    """What is served, and how fast; Ctrl-C comes at once."""
    served: list[tuple[Game, float]] = []

    async def play(game: Game, fps: float, site: Site, opened: Callable[[str], object]) -> None:
        opened("http://127.0.0.1:1/")
        served.append((game, fps))
        raise KeyboardInterrupt

    monkeypatch.setattr(server, "play", play)
    return served


def test_a_game_is_served_until_ctrl_c(games: Any, capsys: Any, tmp_path: Path) -> None:
    others = {"noop": 2, lambda observations: observations["own"][:, :, :6] * 0: 1}
    outlast.play("teams_3", agent=2, others=others, browser=False, record=tmp_path / "game.rec", n_heals=3)
    [(game, fps)] = games
    assert (game.agent, fps, len(game.worlds.layout.rows(Side))) == (2, pytest.approx(30), 4)
    assert game.env.scenario.numbers()["heals_count"] == 3
    assert len(outlast.Recording.open(tmp_path / "game.rec")) == 1
    assert "you are agent 2 at http://127.0.0.1:1/" in capsys.readouterr().out


def test_a_game_of_ones_own_has_its_items_and_bodies_on_the_page(games: Any) -> None:
    outlast.play("docs/examples/tag.py:TAG", browser=False, fps=10)
    [(game, fps)] = games
    assert fps == 10
    assert {each["kind"] for each in game.world["objects"]} >= {"shield"}


@pytest.mark.parametrize(
    ("options", "kind", "words"),
    [
        ({"game": "ffa_9"}, ScenarioError, "did you mean"),
        ({"agent": 2}, PlayError, "agent 2: ffa_3 has the agents 0 to 1"),
        ({"fps": 0}, PlayError, "fps = 0: a number above 0, up to 1000"),
        ({"fps": "fast"}, PlayError, "fps = 'fast'"),
        ({"port": 65536}, PlayError, "port = 65536: an integer from 1 to 65535"),
        ({"port": "http"}, PlayError, "port = 'http'"),
        ({"allow_hosts": ["box:80", "localhost"]}, PlayError, "localhost: NAME:PORT is needed"),
        ({"others": "scriptd"}, UsageError, "did you mean scripted"),
        ({"game": outlast.variant("ffa_1").without("record")}, PlayError, r"has no 'record', .* add Record\(\)"),
        ({"agnt": 1}, ValueError, "did you mean agent"),
    ],
)
def test_mistakes(games: Any, options: dict[str, Any], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind, match=words):
        outlast.play(**{"game": "ffa_3", "browser": False} | options)
    assert not games


def test_in_an_event_loop_the_cure_is_said(games: Any) -> None:
    async def notebook() -> None:
        outlast.play("ffa_3", browser=False)

    with pytest.raises(PlayError, match="run `outlast play` in a terminal"):
        asyncio.run(notebook())


def test_a_taken_port_is_reported_in_one_line(capsys: Any) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert cli.main(("play", "ffa_3", "--no-browser", "--port", str(port))) == 2
    assert f"port {port} of 127.0.0.1 is not to be had" in capsys.readouterr().err
