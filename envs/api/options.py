# ruff: noqa: RUF009  # fields
"""Options of `outlast.rollout`, `film`, `play` and `check`, and of the commands that are front ends to them."""

import os
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from ..core.options import MACHINE, OUTPUT, PLAY, option
from ..rendering.layers import FILM_LAYERS_BY_NAME, FILM_OPTIONAL
from ..rendering.rgb import FPS
from ..rollout.lineup import OWN_AS, Others
from ..rollout.policies import POLICIES
from ..rollout.saved import SAVED_AS
from ..web.gate import HOST

WORLDS = 1024  # how many worlds of a rollout play by default
STEPS = 150  # steps of a film by default (5 seconds)
FASTEST = 1000  # ticks per second of a game that is played
PAGE, PICTURES = "page", "pictures"  # groups of options


def _policy(default: str, **more: Any) -> Any:
    text = f"who plays: {', '.join(POLICIES)}, a saved policy ({SAVED_AS}, whose newest checkpoint is taken), or "
    text += f"{OWN_AS} of your own"
    python = (
        "In Python also a function from the observations to the actions of all worlds; if it has a method `reset`, "
    )
    python += "that is called with the worlds in which an episode begins, bool (worlds,), before it acts there."
    return option(default, PLAY, text, metavar="NAME", python=python, **more)


def _others(default: str | None, text: str, **more: Any) -> Any:
    text += ": a policy, or several with weights, as in scripted:0.5,FILE.zip:0.5, of which one is drawn for each "
    text += "episode of each world" + (
        f" (default: {default})" if default else " (default: the policy plays all sides)"
    )
    usual = (lambda: {default: 1.0}) if default else None
    return option(usual, PLAY, text, metavar="NAMES", **{"python": "Also as a dict: {policy: weight}.", **more})


def _seed(**more: Any) -> Any:
    text = "seed of all random numbers: the same seed gives the same episodes"
    return option(0, PLAY, text, metavar="N", least=0, most=2**64 - 1, **more)


def _file(text: str, takes: str = "File | None = None") -> Any:
    return option(None, OUTPUT, text, metavar="FILE", takes=takes)


RECORD = "record every tick in a new file, for `outlast replay FILE`"
OPPONENTS = "opponents of the policy, which plays one side, another one in each episode, while they play all others"


@dataclass(frozen=True)
class RolloutOptions:
    """The options of `outlast.rollout`."""

    worlds: int = option(WORLDS, PLAY, "number of worlds", metavar="N", least=1, takes="int | None = None")
    episodes: int | None = option(None, PLAY, "episodes to play in each world (default: 1)", metavar="N", least=1)
    steps: int = option(
        0,
        PLAY,
        "steps to play in each world, instead of episodes (default: none)",
        python="Episodes that end in them count, so that means lean towards short ones.",
        metavar="N",
        least=1,
    )
    policy: str = _policy("random", takes='Other = "random"')
    others: Others | None = _others(
        None,
        OPPONENTS,
        python="Also as a dict: {policy: weight}. `outcomes` of the summary counts who wins against each.",
    )
    seed: int = _seed(takes="int | None = None")
    csv: str | None = _file(
        "write a table with a row for each episode and all its statistics to a new file, NAME.csv or NAME.parquet"
    )
    events: str | None = _file(
        "write a table of events (who hit, killed, used, gave or broke what) to a new file, NAME.csv or NAME.parquet"
    )
    record: str | None = _file(RECORD)
    record_policy: bool = option(
        False,
        OUTPUT,
        "record, with the ticks, the action probabilities, values and attention of a saved policy, which pages of "
        "`outlast replay --html` show",
    )
    threads: int = option(
        1,
        MACHINE,
        "threads that share the worlds, with the same results",
        least=1,
        metavar="N",
        takes="int | None = None",
    )
    specialize: bool = option(
        False,
        MACHINE,
        "compile for this game alone: steps are faster, but compiling takes some ten seconds the first time",
    )
    interpret: Collection[str] = option(
        (),
        MACHINE,
        "run this system, such as melee.aim, as Python, so that breakpoints and print work in it",
        python="In Python a list of them.",
        metavar="SYSTEM",
        many=True,
    )
    keep: bool = option(False, "", "keep the statistics of each episode, for `arrays` of the summary")
    watch: Any = option(
        None,
        "",
        "called after the reset and after every step with the worlds that still count, bool (worlds,)",
        takes="Watch | None = None",
    )


@dataclass(frozen=True)
class Looks:
    """The look of a film."""

    size: int = option(
        512,
        PICTURES,
        "side of each world's picture in pixels, 64 to 4096",
        metavar="N",
        least=1,
        python="Frames are higher, as a title, a scoreboard and the last deaths are shown as well.",
    )
    mosaic: tuple[int, int] | None = option(
        None,
        PICTURES,
        "rows and columns of worlds in a frame, such as 2x3 (default: nearly a square)",
        metavar="RxC",
        python="In Python (2, 3).",
    )
    views: str = option(
        "",
        PICTURES,
        f"layers to add or to leave out, as in +vision,-ids,+FILE.py:LAYER: {', '.join(FILM_LAYERS_BY_NAME)} (default: "
        f"all but {', '.join(FILM_OPTIONAL)})",
        metavar="NAMES",
    )
    every: int = option(1, PICTURES, "draw only every Nth step, and the ends of episodes", metavar="N", least=1)
    fps: int = option(
        FPS, PICTURES, "frames per second; for films only", metavar="N", least=1, python="30 is real time."
    )


@dataclass(frozen=True)
class FilmOptions:
    """The options of `outlast.film` beside those of Looks."""

    worlds: int | None = option(
        None,
        PLAY,
        "number of worlds to play and draw (default: as many as the mosaic has room for, or 1)",
        python="For a recording also the numbers of those to show, by default at most the first 16.",
        metavar="N",
        least=1,
        takes="int | Sequence[int] | None = None",
    )
    steps: int = option(
        STEPS,
        PLAY,
        "steps to play in each world",
        python="Of a recording, by default all.",
        metavar="N",
        least=1,
        takes="int | None = None",
    )
    policy: str = _policy("scripted", takes="Other | None = None")
    others: Others | None = _others(None, OPPONENTS)
    seed: int = _seed(takes="int | None = None")


@dataclass(frozen=True)
class PageOptions:
    """The address of a page."""

    port: int = option(
        0, PAGE, "port on which the page is served (default: 0, any free port)", metavar="PORT", least=0, most=65535
    )
    host: str = option(
        HOST,
        PAGE,
        "address of the interface on which the page is served; 0.0.0.0: all of them, as needed in a container "
        f"(default: {HOST}, this machine only)",
        metavar="ADDRESS",
    )
    allow_hosts: str | Collection[str] = option(
        (),
        PAGE,
        "let in browsers that reach the page at this name and port, through a tunnel, a container's port or a proxy; "
        "the address with the first one is printed",
        python="One or several.",
        flag="--allow-host",
        metavar="NAME:PORT",
        many=True,
        takes="str | Sequence[str] = ()",
    )
    browser: bool = option(True, PAGE, "open the page, whose address is printed, in a browser", flag="--no-browser")


@dataclass(frozen=True)
class PlayOptions:
    """The options of `outlast.play` beside those of PageOptions."""

    agent: int = option(0, PLAY, "number of the agent that you steer, from 0", metavar="N", least=0)
    others: Others = _others("scripted", "who plays all other agents", takes='Others = "scripted"')
    seed: int = _seed()
    fps: float | None = option(
        None,
        PLAY,
        f"speed in ticks per second, at most {FASTEST} (default: real time, which is 30 in the paper's variants)",
        python="An episode begins at half that speed.",
        metavar="RATE",
    )
    record: str | os.PathLike[str] | None = _file(RECORD, takes="str | os.PathLike[str] | None = None")


@dataclass(frozen=True)
class LayoutOptions:
    """The options of `outlast layout`."""

    worlds: int = option(1, PLAY, "number of worlds to draw", metavar="N", least=1)
    seed: int = _seed()


@dataclass(frozen=True)
class CheckOptions:
    """The options of `outlast.check`."""

    worlds: int = option(8, PLAY, "number of worlds", metavar="N", least=1)
    steps: int = option(300, PLAY, "ticks to play in each world", metavar="N", least=1)
    seed: int = _seed()
