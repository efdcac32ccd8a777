"""Cameras: an agent sees what is in its vision cone and not behind something else."""

import math
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Phase, Shape, Side, Sight, Solid
from outlast.components.sight import MODES, OMNISCIENT
from outlast.ecs import Array, Entity, Module, Read, Rows, Write, kernel, number

from .geometry import MISS, enters, in_kite, in_sector

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
    fov: float,
    depth: float,
    cone: int,
    items_occlude: bool,
) -> None:
    """Who sees whom, while everything is still in the world."""
    if sight.mode[0] == OMNISCIENT:
        return
    occluders = bodies if items_occlude else solids
    half_cos, half_sin = np.float32(math.cos(fov / 2)), np.float32(math.sin(fov / 2))
    for i in range(agents.size):
        me = agents[i]
        sight.seen[i, :] = 0
        if not entities.alive[me]:
            continue
        for e in bodies:
            if e == me or not entities.alive[e]:
                continue
            x, y, cosine, sine = body.x[me], body.y[me], body.cosine[me], body.sine[me]
            if cone == 0:
                inside = in_sector(body.x[e], body.y[e], x, y, cosine, sine, depth, half_cos, half_sin)
            else:
                inside = in_kite(body.x[e], body.y[e], x, y, cosine, sine, depth, half_cos, half_sin)
            if inside and line_of_sight(body, shape, entities, occluders, me, e):
                sight.seen[i, e] = 1


@kernel
def line_of_sight(body: Array, shape: Array, entities: Array, occluders: Array, me: int, e: int) -> bool:
    """Whether the first body on the ray from the centre of `me` to the centre of `e` is `e` itself."""
    x, y = body.x[me], body.y[me]
    dx, dy = (body.x[e] - x) * STRETCH, (body.y[e] - y) * STRETCH
    reach = enters(body, shape, x, y, dx, dy, e)
    if reach == MISS:
        return False
    for o in occluders:
        if o != e and o != me and entities.alive[o] and enters(body, shape, x, y, dx, dy, o) < reach:
            return False
    return True
