"""Lines of sight among walls: they are Box2D's ray casts, but for rays that graze something within rounding."""

import math
from typing import Any

import Box2D
import numpy as np
import pytest

import outlast
from outlast import systems, variant
from outlast.components import Body, Shape, Side, Sight, Wall
from outlast.ecs import Entity, Worlds
from outlast.ecs.kernels.simd import SIMD_WIDTH
from tests.conftest import COMPILED
from tests.helpers.naive_geometry import edge_distance
from tests.helpers.naive_walls import Block

ROUNDING = 1e-5  # metres: of float32, where positions are up to 18
SEEING = {"cameras_fov": math.pi, "cameras_depth": 40.0, "cameras_cone": "sector"}
KINDS: dict[str, Any] = {
    "maze": systems.Maze(),
    "rooms": systems.Rooms(),
    "pillars": systems.Pillars(count=30, least=0.4, most=0.9, gap=1.1),
    "plan": systems.Walls(layout=(0, 0, 10, 0.3, 0.7, 0, 3, -2, 0.3, 12, 0.2, 0, -6, 6, 4, 2, 1.1, 0)),
}


class _First(Box2D.b2RayCastCallback):  # type: ignore[misc]
    def __init__(self, rows: Any) -> None:
        super().__init__()
        self.rows, self.fraction, self.found = rows, 1.0, -1

    def ReportFixture(self, fixture: Any, point: Any, normal: Any, fraction: float) -> float:  # noqa: N802
        if fixture.body.userData not in self.rows:
            return -1.0
        self.fraction, self.found = fraction, fixture.body.userData
        return fraction


class Box2DWorld:
    """All bodies of a world that are there, in Box2D and as numbers."""

    def __init__(self, worlds: Worlds, w: int) -> None:
        body, shape = worlds[Body], worlds[Shape]
        self.world, self.bodies, self.blocks = Box2D.b2World(), dict[int, Any](), dict[int, Block]()
        for e in np.flatnonzero(worlds[Entity].alive[w]).tolist():
            columns = (body.x, body.y, body.angle, shape.half_width, shape.half_height, shape.radius)
            block = Block(*(float(column[w, e]) for column in columns))
            half = (block.half_width, block.half_height)
            form = Box2D.b2CircleShape(radius=block.radius) if block.radius else Box2D.b2PolygonShape(box=half)
            fixture, place = Box2D.b2FixtureDef(shape=form), (block.x, block.y)
            self.blocks[e] = block
            self.bodies[e] = self.world.CreateStaticBody(
                position=place, angle=block.angle, fixtures=fixture, userData=e
            )

    def cast(self, eye: Any, end: Any, rows: Any) -> tuple[float, int]:
        """The fraction at which a ray meets the first of these rows, and which that is; (1, -1) if it meets none."""
        first = _First(rows)
        self.world.RayCast(first, eye, end)
        return first.fraction, first.found

    def sees(self, me: int, e: int) -> bool:
        eye, other = self.bodies[me].position, self.bodies[e].position
        end = [eye[k] + (other[k] - eye[k]) * (1 + 1e-6) for k in range(2)]
        return self.cast(eye, end, self.bodies.keys() - {me})[1] == e

    def grazes(self, me: int, e: int) -> float:
        """Metres, by which the ray misses a corner or rim of something, or hits it beside one; the least of all."""
        start, end = (complex(self.blocks[k].x, self.blocks[k].y) for k in (me, e))
        return min(grazing(block, start, end) for o, block in self.blocks.items() if o not in (me, e))


def grazing(block: Block, start: complex, end: complex) -> float:
    """Metres between a segment and the nearest corner of a rectangle, or the nearest tangent of a disc."""
    middle, turn = complex(block.x, block.y), complex(math.cos(block.angle), math.sin(block.angle))
    signs = ((1, 1), (1, -1), (-1, 1), (-1, -1))
    corners = [middle + turn * complex(a * block.half_width, b * block.half_height) for a, b in signs]
    points = [middle] if block.radius else corners
    ends = [(start.real, start.imag), (end.real, end.imag)]
    return min(abs(edge_distance((point.real, point.imag), ends) - block.radius) for point in points)


def seen(worlds: Worlds, w: int, i: int, e: int) -> bool:
    """Whether agent `i` sees row `e`, as the engine has it."""
    return bool(worlds[Sight].visible[w, i, e // SIMD_WIDTH] >> e % SIMD_WIDTH & 1)


def ahead(worlds: Worlds, w: int, me: int, e: int) -> bool:
    """Whether the centre is clearly in a half disc of 40 metres ahead."""
    body = worlds[Body]
    x, y = body.x[w, e] - body.x[w, me], body.y[w, e] - body.y[w, me]
    return bool(x * body.cosine[w, me] + y * body.sine[w, me] > 1e-3 and math.hypot(x, y) < 39)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="many rays")
@pytest.mark.parametrize("kind", KINDS)
def test_lines_of_sight_are_box2ds_ray_casts(kind: str) -> None:
    env = outlast.make_vec(variant("ffa_3").replace(n_agents=8, n_heals=20, **SEEING).with_(KINDS[kind]), 16, seed=3)
    rays, free, grazed = 0, 0, []
    while rays < 25_000:
        env.reset()  # after a step, items that were seen may be in bags
        for w in range(env.num_worlds):
            world = Box2DWorld(env.worlds, w)
            others = [e for e in world.bodies if e not in env.worlds.layout.rows(Wall)]
            for i, me in enumerate(env.worlds.layout.rows(Side).tolist()):
                for e in (e for e in others if e != me and ahead(env.worlds, w, me, e)):
                    expected = world.sees(me, e)
                    rays, free = rays + 1, free + expected
                    if seen(env.worlds, w, i, e) != expected:
                        grazed.append(world.grazes(me, e))
    env.close()
    assert 0.05 < free / rays < 0.8
    assert max(grazed, default=0) < ROUNDING
    assert len(grazed) < 10
