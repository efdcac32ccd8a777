"""Vision cones on the page end where the simulation's own line of sight ends."""

import json
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Polygon, Shape, Solid
from outlast.ecs import Archetype, Module
from outlast.envs.web.pages import write_page
from outlast.envs.web.world_json import describe, snapshot
from outlast.systems import Preparation, Rooms
from tests.helpers.naive_geometry import NO_HIT, ray_box, ray_circle
from tests.web.browser import Screen, ticks

Json = dict[str, Any]
NEAR = 0.02  # radians, and share of a distance: what lies so close to the end of sight is left out
BEFORE = 0.01  # metres ahead of a body


@dataclass(frozen=True)
class Partitions(Module):
    """Inner walls, aslant."""

    def archetypes(self) -> Iterable[Archetype]:
        body = Body(
            x=[-4, 4, 0], y=[3, -3, 7], angle=[0.6, 2.0, 0], cosine=np.cos([0.6, 2.0, 0]), sine=np.sin([0.6, 2.0, 0])
        )
        return [Archetype("partition", (body, Shape(half_width=[3, 2, 4], half_height=[0.2, 0.3, 0.1]), Solid()), 3)]


@dataclass(frozen=True)
class Splinters(Module):
    """Triangles and pentagons."""

    def archetypes(self) -> Iterable[Archetype]:
        turn = np.array([0.6, 2.0, 4.0, 5.0])
        body = Body(x=[-4, 4, 0, 2], y=[3, -3, 7, 2], angle=turn)
        pentagon = [(1.5 * math.cos(k * math.tau / 5), math.sin(k * math.tau / 5)) for k in range(5)]
        corners = [[(-1, -1), (2, -1), (0, 3)], [(-3, 0), (3, 0), (0, 0.5)], pentagon, [(0, 0), (1, 0), (1, 2), (0, 1)]]
        return [Archetype("splinter", (body, Polygon(corners), Solid()), 4)]


SCENARIOS = {
    "polygons": outlast.variant("ffa_1").with_(Splinters()),
    "boxes and items": outlast.variant("teams_4"),
    "inner walls, items do not hide": outlast.variant("ffa_3").with_(Partitions()).replace(cameras_items_occlude=False),
    "rooms and roles": outlast.variant("teams_4")
    .with_(Rooms())
    .roles(near=outlast.role(1, cameras_depth=3.0, cameras_fov=2.5), far=outlast.role(cameras_depth=14.0)),
    "one is blind at first": outlast.variant("ffa_2").with_(Preparation(ticks=75, sides=(0,), blind=True)),
    "a kite": outlast.variant("ffa_2").replace(cameras_cone="kite", cameras_fov=2.5),
}


@pytest.mark.nightly
@pytest.mark.parametrize("name", SCENARIOS)
def test_cones_end_at_what_hides(look: Any, tmp_path: Path, name: str) -> None:
    """What lies in the cone that is painted is what the engine says is seen, and nothing else."""
    env = outlast.make_vec(SCENARIOS[name], 6, seed=3)
    states: list[tuple[Json, Json]] = []
    for tick in ticks(env, 150):
        if tick % 10 == 0:
            states += [(describe(env.worlds, w), snapshot(env.worlds, w)) for w in range(6)]
    write_page(tmp_path / "page.html", env.worlds, ticks(env, 1), [0], title="")
    screen, found = look(tmp_path / "page.html"), Counter[tuple[bool, bool]]()
    for description, state in states:
        for i, agent in enumerate(state["agents"]):
            if agent["alive"]:
                if state["tick"] < description["agents"][i]["blind"]:
                    assert state["agents"][i]["sees"] == []
                    assert len(cone(screen, description, state, i)) == 1
                else:
                    found += compared(cone(screen, description, state, i), description, state, i)
    assert found[True, False] + found[False, True] == 0, found
    assert found[True, True] > 50, found
    assert found[False, False] > 200, found


def test_who_observes_everything_has_no_cone() -> None:
    env = outlast.make_vec(outlast.variant("ffa_1").replace(cameras_mode="omniscient"), 1, seed=0)
    env.reset()
    assert describe(env.worlds, 0)["cone"] is None


def cone(screen: Screen, description: Json, state: Json, i: int) -> np.ndarray[Any, Any]:
    """The corners of what is painted, metres of the room, float (corners, 2)."""
    corners = screen.page.evaluate(f"Sight.cone({json.dumps(description)}, {json.dumps(state)}, {i})")
    ahead, left = np.array(corners).T
    agent = state["agents"][i]
    cosine, sine = math.cos(agent["angle"]), math.sin(agent["angle"])
    return np.stack([agent["x"] + ahead * cosine - left * sine, agent["y"] + ahead * sine + left * cosine], 1)


def compared(polygon: Any, description: Json, state: Json, i: int) -> Counter[tuple[bool, bool]]:
    """How many bodies are (painted as seen, seen), but for those at the very end of sight."""
    found = Counter[tuple[bool, bool]]()
    shapes, bodies = description["agents"] + description["objects"], state["agents"] + state["objects"]
    eye = state["agents"][i]
    for k, (shape, body) in enumerate(zip(shapes, bodies, strict=True)):
        there = body.get("alive", body.get("here"))
        if k == i or not there or shape.get("role") in ("wall", "other"):
            continue
        views = [
            painted(polygon, description["agents"][i]["cone"], eye, shape, body, turn) for turn in (-NEAR, 0.0, NEAR)
        ]
        if len(set(views)) == 1 and views[0] is not None:
            found[views[0], k in eye["sees"]] += 1
    return found


def painted(polygon: Any, own: Any, eye: Json, shape: Json, body: Json, turn: float) -> bool | None:
    """Whether a body's centre is in the open cone, and the ray to it is painted up to the body's front.

    own: the corners of the open cone. The ray is turned by `turn` radians. None: the eye is in the body, or the centre
    at the very end of the cone.
    """
    x, y = body["x"] - eye["x"], body["y"] - eye["y"]
    dx, dy = x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)
    o, centre = (eye["x"], eye["y"]), (body["x"], body["y"])
    if shape["radius"]:
        fraction = ray_circle(o, (dx, dy), centre, shape["radius"])
    else:
        fraction = ray_box(o, (dx, dy), centre, body["angle"], shape["width"] / 2, shape["height"] / 2)
    cosine, sine = math.cos(eye["angle"]), math.sin(eye["angle"])
    ahead, left = dx * cosine + dy * sine, dy * cosine - dx * sine
    nearer, farther = (inside(own, f * ahead, f * left) for f in (1 - NEAR, 1 + NEAR))
    if fraction == NO_HIT or nearer != farther:
        return None
    share = fraction - BEFORE / math.hypot(x, y)
    return nearer and inside(polygon, o[0] + share * dx, o[1] + share * dy)


def inside(corners: Any, x: float, y: float) -> bool:
    """Whether a point is in a polygon, by the number of sides on its right."""
    left, right = np.asarray(corners), np.roll(corners, -1, 0)
    crossed = (left[:, 1] > y) != (right[:, 1] > y)
    rise = np.where(crossed, right[:, 1] - left[:, 1], 1)
    at = left[:, 0] + (y - left[:, 1]) / rise * (right[:, 0] - left[:, 0])
    return bool((crossed & (at > x)).sum() % 2)
