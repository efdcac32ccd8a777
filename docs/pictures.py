"""Make the pictures of the pages again, from seeds, and write them into docs/pictures.

    python docs/pictures.py [NAME ...]      (all, if no name is given)

Films are made by the commands that the pages show beside the films.
"""

import contextlib
import io
import math
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import outlast
from outlast.components import Bag, Body, Item, Shape
from outlast.components.hide_and_seek import Doors
from outlast.drawing import LAYERS, CamerasLayer, LidarLayer, Scene
from outlast.ecs import Entity
from outlast.envs.cli.main import main as outlast_command
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rendering.rgb import draw
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.hide_and_seek import HIDE_2V2
from outlast.systems import Lidar, Maze, Pillars, Rooms

DOCS = Path(__file__).resolve().parent
SHOWN = 330  # the tick that the picture `page` shows
GAP = 8  # width of the white gap between panels, pixels
IDLE, STRIKE, USE = (1, 1, 1, 0, 0, 0), (1, 1, 1, 1, 0, 0), (1, 1, 1, 0, 1, 0)

Image = np.ndarray[Any, Any]


def small_png(image: Image) -> bytes:
    """A picture, uint8 (height, width, 3) RGB, as a PNG of at most 256 colours, a third as large as one of all."""
    import PIL.Image  # here, as tests ask what pictures there are without it

    file = io.BytesIO()
    PIL.Image.fromarray(image).quantize(256, dither=PIL.Image.Dither.NONE).save(file, "png", optimize=True)
    return file.getvalue()


def played(scenario: outlast.Scenario, world: int, ticks: int, policy: str = "scripted") -> SurvivalVectorEnv:
    """Play world number `world` of seed 0 for so many ticks."""
    env = outlast.make_vec(scenario, 1, seed=0, first_world=world)
    observations, _ = env.reset()
    act = POLICIES[policy](env, 0)
    for _ in range(ticks):
        observations, *_ = env.step(act(observations))
    return env


def beside(panels: list[Image]) -> Image:
    """Put panels of the same size in a row."""
    gap = np.full((panels[0].shape[0], GAP, 3), 255, np.uint8)
    return np.hstack([part for panel in panels for part in (gap, panel)][1:])


def closeup(env: SurvivalVectorEnv, x: float, y: float, reach: float, size: int, layers: Any = LAYERS) -> Image:
    """Draw the square around (x, y) whose sides are 2 * reach metres long."""
    half = Scene(env.worlds, 0).half
    whole = round(size * half / reach)
    left, top = (round(whole * (half + shift - reach) / (2 * half)) for shift in (x, -y))
    return draw(env.worlds, 0, whole, layers)[top : top + size, left : left + size]


def start() -> Image:
    """A world of teams_4 at the start."""
    return draw(played(outlast.variant("teams_4"), 3, 0).worlds, 0, 440)


def sight() -> Image:
    """What agents see."""
    return draw(played(outlast.variant("teams_4"), 1, 150).worlds, 0, 440, [*LAYERS, CamerasLayer()])


def roles() -> Image:
    """One against three, and what they see."""
    hunter = outlast.role(1, agents_health=200, agents_radius=0.9, cameras_depth=14.0, cameras_fov=2.0)
    hunt = (
        outlast.variant("teams_3")
        .replace(teams_sizes=(1, 3))
        .roles(hunter=hunter, prey=outlast.role(3, cameras_depth=6.0))
    )
    return draw(played(hunt, 3, 30).worlds, 0, 440, [*LAYERS, CamerasLayer(lines=False)])


def zone() -> Image:
    """The same world at four times; no agent moves or loses hit points."""
    safe = outlast.variant("teams_4").replace(safe_zone_damage=0)
    return beside([draw(played(safe, 3, ticks, "noop").worlds, 0, 200) for ticks in (0, 350, 750, 1150)])


def boxes() -> Image:
    """A box, the item that is left of it, the box in the bag, and set up again: one agent in four ticks."""
    env = played(outlast.variant("ffa_3"), 0, 0)
    body, shape, alive = env.worlds[Body], env.worlds[Shape], env.worlds[Entity].alive
    agent, box, heal = (env.worlds.span(kind).start for kind in ("agent", "box", "heal"))
    alive[0, box + 1 : env.worlds.span("box").stop] = alive[0, heal : env.worlds.span("heal").stop] = 0
    alive[0, agent + 1] = 1
    body.x[0, :2], body.y[0, :2] = (0, 9), (0, 9)
    body.x[0, box], body.y[0, box] = 1.5, 0
    shape.half_width[0, box], shape.half_height[0, box], shape.bound[0, box] = 0.4, 0.9, 1
    panels = [closeup(env, 1, 0, 2.5, 200)]

    def after(*actions: tuple[int, ...]) -> None:
        for action in actions:
            env.step(np.array([[action, IDLE]]))
        panels.append(closeup(env, 1, 0, 2.5, 200))

    after(STRIKE, IDLE)
    body.x[0, agent] = 1.4
    after(IDLE)
    body.x[0, agent] = 0
    after(USE)
    return beside(panels)


def fight() -> Image:
    """Two teams meet."""
    return closeup(played(outlast.variant("teams_4"), 0, 300), -1, 1.5, 5, 320)


def poison() -> Image:
    """The example of the page on new mechanics, before and after a vial is used."""
    sys.path.insert(0, str(DOCS / "examples"))
    from poison import Poison
    from poison_view import PoisonLayer

    env = played(outlast.variant("teams_2").with_(Poison()), 0, 0)
    body, vial, layers = env.worlds[Body], env.worlds.span("vial").start, [*LAYERS, PoisonLayer()]
    body.x[0, :4], body.y[0, :4] = (0, -1, 2, 1.5), (0, 1.2, 1, -1.5)
    body.x[0, vial + 1], body.y[0, vial + 1] = -1.5, -1
    env.worlds[Bag].items[0, 0, 0], env.worlds[Bag].count[0, 0] = vial, 1
    env.worlds[Item].holder[0, vial], env.worlds[Entity].alive[0, vial] = 0, 0
    before = closeup(env, 0.3, 0, 3, 240, layers)
    env.step(np.array([[USE, IDLE, IDLE, IDLE]]))
    return beside([before, closeup(env, 0.3, 0, 3, 240, layers)])


def tag() -> Image:
    """The game of the tutorial, while it is played."""
    sys.path.insert(0, str(DOCS / "examples"))
    from tag import TAG
    from tag_policy import chase
    from tag_view import TAG_LAYERS

    env = outlast.make_vec(TAG, 1, seed=0, first_world=12)
    act = chase(env)
    observations, _ = env.reset()
    for _ in range(50):
        observations, *_ = env.step(act(observations))
    return draw(env.worlds, 0, 320, TAG_LAYERS)


def hide_and_seek() -> Image:
    """A hider has locked a crate in the door, another holds one; seekers are outside, one of them comes up a ramp."""
    env = played(HIDE_2V2.replace(quadrant_closed=1, cameras_fov=math.pi), 0, 0)
    idle, grab, lock = (3, 3, 3, 0, 1), (3, 3, 3, 1, 1), (3, 3, 3, 0, 2)
    doors = env.worlds[Doors]
    k = int(doors.open[0].argmax())
    x, y = float(doors.x[0, k]), float(doors.y[0, k])
    agents = [(x + 0.5 * (k == 0), y - 0.5 * (k == 1), 0.5 * math.pi * k + math.pi * (k == 0)), (2.2, -2.2, math.pi)]
    agents += [(-2.0, 1.5, -0.8), (-1.1, 1.6, math.pi)]
    things = [("crate", 0, x, y, 0.0), ("crate", 1, 1.6, -2.3, 0.3), ("ramp", 0, -1.9, 1.6, math.pi)]
    for number, (x, y, angle) in enumerate(agents):
        env.place("agent", number, x=x, y=y, angle=angle)
    for kind, number, x, y, angle in things:
        env.place(kind, number, x=x, y=y, angle=angle)
    # first an idle tick, as agents can only handle what they have seen
    for actions in ([idle] * 4, [lock, grab, idle, (6, 3, 3, 0, 1)]):
        env.step(np.array([actions]))
    return draw(env.worlds, 0, 400)


def levels() -> Image:
    """What the mechanics of walls build, and a floor plan."""
    plan = outlast.levels.FloorPlan.from_text(
        """
        AA....#..........BB
        AA....#....#.....BB
        AA.........#.....BB
        ......#....#.......
        ###..##....#..#####
        ......#............
        AA....#..****....BB
        AA.......****....BB
        """,
        cell=2.0,
    )
    plain = outlast.variant("teams_3")
    hall = plain.replace(safe_zone_radii=(7.0, 4.0)).with_(plan.room(), plan.mechanic())
    drawn = [plain.with_(mechanic) for mechanic in (Maze(columns=7, rows=7, loops=0.2), Rooms(), Pillars(count=14))]
    return beside([draw(played(scenario, 0, 0).worlds, 0, 240) for scenario in (*drawn, hall)])


def lidar() -> Image:
    """Rays in all directions that end at walls, and a fan of rays ahead that also end at boxes and agents."""
    maze = outlast.variant("ffa_1").with_(Maze(), Lidar())
    pillars = outlast.variant("ffa_3").with_(Pillars(count=14), Lidar(rays=15, angle=2.0, targets="solids"))
    return beside([draw(played(game, 2, 60).worlds, 0, 280, [*LAYERS, LidarLayer()]) for game in (maze, pillars)])


def page() -> Image:
    """The page of a recording of a trained policy. Needs PyTorch, playwright and a Chromium on the PATH."""
    from playwright.sync_api import sync_playwright

    player = outlast.load_policy(DOCS.parent / "results/policies/ffa_2/original-0.safetensors")
    env = outlast.make_vec(player.scenario(outlast.variant("ffa_2")), 1, seed=0)
    with tempfile.TemporaryDirectory() as folder:
        recording, target = Path(folder) / "trained.rec", Path(folder) / "trained.html"
        with outlast.record(env, recording, policy=player):
            observations, _ = env.reset()
            for _ in range(SHOWN + 100):
                observations, *_ = env.step(player(observations))
        outlast.replay_page(recording, target)
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
            shown = browser.new_page(viewport={"width": 1040, "height": 680}, reduced_motion="reduce")
            shown.goto(f"{target.as_uri()}#tick={SHOWN}&agent=0")
            shown.wait_for_timeout(1000)  # until the camera has come to rest
            taken = np.frombuffer(shown.screenshot(), np.uint8)
            browser.close()
    return cv2.imdecode(taken, cv2.IMREAD_COLOR_RGB)


PICTURES: dict[str, Callable[[], Image]] = {
    made.__name__: made for made in (start, sight, roles, zone, boxes, fight, poison, tag, hide_and_seek, levels, lidar)
}
SCREENSHOTS: dict[str, Callable[[], Image]] = {"page": page}  # these depend on the fonts of the machine


def films() -> dict[str, list[str]]:
    """Return the arguments of the pages' commands that write films into docs/pictures, by the film's file name."""
    pages = "\n".join(page.read_text() for page in sorted(DOCS.glob("*.md")))
    found = re.findall(r"^outlast (frames .* --out docs/pictures/(\S+))$", pages, re.MULTILINE)
    return {name: shlex.split(command) for command, name in found}


def main(*names: str) -> None:
    """Write all pictures and films, or only those with these names."""
    for name, made in (PICTURES | SCREENSHOTS).items():
        if not names or name in names:
            file = DOCS / "pictures" / f"{name}.png"
            file.write_bytes(small_png(made()))
            print(f"{file.relative_to(DOCS.parent)}: {file.stat().st_size} bytes")
    with contextlib.chdir(DOCS.parent):
        for name, command in films().items():
            if not names or Path(name).stem in names:
                outlast_command([*command, "--quiet"])


if __name__ == "__main__":
    main(*sys.argv[1:])
