"""outlast.film: a film of worlds in one call. `outlast frames` and `outlast replay --out` are front ends to it."""

import contextlib
import logging
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

from outlast.ecs import Worlds
from outlast.ecs.kernels.integers import is_whole

from ..core.validation import check_count
from ..errors import FilmError
from ..recording import Recording, Replay
from ..recording.replay import last_tick, rows_of
from ..rendering.canvas import Layer
from ..rendering.films import check_film, ending, write_film
from ..rendering.layers import FILM_LAYERS, select
from ..rendering.rgb import FPS, check_pictures, checked_layers, footage
from ..rendering.scene import Scene
from ..rollout.lineup import Other, Others, entries_of
from ..rollout.local import ticks
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords, options_of, resolve
from ..scenarios.scenario import Scenario
from .options import PLAY, option
from .rollout import check_decided, worlds_of

LOGGER = logging.getLogger(__name__)
STEPS = 150  # by default (5 seconds)
PICTURES = "pictures"  # the title of a group of options
REPLAYED = 16  # worlds of a recording at most, by default
HOLD = 0.8  # seconds for which films show the end of an episode; folders of pictures do not
SOURCES = (".py", ".json")  # endings of files of scenarios; all other files are taken for recordings
RECORDINGS = ".rec"  # the usual ending of recordings

Count = Callable[[int], object]  # called with the number of frames so far


@checks_keywords
def film(
    game: str | os.PathLike[str] | Scenario | Recording,
    out: str | os.PathLike[str],
    *,
    policy: Other | None = None,
    others: Others | None = None,
    steps: int | None = None,
    worlds: int | Sequence[int] | None = None,
    seed: int | None = None,
    size: int = 512,
    mosaic: tuple[int, int] | None = None,
    views: str = "",
    layers: Iterable[Layer] = (),
    every: int = 1,
    fps: int = FPS,
    progress: Count = lambda count: None,
    **numbers: Unpack[Numbers],
) -> Path:
    """Play worlds, or replay a recording, and write what happens as a film or as a folder of pictures.

    >>> outlast.film("ffa_2", "duel.webm")
    >>> outlast.film("mygame.py:arena", "arena.apng", policy="random", mosaic=(2, 2), size=256, n_agents=6)
    >>> outlast.film("fights.rec", "fights.webm", worlds=[0, 3])

    The film is complete or not there at all, even after Ctrl-C or when the disk is full.

    Args:
        game: A scenario or its name: that of a variant ("ffa_2+steering"), FILE.py:NAME, package.module:NAME. Or an
            outlast.Recording or its path, which is replayed and compared with its digests.
        out: NAME.webm, .apng, .mp4 or .gif, in which the end of an episode is held for a moment; without an ending a
            folder of numbered PNGs, in which it is not.
        policy: Who plays: random, noop, scripted, camper, hunter, hoarder, healer, a saved policy (a model's name,
            FILE.zip, FILE.safetensors or the folder of a run, whose newest checkpoint is taken), or FILE.py:FUNCTION of
            your own (default scripted). In Python also a function from the observations to the actions of all worlds;
            if it has a method `reset`, that is called with the worlds in which an episode begins, bool (worlds,),
            before it acts there.
        others: Opponents of the policy, which plays one side, another one in each episode, while they play all others:
            a policy, or several with weights, as in scripted:0.5,FILE.zip:0.5, of which one is drawn for each episode
            of each world (default: the policy plays all sides). Also as a dict: {policy: weight}.
        steps: Steps to play in each world (default 150). Of a recording, by default all.
        worlds: Number of worlds to play and draw (default: as many as the mosaic has room for, or 1). For a recording
            also the numbers of those to show, by default at most the first 16.
        seed: Seed of all random numbers: the same seed gives the same episodes (default 0).
        size: Side of each world's picture in pixels, 64 to 4096. Frames are higher, as a title, a scoreboard and the
            last deaths are shown as well.
        mosaic: Rows and columns of worlds in a frame, such as 2x3 (default: nearly a square). In Python (2, 3).
        views: Layers to add or to leave out, as in +vision,-ids,+FILE.py:LAYER: title, room, zone, vision, lines,
            lidar, heals, items, others, boxes, walls, looks, melee, agents, ids, hits, health, inventory, steps,
            legend, feed, end, scores (default: all but vision, lines, lidar, steps).
        layers: Layers of your own to show as well; see docs/mechanic.md.
        every: Draw only every Nth step, and the ends of episodes.
        fps: Frames per second; for films only. 30 is real time.
        progress: Called after each frame with the number of frames so far.
        **numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    Returns:
        The path of the film.

    Raises:
        ScenarioError: The scenario is unknown.
        NumberError: A number is out of its range, or does not exist (then it is a KeywordError).
        UsageError: A policy does not exist or cannot play there.
        RecordingError: The recording is damaged or cannot be replayed.
        ReplayError: A tick of the recording is not what it was.
        FilmError: A path, size, view or number of worlds is not valid, or the film could not be written.
        TypeError: A layer is not a layer.
    """
    _check(STEPS if steps is None else steps, mosaic, views)
    check_pictures(size, mosaic or (1, 1), every)  # before worlds are made: `mosaic` decides their number
    check_film(out, fps)
    looks, more = Looks(size, mosaic, views, every, fps), tuple(checked_layers(layers))
    if (recording := _recording(game)) is not None:
        check_decided("the recording", FilmError, policy=policy, others=others, seed=seed, **numbers)
        with contextlib.closing(Replay(recording)) as replay:
            shown, played = _replayed(replay, steps, worlds, looks)
            return write_film_of(out, replay.worlds, played, shown, looks, recording.scenario.name, progress, more)
    asked = resolve(os.fspath(game) if isinstance(game, os.PathLike) else game, numbers, options_of(film))  # type: ignore[arg-type]
    if worlds is not None and not is_whole(worlds, 1):
        raise FilmError(f"worlds = {worlds!r}: how many to play is needed, 1 or more; numbers are for recordings")
    count = math.prod(mosaic or (1, 1)) if worlds is None else int(worlds)
    env, act, _ = worlds_of(asked, policy or "scripted", others, count, seed=seed or 0)
    with contextlib.closing(env):
        played = ticks(env, act, STEPS if steps is None else steps)
        title = ", ".join([env.scenario.name, _players(policy or "scripted", others)])
        return write_film_of(out, env.worlds, played, range(count), looks, title, progress, more)


@dataclass(frozen=True)
class Looks:
    """The look of a film: the options of `outlast.film` about pictures."""

    described = film
    size: int = option(512, PICTURES, metavar="N", least=1)
    mosaic: tuple[int, int] | None = option(None, PICTURES, metavar="RxC")
    views: str = option("", PICTURES, metavar="NAMES")
    every: int = option(1, PICTURES, metavar="N", least=1)
    fps: int = option(FPS, PICTURES, metavar="N", least=1)


@dataclass(frozen=True)
class FilmOptions:
    """The other options of `outlast.film` that are flags."""

    described = film
    worlds: int | None = option(None, PLAY, metavar="N", least=1)
    steps: int = option(STEPS, PLAY, metavar="N", least=1)
    policy: str = option("scripted", PLAY, metavar="NAME")
    others: str | None = option(None, PLAY, metavar="NAMES")
    seed: int = option(0, PLAY, metavar="N", least=0, most=2**64 - 1)


def _check(steps: Any, mosaic: Any, views: Any) -> None:
    """Raise FilmError before worlds are made if a film is not possible; footage checks the rest."""
    if mosaic is not None and (not isinstance(mosaic, Sequence) or len(mosaic) != 2):
        raise FilmError(f"mosaic = {mosaic!r}: rows and columns are needed, as in (2, 3)")
    try:
        check_count("steps", steps, 0)
        for name, side in zip(("rows", "columns"), mosaic or (), strict=False):
            check_count(f"mosaic, {name}", side, 1)
    except ValueError as error:
        raise FilmError(str(error)) from None
    if not isinstance(views, str):
        raise FilmError(f'views = {views!r}: a text is needed, as in "+vision,-scores"')
    select(views)


def write_film_of(
    out: str | os.PathLike[str],
    worlds: Worlds,
    played: Iterable[object],
    shown: Sequence[int],
    looks: Looks,
    title: str,
    progress: Count = lambda count: None,
    layers: Iterable[Layer] = (),
) -> Path:
    """Write the film of the worlds `shown` while `played` runs them, and return its path; see `film` and `footage`.

    Worlds that a mosaic has no room for are left out, with a message. title: The game and who plays. Raises FilmError.
    """
    if looks.mosaic is not None and len(shown) > (room := math.prod(looks.mosaic)):
        LOGGER.warning("a mosaic of %dx%d has room for %d of the %d worlds", *looks.mosaic, room, len(shown))
        shown = shown[:room]
    settings: dict[str, Any] = {"size": looks.size, "mosaic": looks.mosaic, "every": looks.every}
    chosen, hold = [*select(looks.views), *layers], round(HOLD * looks.fps) if ending(Path(out)) else 0
    frames = footage(worlds, played, shown, title=title, hold=hold, layers=chosen, **settings)
    scene = Scene(worlds, shown[0])
    for layer in chosen:
        if layer not in FILM_LAYERS and not layer.fits(scene):  # the user asked for this layer
            lacking = " and ".join(need.__name__ for need in layer.needs if need not in scene)
            LOGGER.warning("%s shows nothing: the game has no %s", type(layer).__name__, lacking or "use for it")
    write_film(out, _counted(frames, progress), looks.fps)
    return Path(out)


def _counted(frames: Iterable[Any], progress: Count) -> Iterator[Any]:
    for count, frame in enumerate(frames, 1):
        yield frame
        progress(count)


def _players(policy: Other, others: Others | None) -> str:
    """Return in words who plays."""
    players = [policy, *(each for each, _ in entries_of(others))] if others is not None else [policy]
    own, *names = (
        Path(each).stem if isinstance(each, (str, os.PathLike)) else getattr(each, "__name__", type(each).__name__)
        for each in players
    )
    return f"{own} policy" + (f" against {' or '.join(names)}" if names else "")


def _recording(game: str | os.PathLike[str] | Scenario | Recording) -> Recording | None:
    """Return the recording that `game` is, or whose path it is; None if it is a scenario or names one."""
    if not isinstance(game, str | os.PathLike):
        return game if isinstance(game, Recording) else None
    name = os.fspath(game)
    if os.path.isfile(name) and not name.endswith(SOURCES):
        return Recording.open(name)
    place = name.partition("+")[0]  # "FILE.json+health_cap" is a scenario: its file comes before "+"
    if place.endswith(RECORDINGS) or (os.path.dirname(place) and ":" not in place and not place.endswith(SOURCES)):
        raise FilmError(f"{name}: {'it is a folder' if os.path.isdir(name) else 'the file does not exist'}")
    return None


def _replayed(
    replay: Replay, steps: int | None, worlds: int | Sequence[int] | None, looks: Looks
) -> tuple[Sequence[int], Iterator[int]]:
    """Return the worlds to show, and an iterator that replays them."""
    most = replay.worlds.count
    room = math.prod(looks.mosaic) if looks.mosaic else REPLAYED
    asked: Any = min(room, most) if worlds is None else worlds
    if not (is_whole(asked) or isinstance(asked, Iterable)):
        raise FilmError(f"worlds = {asked!r}: how many are to be shown, or their numbers, are needed")
    if not isinstance(asked, Iterable) and not 1 <= asked <= most:
        raise FilmError(
            f"worlds = {asked}: the recording has {most}; how many of them, or their numbers in a list, are needed"
        )
    shown = rows_of(replay.recording, asked) if isinstance(asked, Iterable) else list(range(int(asked)))
    return shown, replay.ticks(last=last_tick(replay.recording, 0, steps), worlds=shown)
