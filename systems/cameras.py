"""Cameras: an agent sees the entities in its vision cone that are not hidden by others."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Filter, Phase, Shape, Side, Sight, Solid
from outlast.components.contact import clear_bits, is_clear
from outlast.components.limits import FAR
from outlast.components.sight import MODES, OMNISCIENT
from outlast.components.wall import is_inner_wall
from outlast.ecs import Array, Bitset, Entity, Module, Read, Real, Rows, Scratch, Write, differs, kernel, number, of
from outlast.ecs.kernels.jit import noinline_kernel
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH, load, to_bits, trailing_zeros

from .geometry.aabb import AABBs, aabbs_hit_by_ray
from .geometry.blocks import first_row, without_row
from .geometry.bodies import FEW, Bodies, all_aabbs, in_box, refresh
from .geometry.points import in_kite, in_sector, to_local
from .geometry.queries import ray_to
from .geometry.rays import NO_HIT, raycast_entity

PER_WORD = 63 // SIMD_WIDTH  # blocks whose bitsets fit into a positive int64
SECTOR = 0  # index into the choices of Cameras.cone
ZERO = np.float32(0)


@dataclass(frozen=True)
class Cameras(Module):
    """Vision cone and line of sight (paper, section 3.4 and appendix).

    cone = "sector": the cone ends in an arc. "kite": it ends in two chords, as in the paper's runs. items_occlude:
    whether intangible items block sight. mode: what observations hold; see components.sight.
    """

    fov: float = number(
        0.4 * math.pi, above=0, high=math.pi, per_agent=True, unit="radians", about="opening angle of the vision cone"
    )
    depth: float = number(10.0, above=0, high=FAR, per_agent=True, unit="metres", about="how far an agent sees")
    cone: str = number(
        "sector",
        choices=("sector", "kite"),
        about="depth is measured along an arc (sector), or along chords, as in the paper's runs (kite)",
    )
    items_occlude: bool = number(True, about="items hide what is behind them")
    mode: str = number(
        "masked",
        choices=MODES,
        about="rows of hidden entities are zeros (masked) or filled in (revealed), or no entity is hidden (omniscient)",
    )

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros((4, SIMD_WIDTH * dims["blocks"]), np.float32 if name == "listed" else np.int32)


@Cameras.system(Phase.SEE)
def see(
    sight: Write[Sight],
    body: Read[Body],
    shape: Read[Shape],
    entities: Read[Entity],
    agents: Rows[Side],
    solids: Bitset[Shape, Solid],
    filters: Read[Filter] | None,
    bodies: Bodies,
    lists: Scratch,
    listed: Scratch,
    fov: float,
    depth: float,
    cone: int,
    items_occlude: bool,
    mode: int,
) -> None:
    """Compute visibility, while agents that die in this tick are still alive."""
    sight.mode[0] = mode
    if mode == OMNISCIENT:
        return
    half_cos, half_sin = half_angle(of(fov, agents[0]))
    items_hide = -np.int32(items_occlude)  # all bits, or none
    if refresh(bodies) > FEW:
        tables = (body, shape, entities, filters)
        see_in_crowd(sight, tables, agents, solids, bodies, lists[0], listed, fov, depth, cone, items_hide)
        return
    aabbs, living, hiding = all_aabbs(bodies), bodies.count[0], lists[0]
    for i in range(agents.size):
        me = agents[i]
        far = of(depth, me)
        if differs(fov):
            half_cos, half_sin = half_angle(of(fov, me))
        for b in range(solids.size):
            sight.visible[i, b] = 0
        if not entities.alive[me]:
            continue
        for k in range(living):
            b = bodies.lines[k]
            here = without_row(bodies.living[b], b, me)
            inside, around = in_view(aabbs, body, me, b, far, half_cos, half_sin, cone)
            sight.visible[i, b] = inside & here
            hiding[k] = around & here & (solids[b] | items_hide) & ~clear_bits(filters, b)
        for start in range(0, living, PER_WORD):
            pending = 0  # of several blocks, since the end of a loop over few rows is often mispredicted
            for k in range(start, min(start + PER_WORD, living)):
                pending |= int(sight.visible[i, bodies.lines[k]]) * (1 << SIMD_WIDTH * (k - start))
            while pending:
                bit = trailing_zeros(pending)
                pending &= pending - 1
                b, lane = bodies.lines[start + (bit >> SIMD_SHIFT)], bit & SIMD_WIDTH - 1
                e = SIMD_WIDTH * b + lane  # inner walls hide others, but are not observed themselves
                if is_inner_wall(entities, e) or not line_of_sight(hiding, bodies, body, shape, me, e):
                    sight.visible[i, b] ^= 1 << lane


@kernel
def half_angle(fov: Real) -> tuple[Real, Real]:
    """Return cosine and sine of half of an opening angle."""
    return np.float32(math.cos(fov / 2)), np.float32(math.sin(fov / 2))


@noinline_kernel
def see_in_crowd(
    sight: Array,
    tables: Any,
    agents: Array,
    solids: Array,
    bodies: Any,
    targets: Array,
    listed: Array,
    fov: Any,
    depth: Any,
    cone: int,
    items_hide: Any,
) -> None:
    """Compute the same as `see` for a crowd: first list near rows side by side, since few rows of a block are near."""
    body, shape, entities, filters = tables
    half_cos, half_sin = half_angle(of(fov, agents[0]))
    rows, lanes = bodies.rows, (listed[0], listed[1], listed[2], listed[3])
    for i in range(agents.size):
        me = agents[i]
        far = of(depth, me)
        if differs(fov):
            half_cos, half_sin = half_angle(of(fov, me))
        for b in range(solids.size):
            sight.visible[i, b] = 0
        if not entities.alive[me]:
            continue
        wanted = hiding = 0
        count = list_near(bodies, listed, body, me, far, half_cos, half_sin)
        for start in range(0, count, SIMD_WIDTH):
            inside, around = in_view(lanes, body, me, start >> SIMD_SHIFT, far, half_cos, half_sin, cone)
            filled = first_lanes(count - start)
            inside, around = inside & filled, around & filled
            while inside:
                targets[wanted] = rows[start + trailing_zeros(inside)]
                inside &= inside - 1
                wanted += 1
            while around:  # listed in place: the rows that may hide others are some of the near ones
                e = rows[start + trailing_zeros(around)]
                around &= around - 1
                hides = (solids[e >> SIMD_SHIFT] | items_hide) >> (e & SIMD_WIDTH - 1) & 1
                if hides and not is_clear(filters, e):
                    list_row(listed, bodies, hiding, e)
                    hiding += 1
        for k in range(wanted):
            e = targets[k]
            if not is_inner_wall(entities, e) and seen_past(lanes, bodies, hiding, body, shape, me, e):
                sight.visible[i, e >> SIMD_SHIFT] |= 1 << (e & SIMD_WIDTH - 1)


@kernel
def list_near(bodies: Any, listed: Array, body: Array, me: int, depth: Real, half_cos: Real, half_sin: Real) -> int:
    """List the other rows whose AABB may overlap that of the vision cone of `me`. Return their number."""
    x, y, cosine, sine = body.x[me], body.y[me], body.cosine[me], body.sine[me]
    low_x, high_x = cone_ends(cosine, sine, depth, half_cos, half_sin)
    low_y, high_y = cone_ends(sine, cosine, depth, half_cos, half_sin)
    count = 0
    for k in range(in_box(bodies, None, x + low_x, x + high_x, y + low_y, y + high_y)):
        e = bodies.rows[k]
        list_row(listed, bodies, count, e)
        count += e != me
    return count


@kernel
def list_row(listed: Array, bodies: Any, k: int, e: int) -> None:
    """Enter row `e` and its AABB as entry `k` of a list, so that sixteen entries lie side by side."""
    xs, ys, half_x, half_y = all_aabbs(bodies)
    bodies.rows[k] = e
    listed[0, k], listed[1, k], listed[2, k], listed[3, k] = xs[e], ys[e], half_x[e], half_y[e]


@kernel
def first_lanes(count: int) -> int:
    """Return a bitset of the first `count` lanes, or of all of them."""
    return (1 << min(count, SIMD_WIDTH)) - 1


@kernel
def cone_ends(along: Real, across: Real, depth: Real, half_cos: Real, half_sin: Real) -> tuple[Real, Real]:
    """Return the extents of a vision cone back and forth along an axis; (along, across): its heading from there."""
    one, other = depth * (along * half_cos - across * half_sin), depth * (along * half_cos + across * half_sin)
    low, high = min(ZERO, min(one, other)), max(ZERO, max(one, other))
    return -depth if -along >= half_cos else low, depth if along >= half_cos else high


@kernel
def in_view(
    aabbs: Array, body: Array, me: int, b: int, depth: Real, half_cos: Real, half_sin: Real, cone: int
) -> tuple[int, int]:
    """Return two bitsets: rows whose centres are in the vision cone of `me`, and rows that may hide others from it."""
    xs, ys, half_x, half_y = aabbs
    x, y = load(xs, SIMD_WIDTH * b), load(ys, SIMD_WIDTH * b)
    eye_x, eye_y, cosine, sine = body.x[me], body.y[me], body.cosine[me], body.sine[me]
    if cone == SECTOR:
        inside = in_sector(x, y, eye_x, eye_y, cosine, sine, depth, half_cos, half_sin)
    else:
        inside = in_kite(x, y, eye_x, eye_y, cosine, sine, depth, half_cos, half_sin)
    radius = load(half_x, SIMD_WIDTH * b) + load(half_y, SIMD_WIDTH * b)  # at least that of the circle around it
    far, aside = to_local(x - eye_x, y - eye_y, cosine, sine)
    around = (half_cos * abs(aside) - half_sin * far <= radius) & (far <= radius + depth)
    return to_bits(inside), to_bits(around)


@kernel
def line_of_sight(hiding: Array, bodies: Any, body: Array, shape: Array, me: int, e: int) -> bool:
    """Return whether the first body on the ray from the centre of `me` to the centre of `e` is `e` itself.

    hiding: bitsets of the rows that may be in between, by lines of the index.
    """
    x, y, dx, dy, reach = ray_to(body, shape, bodies.polygons, me, e)
    near = 0  # whether some body may be in between, which is rare: computed without a branch for each block
    for k in range(bodies.count[0]):
        near |= near_ray(hiding, k, bodies, x, y, dx, dy, e)
    if near == 0 or reach == NO_HIT:
        return bool(reach != NO_HIT)
    for k in range(bodies.count[0]):
        pending = near_ray(hiding, k, bodies, x, y, dx, dy, e)
        while pending:
            other = first_row(bodies.lines[k], pending)
            if raycast_entity(body, shape, x, y, dx, dy, other, bodies.polygons) < reach:
                return False
            pending &= pending - 1
    return True


@kernel
def near_ray(hiding: Array, k: int, bodies: Any, x: Real, y: Real, dx: Real, dy: Real, e: int) -> int:
    """Return the bitset of rows other than `e` in line `k` of `hiding` whose AABB a ray hits."""
    b = bodies.lines[k]
    return without_row(hiding[k] & aabbs_hit_by_ray(all_aabbs(bodies), b, x, y, dx, dy), b, e)


@kernel
def seen_past(listed: AABBs, bodies: Any, count: int, body: Array, shape: Array, me: int, e: int) -> bool:
    """Return the same as `line_of_sight`, from a list of the `count` rows that may be in between; see `list_row`."""
    rows, polygons = bodies.rows, bodies.polygons
    x, y, dx, dy, reach = ray_to(body, shape, polygons, me, e)
    if reach == NO_HIT:
        return False
    for start in range(0, count, SIMD_WIDTH):
        pending = aabbs_hit_by_ray(listed, start >> SIMD_SHIFT, x, y, dx, dy) & first_lanes(count - start)
        while pending:
            other = rows[start + trailing_zeros(pending)]
            if other != e and raycast_entity(body, shape, x, y, dx, dy, other, polygons) < reach:
                return False
            pending &= pending - 1
    return True
