"""Pillars: scattered square blocks, drawn anew for each episode."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from outlast.components import Body, Floor, Phase, Shape, Solid, Spawned, Wall
from outlast.components.body import face
from outlast.components.limits import FAR
from outlast.ecs import (
    Array,
    Entity,
    Layout,
    NumberError,
    Random,
    Read,
    Real,
    RowIndex,
    Rows,
    Write,
    kernel,
    number,
    ref,
)
from outlast.ecs.kernels.random import uniform, uniform2

from .geometry.mazes import place_block
from .geometry.points import gap_circle_box
from .inner_walls import InnerWalls

TRIES = 256  # maximum places drawn for a pillar
MOST, FIRST = 512, 1024  # first index for draws of angles, and of places
FILLED = 0.3  # maximum share of the floor for pillars and the passages around them, which leaves a place for each
HALF, ZERO = np.float32(0.5), np.float32(0)
ROOT, QUARTER = np.float32(math.sqrt(2)), np.float32(math.pi / 2)


@dataclass(frozen=True)
class Pillars(InnerWalls):
    """Squares of random size, place and angle, with gaps for agents between them and to the walls.

    A pillar is left out if none of 256 drawn places is free, which is almost impossible within the limits of `check`.
    """

    draws_level: ClassVar[bool] = True

    count: int = number(12, low=0, high=450, about="number of pillars")
    least: float = number(0.8, low=0.004, high=FAR, unit="metres", about="shortest side that a pillar can have")
    most: float = number(1.6, low=0.004, high=FAR, unit="metres", about="longest side that a pillar can have")
    gap: float = number(
        1.2,
        above=0,
        high=FAR,
        unit="metres",
        about="least distance between the circles around two pillars, and to walls",
    )

    def most_blocks(self) -> int:
        found: int = ref("count")
        return found

    def check(self, layout: Layout) -> None:
        if self.least > self.most:
            raise NumberError(f"pillars.least = {self.least:g} is above pillars.most = {self.most:g}; swap them")
        self.check_passage(layout, "the gap between two pillars", self.gap, "a larger pillars.gap")
        width, height = self.inside(layout)
        around = self.most * math.sqrt(0.5) + self.gap / 2
        free = max(0.0, width - self.gap) * max(0.0, height - self.gap)
        if self.count * math.pi * around**2 > FILLED * free:
            raise NumberError(
                f"pillars.count = {self.count}: with pillars.most = {self.most:g} and a gap of {self.gap:g} m around "
                f"each they do not fit into {width:.3g} x {height:.3g} m; take at most "
                f"{int(FILLED * free / (math.pi * around**2))}, smaller ones, or a larger room"
            )


@Pillars.system(Phase.SPAWN, before=(Body, Shape, Entity))
def build(
    body: Write[Body],
    shape: Write[Shape],
    entities: Write[Entity],
    floor: Read[Floor],
    walls: Rows[Wall],
    solids: Rows[Solid],
    spawned: RowIndex[Spawned],
    count: int,
    least: float,
    most: float,
    gap: float,
    key: Random,
) -> None:
    """Place pillars one after the other, each with a gap to the previous ones."""
    stand = 0
    for k in range(count):
        half = HALF * (least + uniform(key, k) * (most - least))
        radius = ROOT * half
        for t in range(TRIES):
            u, v = uniform2(key, FIRST + t + TRIES * k)
            x = (u - HALF) * (floor.size[0] - radius - radius)
            y = (v - HALF) * (floor.size[floor.size.size - 1] - radius - radius)
            if is_clear(body, shape, entities, solids, spawned, x, y, radius + gap):
                e, angle = walls[stand], QUARTER * uniform(key, MOST + k)
                place_block(body, shape, entities, e, x, y, half, half)
                face(body, e, angle)
                stand += 1
                break


@kernel
def is_clear(
    body: Array, shape: Array, entities: Array, solids: Array, spawned: Array, x: Real, y: Real, far: Real
) -> bool:
    """Return whether no fixed body comes within `far` of a point; pillars count as circles around them."""
    for o in solids:
        if spawned[o] >= 0 or not entities.alive[o]:
            continue
        half, high = shape.half_width[o], shape.half_height[o]
        if half == high:
            reach, dx, dy = far + ROOT * half, body.x[o] - x, body.y[o] - y
            if dx * dx + dy * dy < reach * reach:
                return False
        elif gap_circle_box(x, y, far, body.x[o], body.y[o], body.cosine[o], body.sine[o], half, high) < ZERO:
            return False
    return True
