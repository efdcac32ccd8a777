"""Every tick of random scenes is, to the bit, that of a world of pybox2d's own that has all bodies and joints in it.

With continuous collisions, this holds for a world of the bodies that may touch something in the tick, and for each of
the others on its own: b2World::SolveTOI brings two near bodies to the same time, so that in Box2D a body can change how
another one finds its impact on a wall without touching it.

One such world is made for each tick, as outlast's physics keeps no impulses from tick to tick; its bodies have their
mass at their place, to the bit, where Box2D's own sums would err by a billionth; and a weld that gives way and has been
turned by more than half a turn goes back the shorter way, as angles lose whole turns.
"""

from typing import Any

import Box2D
import numpy as np
import pytest

from outlast.components import Body, Driven, Filter, Material, Polygon, Push, Rope, Shape, Solid, Weld
from outlast.ecs import Entity, Worlds
from tests.conftest import scaled
from tests.physics.test_contact import Held, bodies_of, stir, tick, worlds

STATE = ("x", "y", "angle", "vx", "vy", "omega")
SIZE = 8.0  # metres, of the room
WORLDS, TICKS = scaled(20, 2), 10  # of a scene
USUAL = {"friction": 0.2, "restitution": 0.0, "linear_damping": 0.8, "angular_damping": 0.8}


def shape_of(made: Worlds, w: int, e: int) -> Any:
    shape, polygons = made[Shape], made[Polygon]
    if corners := int(polygons.corners[w, e]):
        pairs = zip(polygons.x[w, e].tolist(), polygons.y[w, e].tolist(), strict=True)
        return Box2D.b2PolygonShape(vertices=[*pairs][:corners])
    if shape.radius[w, e] > 0:
        return Box2D.b2CircleShape(radius=float(shape.radius[w, e]))
    return Box2D.b2PolygonShape(box=(float(shape.half_width[w, e]), float(shape.half_height[w, e])))


def trait(made: Worlds, name: str, w: int, e: int) -> float:
    own = float(getattr(made[Material], name)[w, e]) if e in made.layout.rows(Material) else -1
    return float(np.float32(USUAL[name])) if own < 0 else own


def world_of(made: Worlds, w: int, rows: list[int]) -> tuple[Any, dict[int, Any]]:
    """Return a world of pybox2d's with all living solids, and its bodies by row."""
    world, bodies = Box2D.b2World(gravity=(0, 0)), {}
    solid, body, filters = made[Solid], made[Body], made[Filter]
    for e in rows:
        driven = e in made.layout.rows(Driven)
        kind = (
            Box2D.b2_dynamicBody if solid.dynamic[w, e] else Box2D.b2_kinematicBody if driven else Box2D.b2_staticBody
        )
        filtered = e in made.layout.rows(Filter)
        x, y, angle, *speeds = (float(getattr(body, name)[w, e]) for name in STATE)
        vx, vy, omega = (0.0, 0.0, 0.0) if kind == Box2D.b2_staticBody else speeds
        bodies[e] = own = world.CreateBody(Box2D.b2BodyDef(
            type=kind, position=(x, y), angle=angle, linearVelocity=(vx, vy), angularVelocity=omega, allowSleep=False,
            linearDamping=trait(made, "linear_damping", w, e), angularDamping=trait(made, "angular_damping", w, e),
        ))  # fmt: skip
        own.CreateFixture(
            shape=shape_of(made, w, e), friction=trait(made, "friction", w, e),
            restitution=trait(made, "restitution", w, e),
            categoryBits=int(filters.layer[w, e]) if filtered else 1,
            maskBits=int(filters.hits[w, e]) if filtered else 0xFFFF,
            isSensor=bool(filtered and filters.sensor[w, e]),
        )  # fmt: skip
        if solid.dynamic[w, e]:
            mass, inertia = float(solid.mass[w, e]), float(solid.inertia[w, e])
            own.massData = Box2D.b2MassData(mass=mass, I=inertia, center=(0, 0))
    return world, bodies


def join(made: Worlds, w: int, world: Any, bodies: dict[int, Any]) -> list[Any]:
    """Make the joints of these bodies; return those of pybox2d's, with their components and rows."""
    links, moves = [], made[Solid].dynamic[w]
    for table, kind in (made[Weld], Weld), (made[Rope], Rope):
        for e in made.layout.rows(kind):
            o = int(table.other[w, e])
            if o < 0 or e not in bodies or not (moves[e] or moves[o]):
                continue
            place = float(table.x[w, e]), float(table.y[w, e])
            ends = {"bodyA": bodies[e], "bodyB": bodies[o], "localAnchorA": place}
            spring = {"frequencyHz": float(table.hertz[w, e]), "dampingRatio": float(table.damping[w, e])}
            if kind is Weld:
                present = made[Body].angle[w, o] - made[Body].angle[w, e]
                turns = np.float32(round(float(present - table.angle[w, e]) / (2 * np.pi)))
                angle = float(table.angle[w, e] + turns * np.float32(2 * np.pi))
                own = {"localAnchorB": (0, 0), "referenceAngle": angle, "collideConnected": False}
                link = world.CreateWeldJoint(**ends, **spring, **own)
            else:
                there = float(table.other_x[w, e]), float(table.other_y[w, e])
                other = {"localAnchorB": there, "collideConnected": True}
                length = float(table.length[w, e])
                if table.rod[w, e]:
                    link = world.CreateDistanceJoint(**ends, **other, **spring, length=length)
                else:
                    link = world.CreateRopeJoint(**ends, **other, maxLength=length)
            links.append((kind, e, link))
    return links


def stepped(
    made: Worlds, w: int, rows: list[int], continuous: bool
) -> tuple[dict[int, tuple[float, ...]], list[tuple[Any, int, np.float32]]]:
    """Return what pybox2d makes of a tick of these rows: states of what moves, and the largest force on each joint."""
    world, bodies = world_of(made, w, rows)
    world.continuousPhysics = continuous
    links, push = join(made, w, world, bodies), made[Push]
    dt = np.float32(1) / np.float32(60)
    forces = [np.float32(0)] * len(links)
    for _ in range(2):
        for e, body in bodies.items():
            x, y, turn = (float(np.float32(getattr(push, name)[w, e]) / np.float32(2)) for name in ("x", "y", "turn"))
            if body.type == Box2D.b2_dynamicBody and (x or y):
                body.ApplyLinearImpulse((x, y), body.worldCenter, True)
            if body.type == Box2D.b2_dynamicBody and turn:
                body.ApplyAngularImpulse(turn, True)
        world.Step(float(dt), 10, 10)
        for k, (*_, link) in enumerate(links):
            x, y = (np.float32(each) for each in link.GetReactionForce(float(np.float32(1) / dt)))
            forces[k] = max(forces[k], np.sqrt(x * x + y * y))
    state = {e: (*b.position, b.angle, *b.linearVelocity, b.angularVelocity) for e, b in bodies.items() if b.type}
    return state, [(kind, e, force) for (kind, e, _), force in zip(links, forces, strict=True)]


def check_scene(seed: int, continuous: bool) -> tuple[int, int]:
    """Check some ticks of some worlds; how many bodies moved in all, and how many joints held something."""
    made, before = (worlds(WORLDS, size=SIZE, continuous=continuous) for _ in range(2))
    rng, moved, held = np.random.default_rng(seed), 0, 0
    stir(made, rng)
    tick(made)  # in which what is wished for is joined
    bodies = bodies_of(made)
    for _ in range(TICKS):
        for name in "x", "y", "turn":
            pushes = rng.normal(0, 0.3, (WORLDS, made.dims["rows"])) * (rng.random((WORLDS, 1)) < 0.5)
            getattr(made[Push], name)[:, bodies] = pushes[:, bodies]
        standing = made[Held].fixed == 1  # its own system would stop them in the tick
        for name in "vx", "vy", "omega":
            getattr(made[Body], name)[standing] = 0
        before.block[:] = made.block
        tick(made)
        for w in range(WORLDS):
            living = [e for e in made.layout.rows(Solid).tolist() if before[Entity].alive[w, e]]
            near = [e for e in living if made[Solid].may_collide[w, e] or not continuous]
            state, forces = stepped(before, w, near, continuous)
            for e in {*living} - {*near}:
                state |= stepped(before, w, [e], continuous)[0]
            for e, after in state.items():
                if max(abs(after[0]), abs(after[1])) > SIZE / 2 and made[Solid].dynamic[w, e]:
                    continue  # the room puts it back
                assert tuple(float(getattr(made[Body], name)[w, e]) for name in STATE) == after, (w, e)
                moved += 1
            for kind, e, force in forces:
                assert made[kind].force[w, e] == force
                held += force > 0
    return moved, held


@pytest.mark.parametrize("continuous", [False, True])
def test_a_tick_is_that_of_a_world_of_pybox2ds_own(continuous: bool) -> None:
    moved, held = check_scene(0, continuous)
    assert min(moved, 5 * held) > 100 * WORLDS


@pytest.mark.nightly
@pytest.mark.timeout(7200)
def test_a_hundred_thousand_ticks_are_those_of_worlds_of_pybox2ds_own() -> None:
    for seed in range(100, 100 + 100_000 // (WORLDS * TICKS)):
        check_scene(seed, seed % 2 == 1)
