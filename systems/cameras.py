"""Cameras: an agent sees what is in its vision cone and not behind something else."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Phase, Shape, Side, Sight, Solid
from outlast.components.sight import MODES, OMNISCIENT
from outlast.ecs import Array, Bitset, Entity, Module, Read, Real, Rows, Scratch, Write, kernel, number
from outlast.ecs.simd import SIMD_WIDTH, load, to_bits

from .inner.geometry import MISS, enters, in_kite, in_sector, turn_back
from .inner.sweep import (
    GROUP,
    SET,
    across,
    enclose,
    make_extent,
    make_groups,
    populated,
    row,
    within,
    without,
)

SECTOR = 0  # index into the choices of Cameras.cone
HALF, QUARTER, ONE = np.float32(0.5), np.float32(0.25), np.float32(1)
FEW = 8  # groups that are looked at one by one faster than they are sifted
STRETCH = np.float32(1 + 1e-6)  # the ray to a centre is this much longer, as in the original


@dataclass(frozen=True)
class Cameras(Module):
    """Vision cone and line of sight (paper, section 3.4 and appendix).

    cone = "sector": depth is measured along an arc. "kite": along the chords of the paper's runs. items_occlude:
    whether intangible items block sight. mode: what observations hold; see components.sight.
    """

    fov: float = number(0.4 * math.pi, above=0, high=math.pi)  # radians, whole opening angle
    depth: float = number(10.0, above=0)  # metres
    cone: str = number("sector", choices=("sector", "kite"))
    items_occlude: bool = number(True)
    mode: str = number("masked", choices=MODES)

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return make_extent(dims) if name == "extent" else make_groups(dims)


@Cameras.system(Phase.DRAW)
def choose(sight: Write[Sight], mode: int) -> None:
    """Say what observations hold."""
    sight.mode[0] = mode


@Cameras.system(Phase.SEE)
def see(
    sight: Write[Sight],
    body: Read[Body],
    shape: Read[Shape],
    entities: Read[Entity],
    agents: Rows[Side],
    bodies: Bitset[Shape],
    solids: Bitset[Shape, Solid],
    extent: Scratch,
    everybody: Scratch,
    groups: Scratch,
    fov: float,
    depth: float,
    cone: int,
    items_occlude: bool,
) -> None:
    """Who sees whom, while everything is still in the world."""
    if sight.mode[0] == OMNISCIENT:
        return
    half_cos, half_sin = np.float32(math.cos(fov / 2)), np.float32(math.sin(fov / 2))
    crowd, living = enclose(extent, body, shape), populated(everybody, entities, bodies)
    hiding = bodies if items_occlude else solids
    for i in range(agents.size):
        me = agents[i]
        count = sift(groups, everybody, living, crowd, body, me, depth, half_cos) if entities.alive[me] else 0
        for g in range(bodies.size):
            sight.seen[i, g] = 0
        for k in range(count):
            g, here = groups[GROUP, k], groups[SET, k]
            inside, around = in_view(crowd, body, me, g, depth, half_cos, half_sin, cone)
            sight.seen[i, g] = inside & here
            groups[SET, k] = around & here & hiding[g]
        for k in range(count):
            g = groups[GROUP, k]
            left = sight.seen[i, g]
            while left:
                e = row(g, left)
                if not line_of_sight(groups, count, crowd, body, shape, me, e):
                    sight.seen[i, g] ^= left & -left
                left &= left - 1


@kernel
def sift(
    groups: Array, everybody: Array, living: int, crowd: Array, body: Array, me: int, depth: Real, half_cos: Real
) -> int:
    """List the groups of `everybody` with somebody near the vision cone of `me`, and who that is; returns how many.

    Near is what reaches into a square around the cone. In a small world nearly every group has somebody there.
    """
    x, y = body.x[me] + HALF * depth * body.cosine[me], body.y[me] + HALF * depth * body.sine[me]
    far = depth * np.float32(np.sqrt(max(QUARTER, ONE + QUARTER - half_cos)))  # of all in the cone from (x, y)
    count = 0
    for k in range(living):
        g = everybody[GROUP, k]
        here = without(everybody[SET, k], g, me)
        if living > FEW:
            here &= within(crowd, g, x, y, far)
        groups[SET, count], groups[GROUP, count] = here, g
        count += here != 0
    return count


@kernel
def in_view(
    crowd: Array, body: Array, me: int, g: int, depth: Real, half_cos: Real, half_sin: Real, cone: int
) -> tuple[int, int]:
    """Sets of rows: whose centres lie in the vision cone of `me`, and who may hide them from it."""
    xs, ys, wide, tall = crowd
    x, y = load(xs, SIMD_WIDTH * g), load(ys, SIMD_WIDTH * g)
    eye_x, eye_y, cosine, sine = body.x[me], body.y[me], body.cosine[me], body.sine[me]
    if cone == SECTOR:
        inside = in_sector(x, y, eye_x, eye_y, cosine, sine, depth, half_cos, half_sin)
    else:
        inside = in_kite(x, y, eye_x, eye_y, cosine, sine, depth, half_cos, half_sin)
    radius = load(wide, SIMD_WIDTH * g) + load(tall, SIMD_WIDTH * g)  # more than that of the circle around
    far, aside = turn_back(x - eye_x, y - eye_y, cosine, sine)
    around = (half_cos * abs(aside) - half_sin * far <= radius) & (far <= radius + depth)
    return to_bits(inside), to_bits(around)


@kernel
def line_of_sight(groups: Array, count: int, crowd: Array, body: Array, shape: Array, me: int, e: int) -> bool:
    """Whether the first body on the ray from the centre of `me` to the centre of `e` is `e` itself.

    groups: where to look for others, and which of them may be in the way.
    """
    x, y = body.x[me], body.y[me]
    dx, dy = (body.x[e] - x) * STRETCH, (body.y[e] - y) * STRETCH
    reach = enters(body, shape, x, y, dx, dy, e)
    if reach == MISS:
        return False
    for k in range(count):
        g = groups[GROUP, k]
        left = without(groups[SET, k] & across(crowd, g, x, y, dx, dy), g, e)
        while left:
            if enters(body, shape, x, y, dx, dy, row(g, left)) < reach:
                return False
            left &= left - 1
    return True
