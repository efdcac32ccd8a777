"""A ball that never comes to rest, and a door that slides to and fro: no code, but for the door's way."""

from dataclasses import dataclass

from yard import yard

from outlast.components import Body, Driven, Material, Phase, Shape, Solid
from outlast.ecs import Archetype, Module, Rows, Write, number


@dataclass(frozen=True)
class BouncingBall(Module):
    """The ball keeps its speed, as nothing slows it down and it bounces off as fast as it came."""

    way: float = number(3.0, above=0, unit="metres", about="how far the door slides to either side")

    def archetypes(self):
        """What differs from the usual is said by Material and Driven."""
        lively = Material(friction=0.0, restitution=1.0, linear_damping=0.0)
        ball = Body(x=-3.0, vx=5.0, vy=3.0), Shape(radius=0.3), Solid(dynamic=1, density=0.2), lively
        door = Body(vy=1.0), Shape(half_width=0.1, half_height=1.5), Solid(), Driven()
        return [Archetype("ball", ball, 1), Archetype("door", door, 1)]


@BouncingBall.system(Phase.DRIVE, after=Body)
def slide(body: Write[Body], doors: Rows[Driven], way: float) -> None:
    """Turn back at the ends."""
    for e in doors:
        if abs(body.y[e]) > way:
            body.vy[e] = -1.0 if body.y[e] > 0 else 1.0


BOUNCING_BALL = yard("bouncing_ball", BouncingBall())
