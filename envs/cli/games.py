"""Commands about games: variants, numbers, new, layout, schedule and check."""

import argparse
import contextlib
import functools
import importlib.util
import keyword
import logging
from itertools import zip_longest
from pathlib import Path
from typing import Any

from outlast.components import Shape
from outlast.ecs import Component, Entity, Worlds
from outlast.systems import Walls

from ..api.check import CHECKS, CheckOptions, check
from ..api.make import make_vec
from ..api.options import GAME, OUTPUT, PLAY
from ..errors import ScenarioError, UsageError
from ..rendering.canvas import png
from ..rendering.rgb import check_pictures, footage, near_square
from ..scenarios.floor_plan import GENERATORS, LAYOUT, FloorPlan, in_words
from ..scenarios.number_table import NumberRow, scenario_rows
from ..scenarios.parse import installed, package, scenario_of_package
from ..scenarios.variants import ABLATIONS, ALIASES, VARIANTS
from ..storage.outputs import atomic_write, check_file, written_to
from ..text_table import terminal_width, text_table
from ..web.pages import write_page
from .grammar import add_command
from .options import VARIANT, add_changes, add_options, add_scenario, given_options, output, path, positive, scenario

LOGGER = logging.getLogger(__name__)
TEMPLATE = Path(__file__).with_name("new_game.txt")
SIZE = 384  # pixels along a side of a picture of a layout


def add(commands: Any) -> None:
    """Add these commands to a parser's commands."""
    add_command(commands, "variants", list_variants)
    add_scenario(add_command(commands, "numbers", list_numbers))
    text = "name of the game, in lower case, such as hill or red_hill; NAME.py goes into this folder"
    command = add_command(commands, "new", write_game)
    command.group(OUTPUT).add_argument("path", type=_new_file, metavar="NAME", help=text)

    command = add_command(commands, "layout", draw_layout)
    game = command.group(GAME)
    game.add_argument("layout", type=path, metavar="LAYOUT", help=f"which walls: {LAYOUT}")
    text = f"where the walls stand: {VARIANT} (default: ffa_3)"
    game.add_argument("--variant", default="ffa_3", metavar="VARIANT", help=text)
    add_changes(command)
    text = "number of worlds to draw (default 1)"
    command.group(PLAY).add_argument("--worlds", type=positive, default=1, metavar="N", help=text)
    add_options(command, CheckOptions, only=("seed",))
    files = command.group(OUTPUT)
    text = f"side of each world's picture in pixels, 64 to 4096, for a .png only (default: {SIZE})"
    files.add_argument("--size", type=positive, metavar="N", help=text)
    text = "what to write: NAME.png for a picture, NAME.html for a web page, or NAME.json for a floor plan, of one "
    text += "world only"
    files.add_argument("--out", type=_layout_file, required=True, metavar="FILE", help=text)

    command = add_command(commands, "schedule", print_schedule)
    add_scenario(command)
    kind = command.add_mutually_exclusive_group()
    text = "print the components instead, with the systems that write and read each"
    kind.add_argument("--components", action="store_true", help=text)
    text = "print the generated code instead, one function for each system"
    kind.add_argument("--source", action="store_true", help=text)

    command = add_command(commands, "check", check_game)
    add_scenario(command)
    add_options(command, CheckOptions)


def list_variants(options: argparse.Namespace) -> None:
    """List the paper's variants, installed games, and ablations.

    List the games by name: the paper's variants, the scenarios of installed packages, and the ablations, changes that
    can be appended to a name, as in ffa_2+steering.

    Examples:
        variants  # every name, with what the game is
    """
    width, packages = terminal_width(), []
    print(text_table([(name, alias, VARIANTS[name].about) for alias, name in ALIASES.items()], width=width))
    for name, entry in installed().items():
        try:
            packages.append((name, package(entry), scenario_of_package(entry).about))
        except ScenarioError as error:  # it cannot be imported
            LOGGER.warning("%s", error)
    if packages:
        print("\nscenarios of installed packages:", text_table(packages, width=width), sep="\n")
    print("\nablations, which remove flaws that the paper found, as in teams_2+health_cap:")
    ablations = [(f"+{name}", f"flaw {ablation.flaw}", ablation.about) for name, ablation in ABLATIONS.items()]
    print(text_table(ablations, width=width))


def list_numbers(options: argparse.Namespace) -> None:
    """List the numbers of a game, with their values and meanings.

    List every number of a game, with its value here, the default of its mechanic, the allowed range, the unit and the
    meaning. --set changes any of them.

    Examples:
        numbers ffa_2  # all numbers that --set can change
        numbers teams_3 --set room_size=30  # the same in a larger room: some numbers grow with it
    """
    head = [name.replace("about", "meaning") for name in NumberRow._fields]
    print(text_table(scenario_rows(scenario(options)), head, width=terminal_width()))


def write_game(options: argparse.Namespace) -> None:
    """Write a small game of your own, to begin with.

    Write a game in one file, NAME.py: two components, a mechanic with a system, a scenario and a test. It can be
    played, filmed and trained at once.

    Examples:
        new hill  # hill.py; `pytest hill.py` runs its test
        check hill.py  # look for mistakes in it
        frames hill.py --policy random --out hill.gif  # a film of it
        train hill.py --steps 1e6  # agents that play it
    """
    path, text = Path(options.path), TEMPLATE.read_text(encoding="utf-8")
    words = {"Game": _class_of(path.stem), "GAME": path.stem.upper(), '"game"': f'"{path.stem}"'}
    for word, own in words.items():
        text = text.replace(word, own)
    path.write_text(text, encoding="utf-8")
    print(f"{path}: play it by `outlast play {path}`; `outlast new --help` has more")


def _class_of(name: str) -> str:
    return name.title().replace("_", "")


def _new_file(name: str) -> str:
    """Return the file of a game of that name."""
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise argparse.ArgumentTypeError(f"{name}: a name in lower case is needed, as of a module: hill, red_hill")
    if (kind := _class_of(name)) in TEMPLATE.read_text(encoding="utf-8"):
        raise argparse.ArgumentTypeError(f"{name}: {kind} has another meaning in the game; choose another one")
    path = output(functools.partial(check_file, what="games", error=ScenarioError, new=True))(f"{name}.py")
    if not Path(path).exists() and importlib.util.find_spec(name) is not None:
        raise argparse.ArgumentTypeError(f"{name}: there is a module of that name already; choose another one")
    return path


def draw_layout(options: argparse.Namespace) -> None:
    """Draw the walls of worlds, or write them to a floor plan.

    Draw worlds with walls inside the room as they begin, or write the walls of one world to a floor plan, a file that
    --layout of other commands takes.

    Examples:
        layout rooms --seed 3 --worlds 9 --out rooms.png  # a picture of nine worlds among rooms with doors
        layout maze --set maze_columns=8 --out maze.json  # a maze as a floor plan, to play in it again
    """
    path, size = Path(options.out), options.size or SIZE
    if options.size is not None and path.suffix != ".png":
        raise UsageError(f"--size {options.size} is for pictures: write a .png, or leave it out")
    if path.suffix == ".json" and options.worlds > 1:
        raise UsageError(f"--out {options.out} is for the floor plan of one world; leave --worlds out, or write a .png")
    if path.suffix == ".png":
        check_pictures(size, near_square(options.worlds), 1)
    asked = scenario(options)
    plan = None if options.layout in GENERATORS else FloorPlan.load(options.layout)
    with contextlib.closing(make_vec(asked, options.worlds, seed=options.seed, copy=False)) as env:
        env.reset()
        if plan is not None:
            _warn_of_parts(options.layout, plan, env.worlds)
        with written_to(f"--out {options.out}", UsageError):
            if path.suffix == ".json":
                if plan is not None and plan.starts:
                    LOGGER.warning("%s has start areas, which are not written: walls are", options.layout)
                FloorPlan.of_world(env.worlds).save(path)
            elif path.suffix == ".html":
                write_page(path, env.worlds, [0], range(env.num_worlds), title=f"{options.layout}: {env.scenario.name}")
            else:
                picture = png(next(footage(env.worlds, [None], range(env.num_worlds), size=size)))
                with atomic_write(path) as place:
                    place.write_bytes(picture)
    print(options.out)


def _layout_file(path: str) -> str:
    plan = path.endswith(".json")
    what, endings = "floor plans" if plan else "layouts", (".png", ".html", ".json")
    return output(functools.partial(check_file, what=what, error=UsageError, endings=endings, new=plan))(path)


def _warn_of_parts(name: str, plan: FloorPlan, worlds: Worlds) -> None:
    """Log a warning if agents cannot get everywhere on a floor plan."""
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


def print_schedule(options: argparse.Namespace) -> None:
    """Print what happens in a tick of a game, as a table.

    Print what happens in a tick: the systems, in the order in which they run, with their phases. Nothing is compiled or
    run.

    Examples:
        schedule ffa_1  # the systems in the order in which they run, phase by phase
        schedule teams_4 --components  # which systems write and read each component
        schedule ffa_1 --source  # the generated code
    """
    worlds = scenario(options).worlds(1)
    if options.source:
        print(worlds.source())
    elif options.components:
        lines = list[tuple[str, ...]]()
        for component in worlds.components:
            columns = [[component.__name__], [component.__bases__[0].__name__], *uses(worlds, component)]
            lines += zip_longest(*columns, fillvalue="")
        print(text_table(lines, ("component", "kind", "archetypes", "written by", "read by")))
    else:
        print(worlds.schedule)


def uses(worlds: Worlds, component: type[Component]) -> tuple[list[str], list[str], list[str]]:
    """Return the archetypes that have a component, and the systems that write it, or only add to it, and read it."""
    writers, readers = [], []
    for system in worlds.schedule.systems:
        kinds = {parameter.kind for parameter in system.parameters if component in parameter.components}
        if kinds & {"write", "add"}:
            writers.append(system.label if "write" in kinds else f"{system.label} (adds)")
        if "read" in kinds:
            readers.append(system.label)
    archetypes = worlds.layout.archetypes.items()
    having = [name for name, each in archetypes if component is Entity or component in map(type, each.parts)]
    return having, writers, readers


def check_game(options: argparse.Namespace) -> int:
    """Play a game at random, and look for mistakes in its mechanics.

    Let random agents play a game, and look for mistakes in its mechanics that raise no error. The observed numbers must
    be finite and within their declared bounds. A world must come out the same when it is played again, without the
    other worlds, or from a saved state. And your own mechanics must do what they declare, and the same when they run as
    Python. The exit status is 1 if a mistake was found.

    Examples:
        check mygame.py:ARENA  # a game of your own, with all its mechanics
    """
    width = max(map(len, CHECKS))

    def passed(name: str, text: str) -> None:
        print(f"{name:<{width}}  {text or 'ok'}", flush=True)

    return int(bool(check(scenario(options), **given_options(options, CheckOptions), passed=passed)))
