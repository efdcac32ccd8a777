"""Cameras: an agent sees what is in its vision cone and not behind something else."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Phase, Shape, Side, Sight, Solid
from outlast.components.sight import MODES, OMNISCIENT
from outlast.ecs import Array, Entity, Module, Read, Real, Rows, Scratch, Write, kernel, number

from .inner.crowd import MARK, X, Y, beside_ray, gather, make_crowd, marked, member
from .inner.geometry import MISS, enters, in_kite, in_sector

SECTOR = 0  # index into the choices of Cameras.cone
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
        return make_crowd(dims)


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
    bodies: Rows[Shape],
    solids: Rows[Shape, Solid],
    crowd: Scratch,
    blockers: Scratch,
    fov: float,
    depth: float,
    cone: int,
    items_occlude: bool,
) -> None:
    """Who sees whom, while everything is still in the world."""
    if sight.mode[0] == OMNISCIENT:
        return
    half_cos, half_sin = np.float32(math.cos(fov / 2)), np.float32(math.sin(fov / 2))
    count = gather(crowd, body, shape, entities, bodies)
    blocking = gather(blockers, body, shape, entities, bodies if items_occlude else solids)
    for i in range(agents.size):
        me = agents[i]
        sight.seen[i, :] = 0
        if not entities.alive[me]:
            continue
        facing = body.x[me], body.y[me], body.cosine[me], body.sine[me]
        left = in_cone(crowd, count, facing, depth, half_cos, half_sin, cone)
        for k in range(left):
            e = member(crowd, k)
            if e != me and line_of_sight(body, shape, blockers, blocking, me, e):
                sight.seen[i, e] = 1


@kernel
def in_cone(crowd: Array, count: int, facing: Array, depth: Real, half_cos: Real, half_sin: Real, cone: int) -> int:
    """List whose centres lie in the vision cone of an agent `facing` (x, y, cosine, sine)."""
    x, y, cosine, sine = facing
    if cone == SECTOR:
        for k in range(count):
            inside = in_sector(crowd[X, k], crowd[Y, k], x, y, cosine, sine, depth, half_cos, half_sin)
            crowd[MARK, k] = 1 if inside else 0
    else:
        for k in range(count):
            inside = in_kite(crowd[X, k], crowd[Y, k], x, y, cosine, sine, depth, half_cos, half_sin)
            crowd[MARK, k] = 1 if inside else 0
    return marked(crowd, count)


@kernel
def line_of_sight(body: Array, shape: Array, blockers: Array, blocking: int, me: int, e: int) -> bool:
    """Whether the first body on the ray from the centre of `me` to the centre of `e` is `e` itself."""
    x, y = body.x[me], body.y[me]
    dx, dy = (body.x[e] - x) * STRETCH, (body.y[e] - y) * STRETCH
    reach = enters(body, shape, x, y, dx, dy, e)
    if reach == MISS:
        return False
    for k in range(beside_ray(blockers, blocking, x, y, dx, dy)):
        o = member(blockers, k)
        if o != e and o != me and enters(body, shape, x, y, dx, dy, o) < reach:
            return False
    return True
