"""Agents: round bodies controlled by a policy, and their observations of themselves and each other."""

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
from outlast.components.limits import CROWD, FAR, HEAVY, LIGHT
from outlast.components.sight import MASKED, OMNISCIENT
from outlast.ecs import (
    Archetype,
    Array,
    Bitset,
    DeclarationError,
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
    ref,
)
from outlast.ecs.kernels.simd import SIMD_SHIFT, SIMD_WIDTH, load_flags, to_bits

from .geometry.bounds import check_fits, ends, farthest_body
from .observation_rows import MOTION, observe, write_rows


@dataclass(frozen=True)
class Agents(Module):
    """The agents: their number, size and health (paper, section 3.1)."""

    count: int = number(2, low=1, high=CROWD, about="number of agents")
    radius: float = number(0.5, low=0.002, high=FAR, per_agent=True, unit="metres", about="radius of an agent")
    density: float = number(
        1.0,
        low=LIGHT,
        high=HEAVY,
        per_agent=True,
        unit="kilograms per square metre",
        about="density of an agent, which with its radius gives its mass",
    )
    health: int = number(
        100, low=1, high=MOST, per_agent=True, unit="hit points", about="hit points of an agent at the start"
    )

    def archetypes(self) -> Iterable[Archetype]:
        solid = Solid(dynamic=1, density=ref("density"))
        parts = (Body(), Shape(radius=ref("radius")), solid, Push(), Spawned(), Side(), Guard(), Died())
        return [Archetype("agent", (*parts, Health(points=ref("health"))), ref("count"), order=10, roles=True)]

    def singletons(self) -> Iterable[Singleton]:
        return [SelfView(), OthersView(), Sight(), ObservationMasks()]

    def dims(self) -> dict[str, int | str]:
        return {"agents": ref("count"), "others": "agents - 1"}

    def check(self, layout: Layout) -> None:
        for name, archetype in layout.archetypes.items():
            if name != "agent" and any(isinstance(part, Side) for part in archetype.parts):
                raise DeclarationError(
                    f"the kind '{name}' has Side, which makes agents: add them to the kind 'agent', as in "
                    f"Archetype('agent', (), 2), and separate them by roles; or leave Side out of '{name}'"
                )
        layout.check_count(Side, "agents")
        check_fits(layout, "agents.radius", self.radius, 2 * self.radius)

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"id": (0, layout.dims["agents"] - 1), **ends(farthest_body(layout))}}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros(dims["blocks"], np.int32)


@Agents.system(Phase.LOOK)
def update_masks(
    masks: Write[ObservationMasks],
    sight: Read[Sight],
    entities: Read[Entity],
    agents: Rows[Side],
    peers: Bitset[Side],
    rows: Bitset[Entity],
    alive: Scratch,
    present: Scratch,
) -> None:
    """Set the masks of observations, and which rows are filled.

    masked: only visible entities have a mask of 1 and a filled row. revealed: visible entities have a mask of 1, and
    all that exist have a filled row. omniscient: all that exist have both. A dead observer's masks are 0. Only masked
    mode hides other agents' rows.
    """
    mode = sight.mode[0]
    for b in range(peers.size):
        alive[b], present[b] = to_bits(load_flags(entities.alive, SIMD_WIDTH * b)) & rows[b], peers[b]
    if mode != MASKED:
        for e in agents:
            if entities.identity[e] < 0:  # absent: not observed
                present[e >> SIMD_SHIFT] &= ~(1 << (e & SIMD_WIDTH - 1))
    for i in range(agents.size):
        living = -np.int32(entities.alive[agents[i]])  # all bits, or none
        for b in range(peers.size):
            mask = living & alive[b] if mode == OMNISCIENT else living & alive[b] & sight.visible[i, b]
            filled = mask if mode == MASKED else alive[b] | present[b]
            masks.dirty[i, b] = masks.filled[i, b] | filled
            masks.filled[i, b] = filled
            masks.mask[i, b] = mask


@kernel
def number_of(i: int, e: int) -> int:
    """Return the number of an agent, its id, dead or alive."""
    return i


observe(Agents, SelfView, "own", Side, id=number_of, **MOTION)


@kernel
def fill_other(row: Array, i: int, e: int, filled: bool, tables: tuple[Array, Array]) -> None:
    """Copy the row of agent `e` as it observes itself."""
    own, index = tables
    for f in range(own.shape[1]):
        row[f] = own[index[e], f] if filled else 0


@Agents.system(Phase.OBSERVE, after=SelfView)
def see_others(
    view: Write[OthersView],
    own: Read[SelfView],
    masks: Read[ObservationMasks],
    peers: Bitset[Side],
    index: RowIndex[Side],
) -> None:
    """Write the other agents' own rows, including fields of other mechanics, even for dead agents."""
    write_rows(view.others, view.others_mask, masks, peers, index, fill_other, (own.own, index), True)
