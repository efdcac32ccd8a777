"""Agents: round bodies that someone steers, and what they are told of themselves and each other."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import (
    Body,
    Guard,
    Health,
    OthersView,
    Phase,
    Push,
    SelfView,
    Shape,
    Side,
    Sight,
    Solid,
    Spawned,
    Told,
)
from outlast.components.health import MOST, Death
from outlast.components.sight import MASKED, OMNISCIENT, told
from outlast.ecs import (
    Archetype,
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
    number,
)
from outlast.ecs.simd import SIMD_WIDTH, load_flags, to_bits

from .inner.places import moved
from .inner.sweep import row, span


@dataclass(frozen=True)
class Agents(Module):
    """Who plays: how many, how big, how healthy (paper, section 3.1)."""

    count: int = number(2, low=1)
    radius: float = number(0.5, low=0.002)  # metres
    density: float = number(1.0, above=0)  # kilograms per square metre
    health: int = number(100, low=1, high=MOST)  # hit points at birth

    def archetypes(self) -> Iterable[Archetype]:
        solid = Solid(dynamic=1, density=self.density)
        parts = (Body(), Shape(radius=self.radius), solid, Push(), Spawned(), Side(), Guard(), Death())
        return [Archetype("agent", (*parts, Health(points=self.health)), self.count)]

    def singletons(self) -> Iterable[Singleton]:
        return [SelfView(), OthersView(), Sight(), Told()]

    def dims(self) -> dict[str, int | str]:
        return {"agents": self.count, "others": self.count - 1, "features": 8}

    def check(self, layout: Layout) -> None:
        layout.check_count(Side, "agents")

    def bounds(self, layout: Layout) -> Mapping[str, tuple[Any, Any]]:
        """Health has no lowest value: the zone and others may take more than is left, and it is seen before death."""
        far, most = moved(layout), layout.numbers("health").get("limit") or math.inf
        sides = [layout.dims.get("sides", 1) - 1] * (layout.dims["features"] - 8)  # the team, if there are teams
        low = [0, *[0] * len(sides), -math.inf, -far, -far, *[-math.inf] * 4]
        high = [layout.dims["agents"] - 1, *sides, most, far, far, *[math.inf] * 4]
        return {"self": (low, high), "others": (low, high)}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros(dims["blocks"], np.int32)


@Agents.system(Phase.LOOK)
def look(
    tell: Write[Told],
    sight: Read[Sight],
    entities: Read[Entity],
    agents: Rows[Side],
    peers: Bitset[Side],
    here: Scratch,
) -> None:
    """What the masks say, and which entries are filled.

    masked: both only for what the camera sees. revealed: the camera masks, entries of all that exists are filled.
    omniscient: all that exists has both. A dead observer's masks are 0. Only masked mode hides other agents' entries.
    """
    mode = sight.mode[0]
    for g in range(peers.size):
        here[g] = to_bits(load_flags(entities.alive, SIMD_WIDTH * g))
    for i in range(agents.size):
        awake = -np.int32(entities.alive[agents[i]])  # all bits, or none
        for g in range(peers.size):
            mask = awake & here[g] if mode == OMNISCIENT else awake & here[g] & sight.seen[i, g]
            filled = mask if mode == MASKED else here[g] | peers[g]
            tell.stale[i, g] = tell.filled[i, g] | filled
            tell.filled[i, g] = filled
            tell.masks[i, g] = mask


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
    me = view.me
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


@Agents.system(Phase.OBSERVE, after="agents.see_self")
def see_others(
    view: Write[OthersView],
    own: Read[SelfView],
    tell: Read[Told],
    agents: Rows[Side],
    peers: Bitset[Side],
    index: RowIndex[Side],
) -> None:
    """The other agents' own rows, in order of id; a dead one's row is what it would see of itself."""
    first, last = span(peers)
    for i in range(agents.size):
        for g in range(first, last):
            left = tell.stale[i, g] & peers[g]
            while left:
                e = row(g, left)
                left &= left - 1
                j = index[e]
                if i == j:
                    continue
                k = j - 1 if j > i else j
                view.others_mask[i, k] = told(tell.masks, i, e)
                filled = told(tell.filled, i, e)
                for f in range(own.me.shape[1]):
                    view.others[i, k, f] = own.me[j, f] if filled else 0
