"""Agents: round bodies that someone steers, and what they are told of themselves and each other."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from outlast.components import Body, Guard, Health, OthersView, Phase, Push, SelfView, Shape, Side, Sight, Solid, Spawned
from outlast.components.health import Death
from outlast.components.sight import look
from outlast.ecs import Archetype, Array, Entity, Module, Read, Rows, Singleton, Write, kernel, number


@dataclass(frozen=True)
class Agents(Module):
    """Who plays: how many, how big, how healthy (paper, section 3.1)."""

    count: int = number(2, low=1)
    radius: float = number(0.5, low=0.002)  # metres
    density: float = number(1.0, above=0)  # kilograms per square metre
    health: int = number(100, low=1)  # hit points at birth

    def archetypes(self) -> Iterable[Archetype]:
        mass = self.density * math.pi * self.radius**2
        push = Push(inverse_mass=1 / mass, inverse_inertia=2 / (mass * self.radius**2))
        parts = (Body(), Shape(radius=self.radius), Solid(dynamic=1), push, Spawned(), Side(), Guard(), Death())
        return [Archetype("agent", (*parts, Health(points=self.health)), self.count)]

    def singletons(self) -> Iterable[Singleton]:
        return [SelfView(), OthersView(), Sight()]

    def dims(self) -> dict[str, int | str]:
        return {"agents": self.count, "others": self.count - 1, "features": 8}


@kernel
def describe(row: Array, body: Array, health: Array, side: Array, i: int, e: int, alive: bool) -> None:
    """Fill a row: id, [team], health, x, y, angle, vx, vy, omega. With teams it is one longer."""
    row[:] = 0
    row[0] = i
    k = 1
    if row.size == 9:
        row[1] = side.side[e]
        k = 2
    if alive:
        row[k] = health.points[e]
        row[k + 1], row[k + 2], row[k + 3] = body.x[e], body.y[e], body.angle[e]
        row[k + 4], row[k + 5], row[k + 6] = body.vx[e], body.vy[e], body.omega[e]


@Agents.system(Phase.OBSERVE)
def see_self(
    body: Read[Body], health: Read[Health], side: Read[Side], entities: Read[Entity], agents: Rows[Side], view: Write[SelfView]
) -> None:
    """Each agent's own row."""
    for i in range(agents.size):
        e = agents[i]
        describe(view.me[i], body, health, side, i, e, entities.alive[e] != 0)


@Agents.system(Phase.OBSERVE)
def see_others(
    body: Read[Body],
    health: Read[Health],
    side: Read[Side],
    entities: Read[Entity],
    sight: Read[Sight],
    agents: Rows[Side],
    view: Write[OthersView],
) -> None:
    """The other agents' rows, in order of id."""
    for i in range(agents.size):
        for j in range(agents.size):
            if i == j:
                continue
            k = j - 1 if j > i else j
            mask, shown = look(sight, entities, i, agents[i], agents[j])
            view.others_mask[i, k] = mask
            if shown or sight.mode[0] != 0:
                describe(view.others[i, k], body, health, side, j, agents[j], shown != 0)
            else:
                view.others[i, k, :] = 0
