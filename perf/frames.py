"""Time drawing and the writing of films, in frames per second.

    python -m perf.frames [--save MACHINE]

The scripted policy plays worlds of teams_3, in the middle of the game. draw:
one world with the usual layers, on one core, in CPU time. The other rows write
films of frames that have been drawn before, and are timed from the first byte
until the film has been read back, in wall time, as FFmpeg uses all cores for
.mp4 and .gif. Each number is the best of several rounds.
"""

import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from outlast import make_vec
from outlast.drawing import FILM_LAYERS, LAYERS, CamerasLayer, Layer
from outlast.ecs import Worlds
from outlast.envs.rendering.films import CODECS, write_film
from outlast.envs.rendering.rgb import draw
from outlast.envs.rollout.local import ticks
from outlast.envs.rollout.policies import scripted_policy
from perf.table import Table, options

SIZES = (256, 512)  # pixels
START, LENGTH = 300, 120  # ticks before a film, and its frames
WORLDS = 16
ROUNDS = 3


def main() -> None:
    """Draw, then write every format."""
    given = options(__doc__).parse_args()
    cv2.setNumThreads(1)
    table = Table("frames", "frames a second", *(f"{size} pixels" for size in SIZES))
    looks = {
        "draw": LAYERS,
        "draw, vision and lines, too": (*LAYERS, CamerasLayer()),
        "draw, with what films show beside it": FILM_LAYERS,
    }
    for name, layers in looks.items():
        table.add(name, *(f"{drawing(size, layers):,.0f}" for size in SIZES))
    films = [filmed(size) for size in SIZES]
    for suffix in tqdm(CODECS, unit="format"):
        table.add(f"write {suffix or 'a folder of .png'}", *(f"{writing(film, suffix):,.0f}" for film in films))
    table.finish(given.save)


def drawing(size: int, layers: Iterable[Layer]) -> float:
    """Frames drawn in a second of processor time."""
    worlds, shown = played(), list(layers)
    return rate(lambda k: draw(worlds, k % WORLDS, size, shown), 200, time.process_time)


def writing(film: list[np.ndarray], suffix: str) -> float:
    """Frames written and read back in a second."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film{suffix}"
        return len(film) * rate(lambda k: write_film(path, film, 30), 1, time.perf_counter)


def rate(call: Callable[[int], object], count: int, clock: Callable[[], float]) -> float:
    """Calls a second, in the best of ROUNDS rounds of `count` calls; one round to warm up is not counted."""
    seconds = []
    for _ in range(ROUNDS + 1):
        start = clock()
        for k in range(count):
            call(k)
        seconds.append(clock() - start)
    return count / min(seconds[1:])


def played() -> Worlds:
    """Worlds in the middle of the game."""
    env = make_vec("teams_3", WORLDS, seed=0, copy=False)
    for _ in ticks(env, scripted_policy(env), START):
        pass
    return env.worlds


def filmed(size: int) -> list[np.ndarray]:
    """Frames of one world, tick after tick."""
    env = make_vec("teams_3", 1, seed=0, copy=False)
    return [draw(env.worlds, 0, size) for tick in ticks(env, scripted_policy(env), START + LENGTH - 1) if tick >= START]


if __name__ == "__main__":
    main()
