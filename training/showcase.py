"""A typical episode of a pairing, shown: as a film, and as a page to play it in."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from outlast.components import Side
from outlast.envs.recording import Recording, Replay

from .evaluate import Evaluation, Meeting
from .matches import Games, role_of

SIZE, FPS = 512, 30  # pixels; frames a second, which is real time in the paper's variants


def shown(evaluation: Evaluation, meeting: Meeting, recording: Path, folder: Path) -> list[Path]:
    """Show the typical episode of a pairing in the folder: A-B.webm and A-B.html, each whole or not at all.

    recording: of all its episodes. Raises RecordingError, FilmError, PageError.
    """
    names = [evaluation.chosen[k].label for k in meeting.pair]
    sides = len(np.unique(evaluation.env.worlds[Side].side[0, evaluation.env.worlds.span("agent")]))
    title = f"{evaluation.scenario.name}: {' against '.join(_seated(names, sides, meeting.games))}"
    return show(recording, meeting.games, folder / "-".join(names), title)


def show(recording: Path, games: Games, target: Path, title: str) -> list[Path]:
    """Write the typical episode of a recorded match, as `target` with each of the two endings."""
    from outlast.envs.rendering.video import footage, write_film
    from outlast.envs.web.replay import write_page

    world, episode = games.typical()
    first, last = (int(run) for run in games.spans[world, episode])
    made = [target.with_name(target.name + ending) for ending in (".webm", ".html")]
    with _replayed(recording, world, first, last) as (replay, ticks):
        write_film(made[0], footage(replay.worlds, ticks, [world], size=SIZE), FPS)
    with _replayed(recording, world, first, last) as (replay, ticks):
        write_page(made[1], replay.worlds, ticks, [world], title=title)
    return made


def _seated(names: Sequence[str], count: int, games: Games) -> Iterator[str]:
    """Each name, and which of the sides it plays in the typical episode."""
    for role, name in enumerate(names):
        sides = [side for side in range(count) if role_of(side, *games.typical()) == role]
        yield f"{name} (side {', '.join(map(str, sides))})"


@contextlib.contextmanager
def _replayed(recording: Path, world: int, first: int, last: int) -> Iterator[tuple[Replay, Iterator[int]]]:
    """The worlds of a recording, and those runs from first to last in which that world took part."""
    with contextlib.closing(Replay(Recording.open(recording))) as replay:
        yield replay, _runs(replay, world, first, last)


def _runs(replay: Replay, world: int, first: int, last: int) -> Iterator[int]:
    for number in replay.ticks():
        if number >= first and replay.worlds.mode[world]:
            yield number
        if number == last:
            return
