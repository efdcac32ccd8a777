"""outlast layout: show walls as worlds begin with them, or write them down as a floor plan."""

import argparse
import contextlib
import logging
import math
from pathlib import Path
from typing import Any

import numpy as np

from outlast.components import Shape
from outlast.ecs import Worlds
from outlast.systems import Walls

from ..api.make import make_vec
from ..api.options import LayoutOptions
from ..core.options import GAME, OUTPUT
from ..errors import ScenarioError, UsageError
from ..rendering import opencv as cv2
from ..rendering.canvas import LARGEST, SMALLEST
from ..rendering.rgb import draw
from ..rendering.video.footage import WIDEST
from ..scenarios.floor_parts import in_words
from ..scenarios.floor_plan import GENERATORS, LAYOUT, FloorPlan
from ..storage.atomic_write import atomic_write
from ..storage.outputs import check_file
from .options import VARIANT, add_changes, add_number, add_options, path, scenario
from .options import output as written

LOGGER = logging.getLogger(__name__)
GAP, SIZE = 8, 384  # pixels, between two pictures and along a side of one


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "draw the walls of worlds, or write them to a floor plan"
    description = (
        "Draw worlds with walls inside the room as they begin, or write the walls of one world to a floor plan, a file "
        "that --layout of other commands takes."
    )
    examples = [
        ("layout rooms --seed 3 --worlds 9 --out rooms.png", "a picture of nine worlds among rooms with doors"),
        ("layout maze --set maze_columns=8 --out maze.json", "a maze as a floor plan, to play in it again"),
    ]
    command = commands.add_parser("layout", help=text, description=description, examples=examples)
    game = command.group(GAME)
    game.add_argument("layout", type=path, metavar="LAYOUT", help=f"which walls: {LAYOUT}")
    game.add_argument(
        "--variant", default="ffa_3", metavar="VARIANT", help=f"where the walls stand: {VARIANT} (default: ffa_3)"
    )
    add_changes(command)
    add_options(command, LayoutOptions)
    output = command.group(OUTPUT)
    add_number(output, "--size", str(SIZE), "side of each world's picture in pixels, 64 to 4096, for a .png only")
    text = "what to write: NAME.png for a picture, NAME.html for a web page, or NAME.json for a floor plan, of one "
    text += "world only"
    output.add_argument("--out", type=written(_check), required=True, metavar="FILE", help=text)
    command.set_defaults(run=run)


def _check(path: str) -> None:
    plan = path.endswith(".json")
    what = "floor plans" if plan else "layouts"
    check_file(path, what, UsageError, endings=(".png", ".html", ".json"), new=plan)


def run(options: argparse.Namespace) -> int:
    """Begin episodes, and write what they begin with; the exit status."""
    path = Path(options.out)
    if options.size is not None and path.suffix != ".png":
        raise UsageError(f"--size {options.size} is for pictures: write a .png, or leave it out")
    size = SIZE if options.size is None else options.size
    if not SMALLEST <= size <= LARGEST:
        raise UsageError(f"--size {size}: pixels from {SMALLEST} to {LARGEST} are needed")
    if path.suffix == ".json" and options.worlds > 1:
        raise UsageError(f"--out {options.out} is for the floor plan of one world; leave --worlds out, or write a .png")
    if path.suffix == ".png" and (side := columns_of(options.worlds) * (size + GAP)) > WIDEST:
        raise UsageError(
            f"--worlds {options.worlds} of --size {size} are {side} pixels wide; at most {WIDEST} are possible: take "
            "fewer or smaller ones"
        )
    from ..web.replay.write import write_page

    with contextlib.closing(make_vec(scenario(options), options.worlds, seed=options.seed, copy=False)) as env:
        env.reset()
        if options.layout not in GENERATORS:
            _warn_of_parts(options.layout, env.worlds)
        try:
            if path.suffix == ".json":
                if options.layout not in GENERATORS and FloorPlan.load(options.layout).starts:
                    LOGGER.warning("%s has start areas, which are not written: walls are", options.layout)
                FloorPlan.of_world(env.worlds).save(path)
            elif path.suffix == ".html":
                write_page(path, env.worlds, [0], range(env.num_worlds), title=f"{options.layout}: {env.scenario.name}")
            else:
                _write_picture(path, [draw(env.worlds, w, size) for w in range(env.num_worlds)])
        except OSError as error:
            raise UsageError(f"--out {options.out} cannot be written: {error.strerror}") from error
    print(options.out)
    return 0


def _warn_of_parts(name: str, worlds: Worlds) -> None:
    """Log a warning if agents cannot get everywhere on the floor plan in a file."""
    plan = FloorPlan.load(name)
    width = 2 * float(worlds[Shape].radius[:, worlds.span("agent")].max(initial=0))
    for walls in worlds.modules:
        if isinstance(walls, Walls) and width > 0:
            try:
                parts = plan.parts(width, walls.inside(worlds.layout))
            except ScenarioError as error:  # it is played in all the same
                LOGGER.warning("%s: whether agents can get everywhere was not found out: %s", name, error)
                continue
            if words := in_words(parts, [owner for owner, *_ in plan.starts], width):
                LOGGER.warning("%s: %s", name, words)


def columns_of(worlds: int) -> int:
    """Return pictures side by side, of so many worlds."""
    return math.ceil(math.sqrt(worlds))


def _write_picture(path: Path, images: list[np.ndarray[Any, Any]]) -> None:
    """Write pictures side by side, in about as many rows as columns."""
    columns, size = columns_of(len(images)), len(images[0])
    rows = math.ceil(len(images) / columns)
    sheet = np.full((rows * (size + GAP) - GAP, columns * (size + GAP) - GAP, 3), 255, np.uint8)
    for k, image in enumerate(images):
        top, left = (number * (size + GAP) for number in divmod(k, columns))
        sheet[top : top + size, left : left + size] = image
    with atomic_write(path) as place:
        place.write_bytes(cv2.imencode(".png", sheet[..., ::-1])[1].tobytes())
