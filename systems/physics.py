"""Contacts: Box2D moves what may touch something in this tick; everything else flies free by the same formulas.

Most bodies in most ticks touch nothing. A broad phase marks those that may (`approach`); only they are handed to
Box2D (`collide`), as a scene that is built, stepped and forgotten, so the outcome is a function of the tables alone;
the others move by Box2D's own arithmetic (`fly`), bit for bit.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Fault, Phase, Push, Shape, Solid
from outlast.components.body import inverse
from outlast.ecs import (
    Array,
    Bitset,
    Entity,
    Layout,
    Module,
    NumberError,
    Read,
    Real,
    Rows,
    Scratch,
    Singleton,
    System,
    Write,
    kernel,
    number,
)
from outlast.ecs.jit import compiled
from outlast.ecs.simd import SIMD_WIDTH, load, load_flags, to_bits

from .box2d import native, portable
from .box2d.scene import COLUMNS, LIMIT, LONGEST, REACH, SOLVED, IncompatibleBox2D, Settings
from .box2d.staging import stage, unstage
from .inner.broad import gap, travel
from .inner.sweep import GROUP, SET, enclose, make_extent, make_groups, populated, present, row, within, without

MARGIN = np.float32(0.02)  # metres: how near counts as touching; Box2D's skins and slops are below 0.02 together
MOST = np.float32(0.5 * math.pi)  # radians a substep: b2_maxRotation
ONE, ZERO, HALF = np.float32(1), np.float32(0), np.float32(0.5)
PI, TWELFTH = np.float32(math.pi), np.float32(0.25) * np.float32(1 / 3)


@dataclass(frozen=True)
class Contacts(Module):
    """Rigid-body motion and contacts (reference rules, section 1).

    bridge: how Box2D is called. "native": its machine code from inside the tick; "portable": its Python interface,
    slower, the same results; "auto": native where the installed Box2D allows it.
    """

    name = "physics"

    rate: float = number(60.0, above=0)  # substeps a second
    substeps: int = number(2, low=1)  # a tick
    velocity_iterations: int = number(10, low=1)
    position_iterations: int = number(10, low=1)
    friction: float = number(0.2, low=0)
    restitution: float = number(0.0, low=0, high=1)
    linear_damping: float = number(0.8, low=0)  # per second
    angular_damping: float = number(0.8, low=0)  # per second
    continuous: bool = number(True)  # fast bodies do not tunnel through standing ones
    bridge: str = number("auto", choices=("auto", "native", "portable"))

    def systems(self) -> Iterable[System]:
        return [s for s in super().systems() if s.name != "collide" or s.compiled == self.native()]

    def singletons(self) -> Iterable[Singleton]:
        return [Fault()]

    def native(self) -> bool:
        """Whether the native bridge is used; IncompatibleBox2D if it is asked for and cannot be."""
        if self.bridge == "native":
            native.verify()
            if not compiled():
                raise IncompatibleBox2D(
                    'physics.bridge = "native" needs compiled kernels, but NUMBA_DISABLE_JIT is set; '
                    'take "auto" or "portable"'
                )
        return self.bridge == "native" or (self.bridge == "auto" and native.available())

    def check(self, layout: Layout) -> None:
        if (bodies := len(layout.rows(Solid))) > native.CAPACITY:
            raise NumberError(
                f"{bodies} bodies that take part in contacts (agents, boxes, walls): physics can do with at most "
                f"{native.CAPACITY}; take fewer agents or boxes"
            )

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        if name == "extent":
            return make_extent(dims)
        if name == "groups":
            return make_groups(dims)
        if name == "scene":
            return np.zeros((dims["rows"], COLUMNS), np.float32)
        return (native if self.native() else portable).make_arena()


@Contacts.system(Phase.SPAWN, after="room.measure")
def weigh(solid: Write[Solid], shape: Read[Shape], solids: Rows[Solid]) -> None:
    """Mass and moment of inertia of a disc or a rectangle, in Box2D's own order of operations. All in float32."""
    for e in solids:
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


@Contacts.system(Phase.MOVE)
def approach(
    solid: Write[Solid],
    body: Read[Body],
    shape: Read[Shape],
    push: Read[Push],
    entities: Read[Entity],
    solids: Bitset[Solid],
    extent: Scratch,
    groups: Scratch,
    rate: float,
    substeps: int,
) -> None:
    """Mark the bodies that may touch something before the tick ends, and how far each may travel on its own."""
    crowd, count = enclose(extent, body, shape), populated(groups, entities, solids)
    for e in range(solid.near.size):
        solid.near[e], solid.reach[e] = 0, ZERO
    for k in range(count):
        g = groups[GROUP, k]
        left = groups[SET, k] & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * g))
        while left:
            e = row(g, left)
            left &= left - 1
            solid.reach[e] = travel(body, push, solid, e, substeps / rate) + MARGIN
    for k in range(count):
        g = groups[GROUP, k]
        left = groups[SET, k] & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * g))
        while left:
            e = row(g, left)
            left &= left - 1
            meet(solid, crowd, body, shape, groups, count, e)


@kernel
def meet(solid: Array, crowd: Array, body: Array, shape: Array, groups: Array, count: int, e: int) -> None:
    """Mark body `e` and whoever it may touch."""
    for k in range(count):
        g = groups[GROUP, k]
        reach = load(solid.reach, SIMD_WIDTH * g) + (solid.reach[e] + shape.bound[e])
        left = without(groups[SET, k] & within(crowd, g, body.x[e], body.y[e], reach), g, e)
        while left:
            o = row(g, left)
            left &= left - 1
            if gap(body, shape, e, o) <= solid.reach[e] + solid.reach[o]:
                solid.near[e], solid.near[o] = 1, 1


def collider(solve: Any) -> Any:
    """The system `collide` over one of the two bridges."""

    def collide(
        body: Write[Body],
        solid: Write[Solid],
        fault: Write[Fault],
        shape: Read[Shape],
        push: Read[Push],
        entities: Read[Entity],
        solids: Bitset[Solid],
        extent: Scratch,
        arena: Scratch,
        scene: Scratch,
        rate: float,
        substeps: int,
        velocity_iterations: int,
        position_iterations: int,
        friction: float,
        restitution: float,
        linear_damping: float,
        angular_damping: float,
        continuous: bool,
    ) -> None:
        """Hand the marked bodies to Box2D; if one would be pushed into an unmarked one, hand over everything."""
        count = stage(scene, extent, body, shape, push, solid, entities, solids, substeps)
        if count == 0:
            return
        settings = Settings(
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
        if solve(arena, settings, scene, count) != SOLVED:
            for e in range(solid.near.size):
                solid.near[e] = entities.alive[e]
            count = stage(scene, extent, body, shape, push, solid, entities, solids, substeps)
            scene[:count, REACH] = np.inf  # there is nobody left to run into
            fault.physics[0] = solve(arena, settings, scene, count) != SOLVED
        unstage(scene, body, solid, entities, solids)

    return collide


for _bridge in (native, portable):
    _native = _bridge is native
    Contacts.system(Phase.MOVE, after="physics.approach", compiled=_native)(collider(_bridge.solve))


@Contacts.system(Phase.MOVE, after="physics.collide")
def fly(
    body: Write[Body],
    fault: Write[Fault],
    push: Read[Push],
    solid: Read[Solid],
    entities: Read[Entity],
    solids: Bitset[Solid],
    rate: float,
    substeps: int,
    linear_damping: float,
    angular_damping: float,
) -> None:
    """Everything else: Box2D's integration without contacts, in its own order of operations; then headings."""
    dt = ONE / rate
    slow = min(max(ONE - dt * linear_damping, ZERO), ONE)
    calm = min(max(ONE - dt * angular_damping, ZERO), ONE)
    for g in range(solids.size):
        left = present(entities, solids, g) & to_bits(load_flags(solid.dynamic, SIMD_WIDTH * g))
        while left:
            e = row(g, left)
            left &= left - 1
            if not solid.near[e]:
                lightness, ease = inverse(solid.mass[e]), inverse(solid.inertia[e])
                for _ in range(substeps):
                    integrate(body, push, lightness, ease, e, dt, slow, calm, np.float32(substeps))
            body.cosine[e], body.sine[e] = np.cos(body.angle[e]), np.sin(body.angle[e])
            if not abs(body.x[e]) + abs(body.y[e]) + abs(body.vx[e]) + abs(body.vy[e]) + abs(body.omega[e]) < LIMIT:
                fault.physics[0] = 1  # NaN, too: it is near nothing, so Box2D never gets to see it


@kernel
def integrate(
    body: Array, push: Array, lightness: Real, ease: Real, e: int, dt: Real, slow: Real, calm: Real, parts: Real
) -> None:
    """One substep of b2Island::Solve for a body that touches nothing; `parts` of them share a push. All in float32.

    lightness, ease: 1 / mass and 1 / inertia.
    """
    vx = (body.vx[e] + lightness * (push.x[e] / parts)) * slow
    vy = (body.vy[e] + lightness * (push.y[e] / parts)) * slow
    omega = (body.omega[e] + ease * (push.turn[e] / parts)) * calm
    x, y = dt * vx, dt * vy
    if x * x + y * y > LONGEST * LONGEST:
        ratio = LONGEST / np.float32(np.sqrt(x * x + y * y))
        vx, vy = vx * ratio, vy * ratio
    turn = dt * omega
    if turn * turn > MOST * MOST:
        omega *= MOST / abs(turn)
    body.vx[e], body.vy[e], body.omega[e] = vx, vy, omega
    body.x[e] += dt * vx
    body.y[e] += dt * vy
    body.angle[e] += dt * omega
