"""A game in a folder of its own: whatever works with the paper's variants works with it, by command and from Python."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
SWAMP = '''"""A swamp."""

from dataclasses import dataclass

from outlast.components import Phase, Push
from outlast.ecs import Module, Rows, Write, number


@dataclass(frozen=True)
class Swamp(Module):
    """Slows everybody down."""

    drag: float = number(0.5, low=0, high=1, about="share of a push that is lost")


@Swamp.system(Phase.DRIVE, after="motors")
def wade(push: Write[Push], agents: Rows[Push], drag: float) -> None:
    """Lose a share of the push."""
    for k in range(agents.size):
        push.x[agents[k]] *= 1 - drag
        push.y[agents[k]] *= 1 - drag
'''
GAME = '''"""A duel in a swamp."""

import outlast
from swamp import Swamp

arena = outlast.Scenario(
    "bog", (*outlast.variant("ffa_1").replace(ending_limit=20, n_heals=2).modules, Swamp()), "a duel in a swamp"
)
'''
PROJECT = """[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "bog-games"
version = "1.0"

[project.entry-points."outlast.scenarios"]
bog_duel = "bog_game:arena"
lost = "bog_game:lost"
ffa_2 = "bog_game:arena"

[tool.setuptools]
py-modules = ["bog_game", "swamp"]
"""


COMMANDS = """
import contextlib, io, json, sys
from outlast.envs.cli.main import main

if __name__ == "__main__":
    outcomes = []
    for words in json.loads(sys.argv[1]):
        with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(said):
            status = main(words)
        outcomes.append((status, said.getvalue()))
    print(json.dumps(outcomes))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("games")
    (folder / "bog_game.py").write_text(GAME)
    (folder / "swamp.py").write_text(SWAMP)
    return folder


def run(folder: Path, *words: str, path: Sequence[Path] = (), status: int = 0) -> str:
    """What a Python process prints in that folder, which no other one has imported anything in."""
    places = [*map(str, path), *filter(None, [os.environ.get("PYTHONPATH")])]
    env = os.environ | {"PYTHONPATH": os.pathsep.join(places), "PYTHONSAFEPATH": "1"}
    done = subprocess.run([sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True, timeout=200)
    assert done.returncode == status, done.stderr
    return done.stdout + done.stderr


def outlast(folder: Path, *words: str, path: Sequence[Path] = (), status: int = 0) -> str:
    return run(folder, "-m", "outlast", *words, path=path, status=status)


def in_turn(folder: Path, commands: Sequence[Sequence[str]]) -> list[tuple[int, str]]:
    """The status of each command, and what it prints; one after the other in one process, which takes fewer starts."""
    (folder / "commands.py").write_text(COMMANDS)
    return [(status, said) for status, said in json.loads(run(folder, "commands.py", json.dumps(commands)))]


@pytest.mark.nightly
def test_every_command_takes_it(folder: Path) -> None:
    pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")
    name, quiet = "bog_game.py:arena", "--quiet"
    small = ("--worlds", "2", quiet)
    checkpoint = "runs/bog-fast-1/steps_0000000256.zip"
    made = ("--html", "page.html", "--data", "samples", "--out", "film.webm", "--events", "events.csv")
    commands: dict[tuple[str, ...], str] = {  # and what they print
        ("schedule", name): "swamp.wade",
        ("numbers", name): "share of a push that is lost",
        ("rollout", name, "--set", "swamp_drag=0.1", "--record", "a.rec", *small): "bog-swamp_drag=0.1: random policy",
        ("frames", "bog_game.py", "--steps", "2", "--out", "pictures", quiet): "",
        ("replay", "a.rec", "--import", "bog_game.py", *made, quiet): "",
        (
            *("train", name, "--steps", "128", "--worlds", "4", "--rollout", "128", "--every", "1", "--film", quiet),
            *("--seed", "0", "1"),
        ): "",
        (
            *("evaluate", name, "random", checkpoint, "--episodes", "4", "--worlds", "2", "--out", "tables"),
            *("--film", quiet),
        ): "bog, seed 0",
        ("rollout", name, "--policy", checkpoint, *small): "bog: ",
        ("plot", "runs", "--by", "seed", "--curves", "length"): "",
    }
    for (words, expected), (status, said) in zip(commands.items(), in_turn(folder, list(commands)), strict=True):
        assert (status, expected in said) == (0, True), (words, said)
    assert "--import FILE.py" in outlast(folder, "replay", "a.rec", status=2)  # where the game is not known yet
    assert len(list((folder / "pictures").glob("*.png"))) == 3
    assert all((folder / each).exists() for each in made[1::2])
    assert list((folder / "runs" / "bog-fast-1").glob("*.webm"))
    assert (folder / "figures" / "ends.md").read_text().startswith("bog, preset fast, 2 runs.")


def test_it_is_saved_and_named_beside_its_mechanics(folder: Path) -> None:
    words = ("--set", "swamp_drag=0.9", "--without", "heals", "--save-scenario", "mine.json")
    commands = (
        ("schedule", "bog_game.py:arena", *words),
        ("schedule", "mine.json", "--import", "swamp.py"),
        ("schedule", "ffa_1", "--with", "swamp.py:Swamp(drag=0.3)"),
    )
    (saved, _), (read, without), (added, beside) = in_turn(folder, commands)
    assert saved == read == added == 0
    assert json.loads((folder / "mine.json").read_text())["name"] == "bog-without_heals-swamp_drag=0.9"
    assert "swamp.wade" in without
    assert "heals.heal" not in without
    assert "swamp.wade" in beside
    assert "swamp.Swamp is not one of outlast's own" in outlast(folder, "schedule", "mine.json", status=2)


@pytest.mark.parametrize(
    "words",
    [
        ("-m", "outlast", "play", "bog_game.py:arena", "--no-browser"),
        ("-uc", "import outlast; outlast.play('bog_game.py:arena', browser=False)"),
    ],
)
@pytest.mark.by_day(1)
def test_it_is_played_in_a_browser(folder: Path, words: Sequence[str]) -> None:
    command = [sys.executable, *words]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stdout.readline().startswith("bog: you are agent 0 at http://127.0.0.1:")
        server.send_signal(signal.SIGINT)
        assert server.wait(60) == 0


@pytest.mark.nightly
def test_a_package_offers_it(folder: Path, tmp_path: Path) -> None:
    project, target = tmp_path / "project", tmp_path / "site"
    project.mkdir()
    (project / "pyproject.toml").write_text(PROJECT)
    for file in ("bog_game.py", "swamp.py"):
        (project / file).write_text((folder / file).read_text())
    install = ("-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation", "--no-index")
    run(tmp_path, *install, "--target", str(target), str(project))
    out = outlast(tmp_path, "variants", path=[target])
    assert re.search(r"^bog_duel +bog-games +a duel in a swamp$", out, re.MULTILINE)
    assert "the scenario 'lost' of the package bog-games: bog_game has no 'lost'" in out
    assert "the scenario 'ffa_2' of the package bog-games is left out: that is the name of a variant" in out
    assert "swamp.wade" in outlast(tmp_path, "schedule", "bog_duel+steering", path=[target])
    script = (
        "import gymnasium, outlast, pettingzoo\n"
        "env = gymnasium.make('outlast/bog_duel-v1')\n"
        "print(env.reset(seed=0)[0].keys())\n"
        "print(outlast.make_vec('bog_duel', 1).scenario)\n"
        "if hasattr(pettingzoo, 'make'): print(pettingzoo.make('parallel', 'outlast/bog_duel-v1'))\n"
    )
    assert "Scenario('bog', 19 mechanics)" in run(tmp_path, "-c", script, path=[target])
