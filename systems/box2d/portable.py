"""Box2D through pybox2d's public Python API: any platform, slow, and the reference for the native backend.

A world is built for every call, so the result is a function of the batch alone.
"""

from typing import Any

import Box2D
import numpy as np
from numpy.typing import NDArray

from .batch import (
    ABANDONED,
    ANGLE,
    ANGULAR_DAMPING,
    CAPACITY,
    DRIVEN,
    DYNAMIC,
    FRICTION,
    HALF_HEIGHT,
    HALF_WIDTH,
    HITS,
    INERTIA,
    INVALID,
    JTURN,
    JX,
    JY,
    LAYER,
    LIMITS,
    LINEAR_DAMPING,
    MASS,
    MAX_TRAVEL,
    MOVED,
    OMEGA,
    RADIUS,
    RESTITUTION,
    SENSOR,
    SMALLEST,
    SOLVED,
    TRAIT_LIMITS,
    VX,
    VY,
    ContactBatch,
    Settings,
    Traits,
    X,
    Y,
)


def make_workspace() -> None:
    """Return None: every call builds a world of its own."""
    return None


def solve(workspace: Any, settings: Settings, batch: ContactBatch, count: int, traits: Traits = None) -> int:
    """Step bodies 0..count-1 of `batch` together for one tick and write X..OMEGA of those that are not static.

    traits: how bodies differ, see `batch`; None: all have the numbers of `settings`, and touch each other.

    Returns SOLVED; or, with the batch untouched, ABANDONED if a body moved further than its MAX_TRAVEL, INVALID if
    there are more than CAPACITY bodies or a number out of bounds.
    """
    if not _valid(batch, count) or not (traits is None or _fair(traits[:count])):
        return INVALID
    world = Box2D.b2World(gravity=(0, 0))
    world.continuousPhysics = bool(settings.continuous)
    rows = [batch[k] for k in range(count)]
    own = [_usual(settings)] * count if traits is None else [traits[k] for k in range(count)]
    bodies = [_build(world, row, of) for row, of in zip(rows, own, strict=True)]
    for _ in range(settings.substeps):
        for body, row in zip(bodies, rows, strict=True):
            _push(body, row)
        world.Step(float(settings.dt), int(settings.velocity_iterations), int(settings.position_iterations))
        if any(_outside(body, row) for body, row in zip(bodies, rows, strict=True)):
            return ABANDONED
    for body, row in zip(bodies, rows, strict=True):
        if row[DYNAMIC]:
            row[X:RADIUS] = (*body.position, body.angle, *body.linearVelocity, body.angularVelocity)
    return SOLVED


def _valid(batch: ContactBatch, count: int) -> bool:
    rows = batch[:count]
    bounded = (np.abs(rows) <= LIMITS).all()
    box = (rows[:, HALF_WIDTH] > SMALLEST) & (rows[:, HALF_HEIGHT] > SMALLEST) & (rows[:, RADIUS] == 0)
    weighed = (rows[:, DYNAMIC] != MOVED) | ((rows[:, MASS] > 0) & (rows[:, INERTIA] > 0))
    return bool(count <= CAPACITY and bounded and ((rows[:, RADIUS] > SMALLEST) | box).all() and weighed.all())


def _fair(traits: NDArray[np.float32]) -> bool:
    return bool(((traits >= 0) & (traits <= TRAIT_LIMITS)).all())


def _usual(settings: Settings) -> NDArray[np.float32]:
    """The traits of a body of which nothing is said."""
    numbers = settings.friction, settings.restitution, settings.linear_damping, settings.angular_damping
    return np.array([*numbers, 1, 0xFFFF, 0], np.float32)


def _build(world: Any, row: ContactBatch, traits: NDArray[np.float32]) -> Any:
    """One body with one fixture, in Box2D's own order."""
    create = {MOVED: world.CreateDynamicBody, DRIVEN: world.CreateKinematicBody}
    body = create.get(int(row[DYNAMIC]), world.CreateStaticBody)(
        position=(float(row[X]), float(row[Y])),
        angle=float(row[ANGLE]),
        linearDamping=float(traits[LINEAR_DAMPING]),
        angularDamping=float(traits[ANGULAR_DAMPING]),
        linearVelocity=(float(row[VX]), float(row[VY])),
        angularVelocity=float(row[OMEGA]),
        allowSleep=False,  # as the native backend, even if a tick lasts longer than Box2D's half second
    )
    body.CreateFixture(
        shape=_shape(row),
        friction=float(traits[FRICTION]),
        restitution=float(traits[RESTITUTION]),
        categoryBits=int(traits[LAYER]),
        maskBits=int(traits[HITS]),
        isSensor=bool(traits[SENSOR]),
    )
    if row[DYNAMIC] == MOVED:
        body.massData = Box2D.b2MassData(mass=float(row[MASS]), I=float(row[INERTIA]), center=(0, 0))
    return body


def _shape(row: ContactBatch) -> Any:
    if row[RADIUS] > 0:
        return Box2D.b2CircleShape(radius=float(row[RADIUS]))
    return Box2D.b2PolygonShape(box=(float(row[HALF_WIDTH]), float(row[HALF_HEIGHT])))


def _push(body: Any, row: ContactBatch) -> None:
    """Apply the row's impulses; zero ones are skipped (they would only wake a body that is awake)."""
    if row[DYNAMIC] == MOVED and (row[JX] != 0 or row[JY] != 0):
        body.ApplyLinearImpulse((float(row[JX]), float(row[JY])), body.worldCenter, True)
    if row[DYNAMIC] == MOVED and row[JTURN] != 0:
        body.ApplyAngularImpulse(float(row[JTURN]), True)


def _outside(body: Any, row: ContactBatch) -> bool:
    """Whether the body is further from its start than its MAX_TRAVEL, in float32 as in the native backend."""
    x, y = np.float32(body.position.x) - row[X], np.float32(body.position.y) - row[Y]
    return bool(row[DYNAMIC] == MOVED and x * x + y * y > row[MAX_TRAVEL] * row[MAX_TRAVEL])
