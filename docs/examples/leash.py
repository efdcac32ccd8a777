"""A leash: every agent is tied to a post by a rope, which tears if it pulls too hard."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Phase, Rope, RopeBroken, Shape, Solid
from outlast.ecs import Archetype, Array, Component, Module, Read, Rows, Statistic, Write, column, number


class Post(Component):
    """What agents are tied to."""


class Torn(Statistic):
    """How many ropes have torn in an episode."""

    torn: Array = column("i4")


@dataclass(frozen=True)
class Leash(Module):
    """The ropes are made at the start of an episode; physics ends them."""

    length: float = number(3.0, above=0, unit="metres", about="length of a rope")
    strength: float = number(150.0, low=0, unit="newtons", about="force at which a rope tears; 0: never")

    def archetypes(self):
        """A post in the middle of the yard."""
        post = Body(), Shape(radius=0.2), Solid(), Post()
        return [Archetype("agent", (Rope(),)), Archetype("post", post, 1)]

    def singletons(self):
        """RopeBroken is filled by physics in games that bring it."""
        return [RopeBroken(), Torn()]


@Leash.system(Phase.DRAW)
def fasten(ropes: Write[Rope], agents: Rows[Rope], posts: Rows[Post], length: float, strength: float) -> None:
    """Fasten both ends in the middle of the bodies."""
    for e in agents:
        ropes.other[e], ropes.length[e], ropes.breaks_at[e] = posts[0], length, strength


@Leash.system(Phase.RECORD)
def count(torn: Write[Torn], broken: Read[RopeBroken]) -> None:
    """Events of the tick can be read until the next one begins."""
    torn.torn[0] += broken.count[0]


LEASH = yard("leash", Leash())
