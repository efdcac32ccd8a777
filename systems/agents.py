"""Agents: round bodies controlled by a policy, and what they observe of themselves and each other."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Body,
    Guard,
    Health,
    ObservationMasks,
    OthersView,
    Phase,
    Push,
    SelfView,
    Shape,
    Side,
    Sight,
    Solid,
    Spawned,
)
from outlast.components.health import MOST, Died
from outlast.components.sight import MASKED, OMNISCIENT
from outlast.ecs import (
    Archetype,
    Array,
    Bitset,
    Entity,
    Layout,
    Module,
    Read,
    RowIndex,
    Rows,
    Scratch,
    Singleton,
    Write,
    kernel,
    number,
)
from outlast.ecs.simd import SIMD_WIDTH, load_flags, to_bits

from .geometry.bounds import farthest_body
from .observation_rows import write_rows


@dataclass(frozen=True)
class Agents(Module):
    """The agents: their number, size and health (paper, section 3.1)."""

    count: int = number(2, low=1)
    radius: float = number(0.5, low=0.002)  # metres
    density: float = number(1.0, above=0)  # kilograms per square metre
    health: int = number(100, low=1, high=MOST)  # hit points at the start

    def archetypes(self) -> Iterable[Archetype]:
        solid = Solid(dynamic=1, density=self.density)
        parts = (Body(), Shape(radius=self.radius), solid, Push(), Spawned(), Side(), Guard(), Died())
        return [Archetype("agent", (*parts, Health(points=self.health)), self.count, order=10)]

    def singletons(self) -> Iterable[Singleton]:
        return [SelfView(), OthersView(), Sight(), ObservationMasks()]

    def dims(self) -> dict[str, int | str]:
        return {"agents": self.count, "others": self.count - 1, "features": 8}

    def check(self, layout: Layout) -> None:
        layout.check_count(Side, "agents")

    def bounds(self, layout: Layout) -> Mapping[str, tuple[Any, Any]]:
        """Health has no lower bound: damage may exceed what is left, and is observed before the check for deaths."""
        far, most = farthest_body(layout), layout.numbers("mortality").get("limit") or math.inf
        sides = [layout.dims.get("sides", 1) - 1] * (layout.dims["features"] - 8)  # the team, if there are teams
        low = [0, *[0] * len(sides), -math.inf, -far, -far, *[-math.inf] * 4]
        high = [layout.dims["agents"] - 1, *sides, most, far, far, *[math.inf] * 4]
        return {"own": (low, high), "others": (low, high)}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros(dims["blocks"], np.int32)


@Agents.system(Phase.LOOK)
def update_masks(
    masks: Write[ObservationMasks],
    sight: Read[Sight],
    entities: Read[Entity],
    agents: Rows[Side],
    peers: Bitset[Side],
    alive: Scratch,
) -> None:
    """Set the masks of observations, and which rows are filled.

    masked: both only for what is visible. revealed: masks for what is visible, rows of all that exists are filled.
    omniscient: all that exists has both. A dead observer's masks are 0. Only masked mode hides other agents' rows.
    """
    mode = sight.mode[0]
    for b in range(peers.size):
        alive[b] = to_bits(load_flags(entities.alive, SIMD_WIDTH * b))
    for i in range(agents.size):
        living = -np.int32(entities.alive[agents[i]])  # all bits, or none
        for b in range(peers.size):
            mask = living & alive[b] if mode == OMNISCIENT else living & alive[b] & sight.visible[i, b]
            filled = mask if mode == MASKED else alive[b] | peers[b]
            masks.dirty[i, b] = masks.filled[i, b] | filled
            masks.filled[i, b] = filled
            masks.mask[i, b] = mask


@Agents.system(Phase.OBSERVE)
def see_self(
    body: Read[Body],
    health: Read[Health],
    side: Read[Side],
    entities: Read[Entity],
    agents: Rows[Side],
    view: Write[SelfView],
) -> None:
    """Each agent's own row: id, [team], health, x, y, angle, vx, vy, omega. With teams it is one longer."""
    me = view.own
    k = me.shape[1] - 7  # column of the health: behind the id, and the team if there is one
    for i in range(agents.size):
        e = agents[i]
        me[i, 0] = i
        if k == 2:
            me[i, 1] = side.side[e]
        if entities.alive[e]:
            me[i, k] = health.points[e]
            me[i, k + 1], me[i, k + 2], me[i, k + 3] = body.x[e], body.y[e], body.angle[e]
            me[i, k + 4], me[i, k + 5], me[i, k + 6] = body.vx[e], body.vy[e], body.omega[e]
        else:
            me[i, k:] = 0


@kernel
def fill_other(row: Array, e: int, filled: bool, tables: tuple[Array, Array]) -> None:
    """The row of agent `e`, as it observes itself."""
    own, index = tables
    for f in range(own.shape[1]):
        row[f] = own[index[e], f] if filled else 0


@Agents.system(Phase.OBSERVE, after="agents.see_self")
def see_others(
    view: Write[OthersView],
    own: Read[SelfView],
    masks: Read[ObservationMasks],
    peers: Bitset[Side],
    index: RowIndex[Side],
) -> None:
    """The other agents' own rows, in order of id; a dead one's row is what it would observe of itself."""
    write_rows(view.others, view.others_mask, masks, peers, index, fill_other, (own.own, index), True)
