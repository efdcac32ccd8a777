"""A spring: two agents that are tied to each other by a rod that gives way."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Phase, Rope
from outlast.ecs import Archetype, Module, Rows, Write, number


@dataclass(frozen=True)
class Spring(Module):
    """A rod with a frequency is a spring."""

    length: float = number(2.0, above=0, unit="metres", about="length at rest")
    hertz: float = number(1.0, above=0, unit="per second", about="frequency: the higher, the stiffer")

    def archetypes(self):
        """Agents can have a rope."""
        return [Archetype("agent", (Rope(),))]


@Spring.system(Phase.SPAWN)
def tie(ropes: Write[Rope], agents: Rows[Rope], length: float, hertz: float) -> None:
    """Agent 0 has the spring, and agent 1 is at its other end."""
    e = agents[0]
    ropes.other[e], ropes.length[e], ropes.rod[e], ropes.hertz[e] = agents[1], length, 1, hertz


SPRING = yard("spring", Spring(), agents=2)
