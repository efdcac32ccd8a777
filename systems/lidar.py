"""Lidar: rays around each agent that measure distances to walls."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Filter, LidarView, Phase, Rays, Shape, Side, Solid, Spawned
from outlast.components.contact import clear_bits
from outlast.components.lidar import RAYS
from outlast.components.limits import FAR
from outlast.ecs import (
    Archetype,
    Bitset,
    Entity,
    Layout,
    Module,
    Offset,
    Read,
    Rows,
    Scratch,
    Singleton,
    Write,
    kernel,
    number,
    of,
)

from .geometry.bodies import Bodies, refresh
from .geometry.queries import first_on_ray

WALLS, SOLIDS, BODIES = range(3)  # indices into TARGETS
TARGETS = ("walls", "solids", "bodies")
MOST_RAYS = 1024
ONE = np.float32(1)


@dataclass(frozen=True)
class Lidar(Module):
    """Each agent observes its distance to walls in some directions: metres along rays from its centre.

    The fan ahead of an agent, `angle` wide, is divided into `rays` equal parts, with a ray through the middle of each:
    an odd number has one straight ahead, and 2 pi spreads them all around. They are observed from right to left. A ray
    that hits nothing reads `depth`; a body that contains the agent's centre, as an item can, is not hit. The rays of
    agents that are dead, absent or blind (Preparation) read 0.
    """

    rays: int = number(16, low=1, high=MOST_RAYS, about="number of rays")
    angle: float = number(
        2 * math.pi, above=0, high=2 * math.pi, per_agent=True, unit="radians", about="width of the fan of rays"
    )
    depth: float = number(10.0, low=0.01, high=FAR, per_agent=True, unit="metres", about="length of a ray")
    targets: str = number(
        "walls",
        choices=TARGETS,
        about="rays end at walls (walls), also at boxes and agents (solids), also at items (bodies)",
    )

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("agent", (Rays(),))]

    def singletons(self) -> Iterable[Singleton]:
        return [LidarView()]

    def dims(self) -> dict[str, int | str]:
        return {RAYS: self.rays}

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"lidar": {"distance": (0, self.depth)}}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros(dims["blocks"], np.int32)


@Lidar.system(Phase.OBSERVE)
def measure_distances(
    view: Write[LidarView],
    state: Read[Rays],
    body: Read[Body],
    entities: Read[Entity],
    agents: Rows[Side, Rays],
    solids: Bitset[Shape, Solid],
    spawned: Bitset[Shape, Solid, Spawned],
    filters: Read[Filter] | None,
    bodies: Bodies,
    ends: Scratch,
    lidar_distance: Offset,
    rays: int,
    angle: float,
    depth: float,
    targets: int,
) -> None:
    """Cast each ray from the centre of its agent against all other targets, at their places after the tick."""
    refresh(bodies)
    for b in range(ends.size):  # walls are the solids without a cell of the spawn grid
        members = bodies.living[b] if targets == BODIES else solids[b]
        ends[b] = (members & ~spawned[b] if targets == WALLS else members) & ~clear_bits(filters, b)
    for i in range(agents.size):
        me = agents[i]
        if not entities.alive[me] or state.off[me]:
            for k in range(rays):
                view.lidar[i, lidar_distance + k] = 0
            continue
        far, part = of(depth, me), np.float64(of(angle, me)) / rays
        first, turn = 0.5 * part * (1 - rays), (math.cos(part), math.sin(part))
        dx, dy = turned(np.float64(body.cosine[me]), np.float64(body.sine[me]), math.cos(first), math.sin(first))
        for k in range(rays):
            at = first_on_ray(bodies, ends, body.x[me], body.y[me], far * dx, far * dy, me)[1]
            view.lidar[i, lidar_distance + k] = min(at, ONE) * far
            dx, dy = turned(dx, dy, turn[0], turn[1])


@kernel
def turned(x: Any, y: Any, cosine: Any, sine: Any) -> tuple[Any, Any]:
    """Return vector (x, y) turned by an angle, float64: after a thousand turns it is still exact to 1e-12."""
    return cosine * x - sine * y, sine * x + cosine * y
