"""A typical episode of a pairing: as a film, and as a page that replays it."""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

from outlast.envs.recording import Recording, Replay
from outlast.envs.rollout.sides import role_of

from .evaluation import Evaluation, Pairing
from .matches import MatchResults

SIZE, FPS = 512, 30  # pixels; frames a second, which is real time in the paper's variants


def show_pairing(evaluation: Evaluation, pairing: Pairing, recording: Path, folder: Path) -> list[Path]:
    """Write the typical episode of a pairing into the folder: A-B.webm and A-B.html, each whole or not at all.

    recording: of all its episodes. Raises RecordingError, FilmError, PageError.
    """
    names, results = [evaluation.chosen[k].label for k in pairing.pair], pairing.results
    players = _with_sides(names, evaluation.env.worlds.dims["sides"], results)
    title, target = f"{evaluation.scenario.name}: {' against '.join(players)}", folder / "-".join(names)
    from outlast.envs.rendering.video import footage, write_film
    from outlast.envs.web.replay import write_page

    world, episode = results.typical()
    first, last = (int(record) for record in results.spans[world, episode])
    made = [target.with_name(target.name + ending) for ending in (".webm", ".html")]
    ticks = functools.partial(Replay.ticks, first=first, last=last, worlds=[world])
    with contextlib.closing(Replay(Recording.open(recording))) as replay:
        write_film(made[0], footage(replay.worlds, ticks(replay), [world], size=SIZE), FPS)
    with contextlib.closing(Replay(Recording.open(recording))) as replay:
        write_page(made[1], replay.worlds, ticks(replay), [world], title=title)
    return made


def _with_sides(names: Sequence[str], count: int, results: MatchResults) -> Iterator[str]:
    """Each name with the sides that it plays in the typical episode."""
    for role, name in enumerate(names):
        sides = [side for side in range(count) if role_of(side, *results.typical()) == role]
        yield f"{name} (side {', '.join(map(str, sides))})"
