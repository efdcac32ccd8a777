"""outlast.play: a game against policies in one call. The command `outlast play` is a front end to it."""

import asyncio
import contextlib
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, Unpack

from outlast.ecs.kernels.integers import is_whole

from ..errors import PlayError
from ..rollout.lineup import Others, entries_of, load_policies
from ..rollout.saved import text_of
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords, options_of, resolve
from ..scenarios.scenario import Scenario
from ..web.gate import HOST, Site, announce
from .options import OUTPUT, PLAY, option

FASTEST = 1000  # ticks per second
PAGE = "page"  # the title of a group of options


@checks_keywords
def play(
    game: str | Scenario,
    *,
    agent: int = 0,
    others: Others = "scripted",
    seed: int = 0,
    fps: float | None = None,
    port: int = 0,
    host: str = HOST,
    allow_hosts: str | Sequence[str] = (),
    browser: bool = True,
    record: str | os.PathLike[str] | None = None,
    **numbers: Unpack[Numbers],
) -> None:
    """Serve a page in which a person controls an agent, until Ctrl-C.

    >>> outlast.play("teams_3", others="runs/teams_3-fast-0/steps_0010000000.zip", record="game.rec")

    The address is printed. It can be opened only with the token that it contains, and by default only on this machine.

    Args:
        game: A scenario or its name: that of a variant ("ffa_2+steering"), FILE.py:NAME, package.module:NAME.
        agent: Number of the agent that you steer, from 0.
        others: Who plays all other agents: a policy, or several with weights, as in scripted:0.5,FILE.zip:0.5, of which
            one is drawn for each episode of each world (default: scripted). Also as a dict: {policy: weight}.
        seed: Seed of all random numbers: the same seed gives the same episodes.
        fps: Speed in ticks per second, at most 1000 (default: real time, which is 30 in the paper's variants). An
            episode begins at half that speed.
        port: Port on which the page is served (default: 0, any free port).
        host: Address of the interface on which the page is served; 0.0.0.0: all of them, as needed in a container
            (default: 127.0.0.1, this machine only).
        allow_hosts: Let in browsers that reach the page at this name and port, through a tunnel, a container's port or
            a proxy; the address with the first one is printed. One or several.
        browser: Whether to open the page, whose address is printed, in a browser.
        record: Record every tick in a new file, for `outlast replay FILE`.
        **numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    Raises:
        ScenarioError: The scenario is unknown.
        NumberError: A number is out of its range, or does not exist (then it is a KeywordError).
        UsageError: One of the others does not exist or cannot play there.
        RecordingError: The recording cannot be written.
        PlayError: The agent does not exist, the port is taken, the host is not one of this machine, an allowed place is
            not of the form NAME:PORT, or an event loop is already running, as in a notebook.
    """
    from ..web.game import Game  # imported here, as only play needs websockets
    from ..web.game import play as serve

    _check(fps, port)
    site = Site(port, host, (allow_hosts,) if isinstance(allow_hosts, str) else tuple(allow_hosts))
    entries = entries_of(others)
    world, chosen = load_policies([each for each, _ in entries], resolve(game, numbers, options_of(play)), seed)
    players = {player: weight for player, (_, weight) in zip(chosen, entries, strict=True)}
    name = text_of(others) if isinstance(others, (str, os.PathLike)) else ""
    made = Game(world, agent=agent, others=players, seed=seed, record=record, name=name)

    def opened(address: str) -> None:
        announce(f"{world.name}: you are agent {agent} at {address}\nCtrl-C ends the game.", address, browser)

    with contextlib.closing(made), contextlib.suppress(KeyboardInterrupt):
        asyncio.run(serve(made, fps or 1 / made.world["seconds"], site, opened))


@dataclass(frozen=True)
class PlayOptions:
    """The options of `outlast.play` that are flags, but for those of PageOptions."""

    described = play
    agent: int = option(0, PLAY, metavar="N", least=0)
    others: str = option(lambda: {"scripted": 1.0}, PLAY, metavar="NAMES")
    seed: int = option(0, PLAY, metavar="N", least=0, most=2**64 - 1)
    fps: float | None = option(None, PLAY, metavar="RATE")
    record: str | None = option(None, OUTPUT, metavar="FILE")


@dataclass(frozen=True)
class PageOptions:
    """The address of a page, of `outlast.play` or another one."""

    described = play
    port: int = option(0, PAGE, metavar="PORT", least=0, most=65535)
    host: str = option(HOST, PAGE, metavar="ADDRESS")
    allow_hosts: str | Collection[str] = option((), PAGE, flag="--allow-host", metavar="NAME:PORT", many=True)
    browser: bool = option(True, PAGE, flag="--no-browser")


def _check(fps: Any, port: Any) -> None:
    """Raise PlayError if the rate or the port is not possible, or an event loop already runs in this thread."""
    if fps is not None and not (isinstance(fps, int | float) and 0 < fps <= FASTEST):
        raise PlayError(f"fps = {fps!r}: a number above 0, up to {FASTEST}, is needed")
    if not is_whole(port, 0, 65535):
        raise PlayError(f"port = {port!r}: an integer from 1 to 65535 is needed, or 0 for a free one")
    loop = None
    with contextlib.suppress(RuntimeError):
        loop = asyncio.get_running_loop()
    if loop is not None:
        raise PlayError("an event loop runs here already, as in a notebook: run `outlast play` in a terminal")
