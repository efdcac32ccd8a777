"""Physics: Box2D moves bodies that may touch others in this tick; all others are integrated by the same formulas.

In most ticks, most bodies touch nothing. A broad phase marks those that may (`broad_phase`). Only they are passed to
Box2D (`collide`), as a contact batch that is built, stepped and discarded, so that the result is a function of the
tables alone. The others move by Box2D's own arithmetic (`fly`), bit for bit.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from outlast.components import (
    Body,
    Driven,
    Fault,
    Filter,
    Material,
    Phase,
    Polygon,
    Push,
    Rope,
    RopeBroken,
    Shape,
    Solid,
    Touch,
    Touching,
    Weld,
    WeldBroken,
)
from outlast.components.body import inverse
from outlast.components.limits import STRONG
from outlast.ecs import (
    Array,
    Bitset,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    Real,
    RowIndex,
    Rows,
    Scratch,
    Service,
    Singleton,
    System,
    Write,
    kernel,
    number,
)
from outlast.ecs.kernels.jit import called_kernel, compiled, noinline_kernel
from outlast.ecs.kernels.simd import SIMD_WIDTH, load, load_flags, to_bits

from .box2d import native, portable
from .box2d.batch import (
    ANGLE,
    COLUMNS,
    JOINTS,
    LIMITS,
    LONGEST,
    MAX_TRAVEL,
    OMEGA,
    OUTLINE,
    SOLVED,
    TOUCHES,
    TRAITS,
    VX,
    IncompatibleBox2D,
    Settings,
    X,
)
from .box2d.connect import gather_joints, mark_joined, number_marked, read_forces
from .box2d.report import report_nothing, report_touches
from .box2d.transfer import describe, gather, gather_outlines, own, scatter, some_marked
from .geometry.blocks import alive_bits, first_row, without_row
from .geometry.bodies import Bodies, all_aabbs, refresh
from .geometry.bounds import clamp, count_kinds
from .geometry.broad_phase import gap, outer_radius, travel

MARGIN = np.float32(0.02)  # metres: bodies this near may touch; the sum of Box2D's skins and slops is below 0.02
MOST = np.float32(0.5 * math.pi)  # radians a substep: b2_maxRotation
ONE, ZERO, HALF = np.float32(1), np.float32(0), np.float32(0.5)
PI, THIRD = np.float32(math.pi), np.float32(1 / 3)
TWELFTH = np.float32(0.25) * THIRD
USUAL = np.float32(1e4)  # metres, radians, and both a second: seldom exceeded by bodies, see `contain`
EDGE = np.float32(1e5)  # metres from the middle, the end of the plane: float32 separates positions of 8 mm there
TURNS = 2 * math.pi


@dataclass(frozen=True)
class Physics(Module):
    """Rigid-body motion and contacts (reference rules, section 1).

    backend: the interface to Box2D. "native": its machine code, from inside the tick; "portable": its Python interface,
    which is slower but gives the same results; "auto": native if the installed Box2D allows it.
    """

    # More substeps and iterations than these would take very long, and could not be stopped.
    rate: float = number(
        60.0, low=1, high=10_000, unit="substeps per second", about="how often bodies are moved and collide"
    )
    substeps: int = number(2, low=1, high=100, unit="substeps per tick", about="length of a tick")
    velocity_iterations: int = number(10, low=1, high=1000, about="iterations of Box2D's solver for velocities")
    position_iterations: int = number(10, low=1, high=1000, about="iterations of Box2D's solver for positions")
    friction: float = number(0.2, low=0, high=STRONG, about="coefficient of friction between bodies")
    restitution: float = number(0.0, low=0, high=1, about="0: bodies stop at each other, 1: they bounce off")
    linear_damping: float = number(
        0.8, low=0, high=STRONG, unit="per second", about="how fast moving bodies lose speed"
    )
    angular_damping: float = number(
        0.8, low=0, high=STRONG, unit="per second", about="how fast turning bodies lose spin"
    )
    continuous: bool = number(True, about="fast bodies cannot pass through standing ones")
    backend: str = number(
        "auto",
        choices=("auto", "native", "portable"),
        about="Box2D is called from machine code (native) or from Python (portable); auto: native where possible",
    )

    def systems(self) -> Iterable[System]:
        return [s for s in super().systems() if s.name != "collide" or s.compiled == self.native()]

    def singletons(self) -> Iterable[Singleton]:
        return [Fault()]

    def native(self) -> bool:
        """Return whether the native backend is used; IncompatibleBox2D if it is requested but impossible."""
        if self.backend == "native":
            native.verify()
            if not compiled():
                raise IncompatibleBox2D(
                    'physics.backend = "native" needs compiled kernels, but NUMBA_DISABLE_JIT is set; '
                    'take "auto" or "portable"'
                )
        return self.backend == "native" or (self.backend == "auto" and native.available())

    def check(self, layout: Layout) -> None:
        if (bodies := len(layout.rows(Solid))) > native.CAPACITY:
            raise NumberError(
                f"{bodies} bodies that take part in contacts ({count_kinds(layout, Solid)}): physics takes at most "
                f"{native.CAPACITY}; take fewer"
            )

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        if name == "reach":  # metres from its centre: the reach of a body in this tick
            return np.zeros(dims["rows"], np.float32)
        backend = native if self.native() else portable
        return backend.listen(backend.make_workspace()) if "touches" in dims else backend.make_workspace()


@Physics.system(Phase.SPAWN, after=Shape)
def compute_mass(solid: Write[Solid], shape: Read[Shape], polygons: Read[Polygon] | None, solids: Rows[Solid]) -> None:
    """Compute mass and moment of inertia of all solids, in Box2D's order of operations, all in float32."""
    for e in solids:
        if polygons is not None and polygons.corners[e] > 0:
            weigh(solid, polygons, e)
            continue
        radius, width, height = shape.radius[e], shape.half_width[e], shape.half_height[e]
        if radius > ZERO:
            solid.mass[e] = solid.density[e] * PI * radius * radius
            solid.inertia[e] = solid.mass[e] * (HALF * radius * radius)
        else:
            part = width * height  # the area of each of four triangles around the centre
            wide, tall = width * width, height * height
            lying, standing = wide + (tall + tall + tall), (wide + wide + wide) + tall
            share = TWELFTH * (part + part)
            solid.mass[e] = solid.density[e] * (part + part + part + part)
            solid.inertia[e] = solid.density[e] * (share * lying + share * standing + share * lying + share * standing)


@kernel
def weigh(solid: Array, polygons: Any, e: int) -> None:
    """Compute mass and moment of inertia of a polygon, about its body's place, as b2PolygonShape::ComputeMass does."""
    xs, ys, corners = polygons.x[e], polygons.y[e], polygons.corners[e]
    mean_x, mean_y = ZERO, ZERO
    for k in range(corners):
        mean_x += xs[k]
        mean_y += ys[k]
    mean_x *= ONE / np.float32(corners)
    mean_y *= ONE / np.float32(corners)
    area, inertia, centre_x, centre_y = ZERO, ZERO, ZERO, ZERO
    for k in range(corners):
        x, y = xs[k] - mean_x, ys[k] - mean_y
        next_x, next_y = xs[(k + 1) % corners] - mean_x, ys[(k + 1) % corners] - mean_y
        cross = x * next_y - y * next_x
        area += HALF * cross
        centre_x += HALF * cross * THIRD * (x + next_x)
        centre_y += HALF * cross * THIRD * (y + next_y)
        spread_x = x * x + next_x * x + next_x * next_x
        spread_y = y * y + next_y * y + next_y * next_y
        inertia += (TWELFTH * cross) * (spread_x + spread_y)
    centre_x *= ONE / area
    centre_y *= ONE / area
    x, y = centre_x + mean_x, centre_y + mean_y
    solid.mass[e] = solid.density[e] * area
    moved = (x * x + y * y) - (centre_x * centre_x + centre_y * centre_y)
    solid.inertia[e] = solid.density[e] * inertia + solid.mass[e] * moved


@Physics.system(Phase.MOVE)
def broad_phase(
    solid: Write[Solid],
    body: Read[Body],
    shape: Read[Shape],
    push: Read[Push],
    entities: Read[Entity],
    solids: Bitset[Solid],
    driven: Rows[Driven] | None,
    bodies: Bodies,
    reach: Scratch,
    rate: float,
    substeps: int,
) -> None:
    """Mark the bodies that may touch something before the tick ends, and compute how far each may travel by itself."""
    last = 0  # the block after the last one with dynamic bodies
    for e in range(solid.may_collide.size):
        solid.may_collide[e], solid.max_travel[e] = 0, ZERO
    for b in range(solids.size):
        pending = dynamic(entities, solid, solids, b)
        last = b + 1 if pending else last
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            solid.max_travel[e] = min(travel(body, push, solid, e, substeps / rate), LONGEST * substeps) + MARGIN
            reach[e] = solid.max_travel[e] + outer_radius(shape, e)
    if driven is not None:
        for e in driven:
            if entities.alive[e] and not solid.dynamic[e]:
                solid.max_travel[e] = sweep(body, push, solid, shape, e, substeps, substeps / rate)
    refresh(bodies)
    x, y, wide, high = all_aabbs(bodies)
    for b in range(solids.size):  # each block is loaded once, and tested against all dynamic bodies
        there, row = bodies.living[b] & solids[b], SIMD_WIDTH * b
        if there:
            xs, ys, travels = load(x, row), load(y, row), load(solid.max_travel, row)
            halves_x, halves_y = load(wide, row) + travels, load(high, row) + travels
            for c in range(last):
                pending = dynamic(entities, solid, solids, c)
                while pending:
                    e = first_row(c, pending)
                    pending &= pending - 1
                    close = (abs(xs - body.x[e]) <= halves_x + reach[e]) & (abs(ys - body.y[e]) <= halves_y + reach[e])
                    here = without_row(there & to_bits(close), b, e)
                    while here:
                        mark_pair(solid, body, shape, e, first_row(b, here))
                        here &= here - 1


@kernel
def mark_pair(solid: Array, body: Array, shape: Array, e: int, o: int) -> None:
    """Mark two bodies if they may touch."""
    if gap(body, shape, e, o) <= solid.max_travel[e] + solid.max_travel[o]:
        solid.may_collide[e], solid.may_collide[o] = 1, 1


@kernel
def sweep(body: Array, push: Array, solid: Array, shape: Array, e: int, substeps: int, time: Real) -> Real:
    """Return the maximum distance of any point of body `e` in a tick, including its turn, metres."""
    turning = abs(body.omega[e]) * time * outer_radius(shape, e)
    return min(travel(body, push, solid, e, time), LONGEST * substeps) + np.float32(turning) + MARGIN


@kernel
def dynamic(entities: Array, solid: Array, solids: Array, b: int) -> int:
    """Return the living bodies of block `b` that can be pushed."""
    return int(alive_bits(entities, solids, b) & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * b)))


def box2d_settings(
    rate: float,
    substeps: int,
    velocity_iterations: int,
    position_iterations: int,
    friction: float,
    restitution: float,
    linear_damping: float,
    angular_damping: float,
    continuous: bool,
) -> Settings:
    """Return the numbers of Physics for Box2D."""
    return Settings(
        ONE / rate,
        substeps,
        velocity_iterations,
        position_iterations,
        np.float32(friction),
        np.float32(restitution),
        np.float32(linear_damping),
        np.float32(angular_damping),
        int(continuous),
    )


class Differences(NamedTuple):
    """Properties of bodies for Box2D; None for components that a scenario lacks."""

    filters: Any  # the table, and by row whether it has the component, like the next two
    filtered: Any
    materials: Any
    made: Any
    driven: Any  # by row, whether it is driven
    polygons: Any  # the table


def tell_apart(
    filters: Read[Filter] | None,
    filtered: RowIndex[Filter] | None,
    materials: Read[Material] | None,
    made: RowIndex[Material] | None,
    driven: RowIndex[Driven] | None,
    polygons: Read[Polygon] | None,
) -> Differences:
    """Return the properties in which bodies differ."""
    return Differences(filters, filtered, materials, made, driven, polygons)


class Batch(NamedTuple):
    """Memory of a contact batch, see `box2d.batch`."""

    rows: Array
    traits: Array
    joints: Array
    spots: Array  # int32 (2, rows), see number_marked
    touches: Array
    outlines: Array


def make_batch(dims: Mapping[str, int]) -> Batch:
    """Return the memory of a contact batch."""
    rows = dims["rows"]
    return Batch(
        np.zeros((rows, COLUMNS), np.float32),
        np.zeros((rows, TRAITS), np.float32),
        np.zeros((2 * rows, JOINTS), np.float32),
        np.zeros((2, rows), np.int32),
        np.zeros((1 + dims.get("touches", 0), TOUCHES), np.float32),
        np.zeros((rows, OUTLINE), np.float32),
    )


@kernel
def only_with(table: Any, memory: Any) -> Any:
    """Return memory, or None in games without the table."""
    if table is None:
        return None
    return memory


@called_kernel
def solve_marked(
    solve: Any,
    body: Array,
    solid: Array,
    fault: Array,
    push: Array,
    entities: Array,
    solids: Array,
    filters: Any,
    filtered: Any,
    materials: Any,
    made: Any,
    driven: Any,
    polygons: Any,
    welds: Any,
    welders: Any,
    ropes: Any,
    tied: Any,
    weld_events: Any,
    rope_events: Any,
    touch_events: Any,
    touching: Any,
    bodies: Any,
    workspace: Array,
    batch: Batch,
    settings: Settings,
) -> None:
    """Pass the marked bodies to Box2D; if one would be pushed into an unmarked one, pass all bodies.

    The parameters are those of `collide`, which calls it only if a body is marked.
    """
    result = SOLVED
    for everything in (False, True):
        if everything:
            for e in range(solid.may_collide.size):
                solid.may_collide[e] = entities.alive[e]
        count = gather(batch.rows, bodies, push, solid, entities, solids, driven, settings.substeps)
        if everything:
            batch.rows[:count, MAX_TRAVEL] = np.inf  # all bodies are in the batch
        outlines = gather_outlines(batch.outlines, polygons, solid, entities, solids)
        if filters is None and materials is None and welds is None and ropes is None and touching is None:
            result = solve(workspace, settings, batch.rows, count, None, None, 0, None, outlines)
        else:
            describe(batch.traits, settings, solid, entities, solids, filters, filtered, materials, made)
            number_marked(batch.spots, solid, entities, solids)
            joined = gather_joints(batch.joints, body, solid, welds, welders, ropes, tied, batch.spots)
            touches = only_with(touching, batch.touches)
            result = solve(
                workspace, settings, batch.rows, count, batch.traits, batch.joints, joined, touches, outlines
            )
        if result == SOLVED:
            break
    fault.physics[0] = result != SOLVED
    ended = read_forces(batch.joints, 0, welds, weld_events, solid, welders)
    if touching is not None and result == SOLVED:
        report_touches(batch.touches, batch.spots[1], touch_events, touching)
    read_forces(batch.joints, ended, ropes, rope_events, solid, tied)
    scatter(batch.rows, body, solid, entities, solids)


def collider(solve: Any) -> Any:
    """Return the system `collide` for one of the two backends."""

    def collide(
        body: Write[Body],
        solid: Write[Solid],
        fault: Write[Fault],
        push: Read[Push],
        entities: Read[Entity],
        solids: Bitset[Solid],
        differences: Annotated[Differences, Service(tell_apart)],
        welds: Write[Weld] | None,
        welders: Rows[Weld] | None,
        ropes: Write[Rope] | None,
        tied: Rows[Rope] | None,
        weld_events: Write[WeldBroken] | None,
        rope_events: Write[RopeBroken] | None,
        touch_events: Write[Touch] | None,
        touching: Write[Touching] | None,
        bodies: Bodies,
        workspace: Scratch,
        batch: Annotated[Batch, Service(memory=make_batch)],
        settings: Annotated[Settings, Service(box2d_settings)],
    ) -> None:
        """Pass the marked bodies to Box2D, with those that are joined to each other."""
        mark_joined(welds, solid, entities, solids, welders)
        mark_joined(ropes, solid, entities, solids, tied)
        if some_marked(solid, entities, solids):
            solve_marked(
                solve,
                body,
                solid,
                fault,
                push,
                entities,
                solids,
                differences.filters,
                differences.filtered,
                differences.materials,
                differences.made,
                differences.driven,
                differences.polygons,
                welds,
                welders,
                ropes,
                tied,
                weld_events,
                rope_events,
                touch_events,
                touching,
                bodies,
                workspace,
                batch,
                settings,
            )
        elif touching is not None:
            report_nothing(touching)

    return collide


for _backend in (native, portable):
    _native = _backend is native
    Physics.system(Phase.MOVE, after="physics.broad_phase", compiled=_native)(collider(_backend.solve))


@Physics.system(Phase.MOVE, after="physics.collide")
def fly(
    body: Write[Body],
    fault: Write[Fault],
    push: Read[Push],
    solid: Read[Solid],
    entities: Read[Entity],
    solids: Bitset[Solid],
    materials: Read[Material] | None,
    made: RowIndex[Material] | None,
    driven: Rows[Driven] | None,
    rate: float,
    substeps: int,
    linear_damping: float,
    angular_damping: float,
) -> None:
    """Move all other bodies by Box2D's integration without contacts, in its order of operations; then set headings."""
    dt, parts = ONE / rate, np.float32(substeps)
    linear_scale, angular_scale = kept(dt, linear_damping), kept(dt, angular_damping)
    for b in range(solids.size):
        pending = alive_bits(entities, solids, b) & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * b))
        while pending:
            e = first_row(b, pending)
            pending &= pending - 1
            if not solid.may_collide[e]:
                linear, angular = linear_scale, angular_scale
                if materials is not None and made is not None and made[e] >= 0:
                    linear = kept(dt, own(materials.linear_damping[e], np.float32(linear_damping)))
                    angular = kept(dt, own(materials.angular_damping[e], np.float32(angular_damping)))
                inverse_mass, inverse_inertia = inverse(solid.mass[e]), inverse(solid.inertia[e])
                for _ in range(substeps):
                    integrate(body, push, inverse_mass, inverse_inertia, e, dt, linear, angular, parts)
            finish(body, fault, e)
    if driven is not None:
        for e in driven:
            if entities.alive[e] and not solid.dynamic[e]:
                if not solid.may_collide[e]:
                    for _ in range(substeps):
                        integrate(body, push, ZERO, ZERO, e, dt, ONE, ONE, parts)
                finish(body, fault, e)


@kernel
def kept(dt: Real, damping: Real) -> Real:
    """Return the share of its speed that a body keeps in a substep."""
    return min(max(ONE - dt * damping, ZERO), ONE)


@kernel
def finish(body: Array, fault: Array, e: int) -> None:
    """Keep a body that has moved within the range of physics, and set its heading."""
    place, speed = abs(body.x[e]) + abs(body.y[e]), abs(body.vx[e]) + abs(body.vy[e])
    if not place + speed + abs(body.angle[e]) + abs(body.omega[e]) < USUAL:
        fault.physics[0] |= not contain(body, e)
    body.cosine[e], body.sine[e] = np.cos(body.angle[e]), np.sin(body.angle[e])


@kernel
def integrate(
    body: Array,
    push: Array,
    inverse_mass: Real,
    inverse_inertia: Real,
    e: int,
    dt: Real,
    linear_scale: Real,
    angular_scale: Real,
    parts: Real,
) -> None:
    """Take a substep of b2Island::Solve for a body that touches nothing; `parts` substeps share a push. In float32."""
    vx = (body.vx[e] + inverse_mass * (push.x[e] / parts)) * linear_scale
    vy = (body.vy[e] + inverse_mass * (push.y[e] / parts)) * linear_scale
    omega = (body.omega[e] + inverse_inertia * (push.turn[e] / parts)) * angular_scale
    x, y, turn = dt * vx, dt * vy, dt * omega
    if x * x + y * y > LONGEST * LONGEST or turn * turn > MOST * MOST:
        vx, vy, omega = slowed(vx, vy, omega, dt)
    body.vx[e], body.vy[e], body.omega[e] = vx, vy, omega
    body.x[e] += dt * vx
    body.y[e] += dt * vy
    body.angle[e] += dt * omega


@noinline_kernel
def slowed(vx: Real, vy: Real, omega: Real, dt: Real) -> tuple[Real, Real, Real]:
    """Return velocities that Box2D allows. Not inlined: the compiler would compute root and quotients in every case."""
    x, y, turn = dt * vx, dt * vy, dt * omega
    if x * x + y * y > LONGEST * LONGEST:
        ratio = LONGEST / np.float32(np.sqrt(x * x + y * y))
        vx, vy = vx * ratio, vy * ratio
    if turn * turn > MOST * MOST:
        omega *= MOST / abs(turn)
    return vx, vy, omega


@noinline_kernel
def contain(body: Array, e: int) -> bool:
    """Keep a body on the plane, and subtract full turns from a large angle, whose fraction float32 would lose.

    Return False for an invalid body: NaN, or larger than LIMITS.
    """
    held = abs(body.x[e]) <= LIMITS[X] and abs(body.y[e]) <= LIMITS[X] and abs(body.angle[e]) <= LIMITS[ANGLE]
    held = held and abs(body.vx[e]) <= LIMITS[VX] and abs(body.vy[e]) <= LIMITS[VX]
    if not (held and abs(body.omega[e]) <= LIMITS[OMEGA]):
        return False
    body.x[e], body.vx[e] = clamp(body.x[e], body.vx[e], EDGE, EDGE)
    body.y[e], body.vy[e] = clamp(body.y[e], body.vy[e], EDGE, EDGE)
    if abs(body.angle[e]) > USUAL:
        angle = np.float64(body.angle[e])
        body.angle[e] = np.float32(angle - TURNS * np.floor(angle / TURNS))
    return True
