"""Box2D through pybox2d's public Python API: any platform, slow, and the reference for the native backend.

Every call builds a world, so the result is a function of the batch alone. The impulses with which a lasting contact
would start its next tick are lost.
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
    CORNER,
    CORNERS,
    DRIVEN,
    DYNAMIC,
    FIRST,
    FORCE,
    FRICTION,
    HALF_HEIGHT,
    HALF_WIDTH,
    HERTZ,
    HITS,
    INERTIA,
    INVALID,
    JOINT_LIMITS,
    JOINTS,
    JTURN,
    JX,
    JY,
    KIND,
    LAYER,
    LIMITS,
    LINEAR_DAMPING,
    LOW,
    MASS,
    MAX_TRAVEL,
    MOVED,
    OMEGA,
    OTHER_X,
    OTHER_Y,
    OWN_X,
    OWN_Y,
    RADIUS,
    RATIO,
    REST,
    RESTITUTION,
    ROPE,
    SECOND,
    SENSOR,
    SMALLEST,
    SOLVED,
    TRAIT_LIMITS,
    VX,
    VY,
    WELD,
    ContactBatch,
    Joints,
    Outlines,
    Settings,
    Touches,
    Traits,
    X,
    Y,
)
from .outline import whole

HALF = np.float32(0.5)


def make_workspace() -> None:
    """Return None: every call builds a world of its own."""
    return None


def listen(workspace: None) -> None:
    """Return the workspace: touches are recorded without preparation."""
    return workspace


def solve(
    workspace: Any,
    settings: Settings,
    batch: ContactBatch,
    count: int,
    traits: Traits = None,
    joints: Joints = None,
    joined: int = 0,
    touches: Touches = None,
    outlines: Outlines = None,
) -> int:
    """Step bodies 0..count-1 of `batch` together for one tick and write X..OMEGA of those that are not static.

    traits: properties of bodies, see `batch`; None: all have the numbers of `settings`, and touch each other.
    joints: joints of bodies, see `batch`, `joined` of them; FORCE of each is written.
    touches: None, or an array for touches, which is written.
    outlines: polygons of bodies, see `batch`; None: no polygons.

    Returns SOLVED; or, with the batch untouched, ABANDONED if a body moved further than its MAX_TRAVEL, INVALID for
    more than CAPACITY bodies or a number out of bounds.
    """
    if not _valid(batch, count) or not (traits is None or _fair(traits[:count])):
        return INVALID
    tied = np.zeros((0, JOINTS), np.float32) if joints is None else joints[:joined]
    if not _sound(tied, count):
        return INVALID
    if outlines is not None and not whole(outlines, count):
        return INVALID
    world = Box2D.b2World(gravity=(0, 0))
    world.continuousPhysics = bool(settings.continuous)
    rows = [batch[k] for k in range(count)]
    own = [_usual(settings)] * count if traits is None else [traits[k] for k in range(count)]
    corners = [None] * count if outlines is None else [*outlines[:count]]
    bodies = [_build(world, *each) for each in zip(rows, own, corners, strict=True)]
    links, inverse = [_join(world, bodies, row) for row in tied], np.float32(1) / settings.dt
    tied[:, FORCE] = 0
    world.contactListener = listener = _Listener(bodies, touches) if touches is not None else None
    for _ in range(settings.substeps):
        for body, row in zip(bodies, rows, strict=True):
            _push(body, row)
        world.Step(float(settings.dt), int(settings.velocity_iterations), int(settings.position_iterations))
        if listener is not None:
            listener.note_sensors(world)
        for link, row in zip(links, tied, strict=True):
            x, y = (np.float32(force) for force in link.GetReactionForce(float(inverse)))
            row[FORCE] = max(row[FORCE], np.sqrt(x * x + y * y))
        if any(_outside(body, row) for body, row in zip(bodies, rows, strict=True)):
            return ABANDONED
    for body, row in zip(bodies, rows, strict=True):
        if row[DYNAMIC]:
            row[X:RADIUS] = (*body.position, body.angle, *body.linearVelocity, body.angularVelocity)
    if listener is not None:
        listener.write()
    return SOLVED


class _Listener(Box2D.b2ContactListener):  # type: ignore[misc]
    """Records touches: impulse, strongest push, and its point, by the positions of both bodies in the batch."""

    def __init__(self, bodies: list[Any], touches: NDArray[np.float32]) -> None:
        super().__init__()
        self.touches = touches
        self.noted: dict[tuple[int, int], list[Any]] = {}
        for k, body in enumerate(bodies):
            body.userData = k

    def PostSolve(self, contact: Any, impulse: Any) -> None:  # noqa: N802  # its name in Box2D
        total, *more = map(np.float32, impulse.normalImpulses)
        self.note(contact, total + more[0] if more else total)

    def note_sensors(self, world: Any) -> None:
        for contact in world.contacts:
            if contact.touching and (contact.fixtureA.sensor or contact.fixtureB.sensor):
                self.note(contact, np.float32(0))

    def note(self, contact: Any, impulse: np.float32) -> None:
        bodies = contact.fixtureA.body, contact.fixtureB.body
        key = min(each.userData for each in bodies), max(each.userData for each in bodies)
        known = key in self.noted
        entry = self.noted.setdefault(key, [np.float32(0), impulse, None])
        entry[0] += impulse
        if not known or impulse > entry[1]:
            points = contact.worldManifold.points[: contact.manifold.pointCount]
            points = points or [bodies[contact.fixtureA.sensor].position]
            x, y = (np.array(each, np.float32) for each in zip(*points, strict=True))
            entry[1:] = impulse, (x[0], y[0]) if len(x) == 1 else ((x[0] + x[1]) * HALF, (y[0] + y[1]) * HALF)

    def write(self) -> None:
        self.touches[0, LOW] = len(self.noted)
        for row, (key, (impulse, _, place)) in zip(self.touches[1:], sorted(self.noted.items()), strict=False):
            row[:] = *key, impulse, *place


def _valid(batch: ContactBatch, count: int) -> bool:
    rows = batch[:count]
    bounded = (np.abs(rows) <= LIMITS).all()
    box = (rows[:, HALF_WIDTH] > SMALLEST) & (rows[:, HALF_HEIGHT] > SMALLEST) & (rows[:, RADIUS] == 0)
    weighed = (rows[:, DYNAMIC] != MOVED) | ((rows[:, MASS] > 0) & (rows[:, INERTIA] > 0))
    return bool(count <= CAPACITY and bounded and ((rows[:, RADIUS] > SMALLEST) | box).all() and weighed.all())


def _fair(traits: NDArray[np.float32]) -> bool:
    return bool(((traits >= 0) & (traits <= TRAIT_LIMITS)).all())


def _sound(joints: NDArray[np.float32], count: int) -> bool:
    """Return whether all numbers of joints are in bounds, none is NaN, and both bodies of each are in the batch."""
    ends, springs = joints[:, FIRST : SECOND + 1], joints[:, HERTZ : RATIO + 1]
    bounded = (np.abs(joints) <= JOINT_LIMITS).all() and (ends >= 0).all() and (springs >= 0).all()
    apart = (ends < count).all() and (ends[:, 0] != ends[:, 1]).all()
    return bool(bounded and apart and ((joints[:, KIND] == WELD) | (joints[:, REST] >= 0)).all())


def _join(world: Any, bodies: list[Any], row: NDArray[np.float32]) -> Any:
    """Read one joint, in Box2D's own order."""
    kind, rest = int(row[KIND]), float(row[REST])
    ends = {
        "bodyA": bodies[int(row[FIRST])],
        "bodyB": bodies[int(row[SECOND])],
        "localAnchorA": (float(row[OWN_X]), float(row[OWN_Y])),
        "localAnchorB": (float(row[OTHER_X]), float(row[OTHER_Y])),
        "collideConnected": kind != WELD,
    }
    if kind == ROPE:
        return world.CreateRopeJoint(**ends, maxLength=rest)
    spring = {"frequencyHz": float(row[HERTZ]), "dampingRatio": float(row[RATIO])}
    if kind == WELD:
        return world.CreateWeldJoint(**ends, **spring, referenceAngle=rest)
    return world.CreateDistanceJoint(**ends, **spring, length=rest)


def _usual(settings: Settings) -> NDArray[np.float32]:
    """Return the default traits of a body."""
    numbers = settings.friction, settings.restitution, settings.linear_damping, settings.angular_damping
    return np.array([*numbers, 1, 0xFFFF, 0], np.float32)


def _build(world: Any, row: ContactBatch, traits: NDArray[np.float32], outline: Outlines = None) -> Any:
    """Read one body with one fixture, in Box2D's own order."""
    create = {MOVED: world.CreateDynamicBody, DRIVEN: world.CreateKinematicBody}
    body = create.get(int(row[DYNAMIC]), world.CreateStaticBody)(
        position=(float(row[X]), float(row[Y])),
        angle=float(row[ANGLE]),
        linearDamping=float(traits[LINEAR_DAMPING]),
        angularDamping=float(traits[ANGULAR_DAMPING]),
        linearVelocity=(float(row[VX]), float(row[VY])),
        angularVelocity=float(row[OMEGA]),
        allowSleep=False,  # like the native backend, even if a tick is longer than Box2D's half second
    )
    body.CreateFixture(
        shape=_shape(row, outline),
        friction=float(traits[FRICTION]),
        restitution=float(traits[RESTITUTION]),
        categoryBits=int(traits[LAYER]),
        maskBits=int(traits[HITS]),
        isSensor=bool(traits[SENSOR]),
    )
    if row[DYNAMIC] == MOVED:
        body.massData = Box2D.b2MassData(mass=float(row[MASS]), I=float(row[INERTIA]), center=(0, 0))
    return body


def _shape(row: ContactBatch, outline: Outlines) -> Any:
    if outline is not None and outline[CORNERS]:
        corners = outline[CORNER:].reshape(-1, 2)[: int(outline[CORNERS])]
        return Box2D.b2PolygonShape(vertices=[(float(x), float(y)) for x, y in corners])
    if row[RADIUS] > 0:
        return Box2D.b2CircleShape(radius=float(row[RADIUS]))
    return Box2D.b2PolygonShape(box=(float(row[HALF_WIDTH]), float(row[HALF_HEIGHT])))


def _push(body: Any, row: ContactBatch) -> None:
    """Apply the row's impulses; zero ones are skipped (they only wake bodies that are awake)."""
    if row[DYNAMIC] == MOVED and (row[JX] != 0 or row[JY] != 0):
        body.ApplyLinearImpulse((float(row[JX]), float(row[JY])), body.worldCenter, True)
    if row[DYNAMIC] == MOVED and row[JTURN] != 0:
        body.ApplyAngularImpulse(float(row[JTURN]), True)


def _outside(body: Any, row: ContactBatch) -> bool:
    """Return whether the body is further from its start than its MAX_TRAVEL, in float32 as in the native backend."""
    x, y = np.float32(body.position.x) - row[X], np.float32(body.position.y) - row[Y]
    return bool(row[DYNAMIC] == MOVED and x * x + y * y > row[MAX_TRAVEL] * row[MAX_TRAVEL])
