"""outlast play: steer an agent in the browser, against policies."""

import argparse
import sys
from typing import Any

from ..web.play.call import FASTEST, play
from .options import PLAY, add_common, add_number, add_others, add_page, add_scenario, add_seed, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("play ffa_2", "a duel against the scripted policy"),
        (
            "play teams_3 --agent 2 --others random --fps 10",
            "you are agent 2 of agents 0 to 3, at a third of the speed",
        ),
    ]
    description = (
        "Steer an agent with the keyboard, on a web page that opens in your browser. Without --host, only this machine "
        "can open it. Ctrl-C ends the game."
    )
    text = "steer an agent with the keyboard, in the browser, against policies"
    command = commands.add_parser("play", help=text, description=description, examples=examples)
    add_scenario(command)
    add_number(command.group(PLAY), "--agent", 0, "number of the agent that you steer, from 0", least=0)
    add_others(command, "scripted", "who plays all other agents")
    add_seed(command)
    text = f"speed in ticks per second, at most {FASTEST} (default: real time, which is 30 in the paper's variants)"
    command.group(PLAY).add_argument("--fps", type=_rate, metavar="RATE", help=text)
    add_page(command)
    add_common(command, "--record")
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Serve the game until Ctrl-C; the exit status. Raises PlayError."""
    given = {name: getattr(options, name) for name in ("agent", "others", "seed", "fps", "port", "host", "record")}
    play(scenario(options), browser=not options.no_browser, allow_hosts=options.allow_host, **given)
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
