"""outlast new: write a small game of one's own, to begin with."""

import argparse
import functools
import importlib.util
import keyword
from pathlib import Path
from typing import Any

from ..core.options import OUTPUT
from ..errors import ScenarioError
from ..storage.outputs import check_file
from .options import output

TEMPLATE = Path(__file__).with_name("new_game.txt")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "write a small game of your own, to begin with"
    description = (
        "Write a game in one file, NAME.py: two components, a mechanic with a system, a scenario and a test. It can be "
        "played, filmed and trained at once."
    )
    examples = [
        ("new hill", "hill.py; `pytest hill.py` runs its test"),
        ("check hill.py", "look for mistakes in it"),
        ("frames hill.py --policy random --out hill.gif", "a film of it"),
        ("train hill.py --steps 1e6", "agents that play it"),
    ]
    command = commands.add_parser("new", help=text, description=description, examples=examples, run=run)
    text = "name of the game, in lower case, such as hill or red_hill; NAME.py goes into this folder"
    command.group(OUTPUT).add_argument("path", type=_file, metavar="NAME", help=text)


def _file(text: str) -> str:
    """Return the file of a game of that name."""
    if not text.isidentifier() or keyword.iskeyword(text) or text != text.lower():
        raise argparse.ArgumentTypeError(f"{text}: a name in lower case is needed, as of a module: hill, red_hill")
    if _class_of(text) in TEMPLATE.read_text(encoding="utf-8"):
        raise argparse.ArgumentTypeError(
            f"{text}: {_class_of(text)} has another meaning in the game; choose another one"
        )
    path = output(functools.partial(check_file, what="games", error=ScenarioError, new=True))(f"{text}.py")
    if not Path(path).exists() and importlib.util.find_spec(text) is not None:
        raise argparse.ArgumentTypeError(f"{text}: there is a module of that name already; choose another one")
    return path


def _class_of(name: str) -> str:
    return name.title().replace("_", "")


def run(options: argparse.Namespace) -> int:
    """Write the file; the exit status."""
    path = Path(options.path)
    words = {"Game": _class_of(path.stem), "GAME": path.stem.upper(), '"game"': f'"{path.stem}"'}
    text = TEMPLATE.read_text(encoding="utf-8")
    for word, own in words.items():
        text = text.replace(word, own)
    path.write_text(text, encoding="utf-8")
    print(f"{path}: play it by `outlast play {path}`; `outlast new --help` has more")
    return 0
