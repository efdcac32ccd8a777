"""outlast layout: show walls as worlds begin with them, or write them down as a floor plan."""

import argparse
import contextlib
import logging
from pathlib import Path
from typing import Any

from outlast.components import Shape
from outlast.ecs import Worlds
from outlast.systems import Walls

from ..api.make import make_vec
from ..api.options import LayoutOptions
from ..core.options import GAME, OUTPUT
from ..errors import ScenarioError, UsageError
from ..rendering.canvas import png
from ..rendering.video.footage import check_pictures, footage, near_square
from ..scenarios.floor_plan import GENERATORS, LAYOUT, FloorPlan, in_words
from ..storage.atomic_write import atomic_write
from ..storage.outputs import check_file, written_to
from .options import VARIANT, add_changes, add_number, add_options, path, scenario
from .options import output as written

LOGGER = logging.getLogger(__name__)
SIZE = 384  # pixels along a side of a picture


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
    command = commands.add_parser("layout", help=text, description=description, examples=examples, run=run)
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
    if path.suffix == ".json" and options.worlds > 1:
        raise UsageError(f"--out {options.out} is for the floor plan of one world; leave --worlds out, or write a .png")
    if path.suffix == ".png":
        check_pictures(size, near_square(options.worlds), 1)
    from ..web.replay.write import write_page

    with contextlib.closing(make_vec(scenario(options), options.worlds, seed=options.seed, copy=False)) as env:
        env.reset()
        if options.layout not in GENERATORS:
            _warn_of_parts(options.layout, env.worlds)
        with written_to(f"--out {options.out}", UsageError):
            if path.suffix == ".json":
                if options.layout not in GENERATORS and FloorPlan.load(options.layout).starts:
                    LOGGER.warning("%s has start areas, which are not written: walls are", options.layout)
                FloorPlan.of_world(env.worlds).save(path)
            elif path.suffix == ".html":
                write_page(path, env.worlds, [0], range(env.num_worlds), title=f"{options.layout}: {env.scenario.name}")
            else:
                picture = png(next(footage(env.worlds, [None], range(env.num_worlds), size=size)))
                with atomic_write(path) as place:
                    place.write_bytes(picture)
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
