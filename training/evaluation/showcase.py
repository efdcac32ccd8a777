"""A typical episode of a pairing: as a film, and as a page that replays it."""

import contextlib
import functools
from collections.abc import Sequence
from pathlib import Path

from outlast.envs.films import Looks, write_film_of
from outlast.envs.recording import Recording, Replay
from outlast.envs.rendering.layers.title import fits
from outlast.envs.rollout.lineup import ROLES, role_of

from .evaluation import Evaluation
from .matches import MatchResults
from .pairing import Pairing

LEAST = 8  # characters of a name that the title of a film keeps, at least
SIZE, FPS = 512, 30  # pixels; frames a second, which is real time in the paper's variants


def show_pairing(evaluation: Evaluation, pairing: Pairing, recording: Path, folder: Path) -> list[Path]:
    """Write the typical episode of a pairing into the folder: A-B.webm and A-B.html, each whole or not at all.

    recording: The file in which all its episodes are recorded. Raises RecordingError, FilmError, PageError.
    """
    names, results = [evaluation.chosen[k].label for k in pairing.pair], pairing.results
    sides, game = _sides(evaluation.env.worlds.dims["sides"], results), evaluation.scenario.name
    shown, target = f"{film_players(names, sides)}, {game}", folder / "-".join(names)
    from outlast.envs.web.replay import write_page

    world, episode = results.typical()
    first, last = (int(record) for record in results.spans[world, episode])
    made = [target.with_name(target.name + ending) for ending in (".webm", ".html")]
    ticks = functools.partial(Replay.ticks, first=first, last=last, worlds=[world])
    with contextlib.closing(Replay(Recording.open(recording, evaluation.scenario))) as replay:
        write_film_of(made[0], replay.worlds, ticks(replay), [world], Looks(size=SIZE, fps=FPS), shown)
    with contextlib.closing(Replay(Recording.open(recording, evaluation.scenario))) as replay:
        write_page(made[1], replay.worlds, ticks(replay), [world], title=f"{game}: {_players(names, sides)}")
    return made


def film_players(names: Sequence[str], sides: Sequence[str]) -> str:
    """Return who plays which sides, with names shortened in the middle until a film's title has room for both."""
    for most in range(max(LEAST, *map(len, names)), LEAST - 1, -1):
        words = _players([_shortened(name, most) for name in names], sides)
        if fits(words, SIZE):
            break
    return words


def _players(names: Sequence[str], sides: Sequence[str]) -> str:
    return " against ".join(f"{name} ({own})" for name, own in zip(names, sides, strict=True))


def _shortened(name: str, most: int) -> str:
    return name if len(name) <= most else f"{name[: most // 2 - 1]}..{name[most // 2 - most + 1 :]}"


def _sides(count: int, results: MatchResults) -> list[str]:
    """The sides that each role plays in the typical episode: "side 0", "sides 0 2"."""
    own = [[side for side in range(count) if role_of(side, *results.typical()) == role] for role in range(ROLES)]
    return [f"side{'s' * (len(each) > 1)} {' '.join(map(str, each))}" for each in own]
