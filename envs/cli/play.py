"""outlast play: steer an agent in the browser, against policies."""

import argparse
import asyncio
import contextlib
import sys
from typing import Any

from ..errors import PlayError, install
from ..rollout.loading import load_policies
from .options import (
    PLAY,
    add_common,
    add_number,
    add_others,
    add_page,
    add_scenario,
    add_seed,
    announce,
    scenario,
)

FASTEST = 1000  # ticks a second


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("play ffa_2", "a duel against the scripted policy"),
        ("play teams_3 --agent 2 --others random --fps 10", "agent 2 of four, at a third of the speed"),
    ]
    description = "Steer an agent with the keyboard, on a page in the browser that only this machine can open."
    text = "steer an agent with the keyboard, in the browser, against policies"
    command = commands.add_parser("play", help=text, description=description, examples=examples)
    add_scenario(command)
    add_number(command.group(PLAY), "--agent", 0, "number of the agent that you steer", least=0)
    add_others(command, "scripted", "whom you play against")
    add_seed(command)
    command.group(PLAY).add_argument(
        "--fps", type=_rate, metavar="RATE", help="ticks a second (default: in real time, 30)"
    )
    add_page(command)
    add_common(command, "--record")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve the game until Ctrl-C; the exit status. Raises PlayError."""
    try:
        from ..web.play.game import Game  # here, as these need websockets
        from ..web.play.server import play
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise PlayError(f"outlast play needs {package}: {install('play')}") from error
    world, chosen = load_policies(list(options.others), scenario(options), options.seed)
    others = dict(zip(chosen, options.others.values(), strict=True))
    game = Game(world, agent=options.agent, others=others, seed=options.seed, record=options.record)

    def opened(address: str) -> None:
        text = f"{world.name}: you are agent {options.agent} at {address}\nCtrl-C ends the game."
        announce(options, text, address)

    with contextlib.closing(game), contextlib.suppress(KeyboardInterrupt):
        asyncio.run(play(game, options.fps or 1 / game.world["seconds"], options.port, opened))
    print(file=sys.stderr)  # behind the ^C
    return 0


def _rate(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0
    if not 0 < value <= FASTEST:
        raise argparse.ArgumentTypeError(f"{text}: a number above 0, up to {FASTEST}, is needed")
    return value
