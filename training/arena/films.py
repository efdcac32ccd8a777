"""Films and pages of typical episodes of an evaluation."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from outlast.envs.api.film import Looks, write_film_of
from outlast.envs.recording import Recording, Replay
from outlast.envs.rendering.words import fits
from outlast.envs.rollout.lineup import ROLES, role_of
from outlast.envs.scenarios.scenario import Scenario

from .match import MatchResults, Pairing
from .players import Contender

LEAST = 8  # minimum characters of a name in the title of a film
SIZE, FPS = 512, 30  # pixels; frames a second: real time in the paper's variants


def films(
    scenario: Scenario, chosen: Sequence[Contender], pairings: Sequence[Pairing], hidden: Path, folder: Path
) -> Iterator[Path]:
    """Make a film and a page of a typical episode of each pairing, and yield the path of each once it is written.

    hidden: The folder in which pairings are recorded. Raises RecordingError, FilmError, PageError.
    """
    for pairing in pairings:
        names = [chosen[k].label for k in pairing.pair]
        yield from _show(scenario, names, pairing.results, recording_of(hidden, pairing.pair), folder / "-".join(names))


def recording_of(folder: Path, pair: tuple[int, int]) -> Path:
    """Return the file in which a pairing is recorded."""
    return folder / f"{pair[0]}-{pair[1]}.rec"


def _show(
    scenario: Scenario, names: Sequence[str], results: MatchResults, recording: Path, target: Path
) -> Iterator[Path]:
    """Write the typical episode of a pairing beside `target`: as .webm and .html, each completely or not at all."""
    from outlast.envs.web.pages import write_page

    world, episode = results.typical()
    first, last = (int(record) for record in results.spans[world, episode])
    ticks = functools.partial(Replay.ticks, first=first, last=last, worlds=[world])
    film, page = (target.with_name(target.name + ending) for ending in (".webm", ".html"))
    with contextlib.closing(Replay(Recording.open(recording, scenario))) as replay:
        sides = _sides(replay.worlds.dims["sides"], world, episode)
        title = f"{film_players(names, sides)}, {scenario.name}"
        write_film_of(film, replay.worlds, ticks(replay), [world], Looks(size=SIZE, fps=FPS), title)
    with contextlib.closing(Replay(Recording.open(recording, scenario))) as replay:
        write_page(page, replay.worlds, ticks(replay), [world], title=f"{scenario.name}: {_players(names, sides)}")
    yield from (film, page)


def film_players(names: Sequence[str], sides: Sequence[str]) -> str:
    """Return the players with their sides, names shortened in the middle until both fit into a film's title."""
    for most in range(max(LEAST, *map(len, names)), LEAST - 1, -1):
        words = _players([_shortened(name, most) for name in names], sides)
        if fits(words, SIZE):
            break
    return words


def _players(names: Sequence[str], sides: Sequence[str]) -> str:
    return " against ".join(f"{name} ({own})" for name, own in zip(names, sides, strict=True))


def _shortened(name: str, most: int) -> str:
    return name if len(name) <= most else f"{name[: most // 2 - 1]}..{name[most // 2 - most + 1 :]}"


def _sides(count: int, world: int, episode: int) -> list[str]:
    """Return the sides that each role plays in an episode: "side 0", "sides 0 2"."""
    own = [[side for side in range(count) if role_of(side, world, episode) == role] for role in range(ROLES)]
    return [f"side{'s' * (len(each) > 1)} {' '.join(map(str, each))}" for each in own]
