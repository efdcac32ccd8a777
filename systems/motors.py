"""Motors: agents move themselves ahead, sideways and around, in their own frame: by pushing, or by saying how fast."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from outlast.components import Body, Drive, Phase, Push, Side, Solid, Steer
from outlast.components.body import inverse
from outlast.ecs import Entity, Module, Read, Rows, Singleton, Write, number

THIRD = np.float32(1 / 3)  # Steer has three levels each way


@dataclass(frozen=True)
class Motors(Module):
    """Dynamic control (paper, section 3.1 and appendix). What one tick of full thrust gives, and when it is given.

    give = "evenly": a force during the whole tick, as the paper says. "at once": an impulse ahead of the tick, as
    the paper's runs did (reference rules, section 6, point 1).
    """

    ahead: float = number(0.25, low=0)  # newton-seconds a tick
    left: float = number(0.25, low=0)
    turn: float = number(0.0125, low=0)  # newton-metre-seconds a tick
    give: str = number("evenly", choices=("evenly", "at once"))

    def singletons(self) -> Iterable[Singleton]:
        return [Drive()]


@Motors.system(Phase.DRIVE)
def drive(
    body: Write[Body],
    push: Write[Push],
    solid: Read[Solid],
    drive: Read[Drive],
    entities: Read[Entity],
    agents: Rows[Side, Push],
    ahead: float,
    left: float,
    turn: float,
    give: int,
) -> None:
    """Turn the learner's wish into momentum."""
    for i in range(agents.size):
        e = agents[i]
        if not entities.alive[e]:
            continue
        forward, sideways, around = ahead * drive.ahead[i], left * drive.left[i], turn * drive.turn[i]
        x = body.cosine[e] * forward - body.sine[e] * sideways
        y = body.sine[e] * forward + body.cosine[e] * sideways
        if give == 0:
            push.x[e], push.y[e], push.turn[e] = x, y, around
        else:
            lightness = inverse(solid.mass[e])
            body.vx[e] += lightness * x
            body.vy[e] += lightness * y
            body.omega[e] += inverse(solid.inertia[e]) * around


@dataclass(frozen=True)
class Steering(Module):
    """Direct control of velocity in seven levels, in the place of Motors: nobody slides.

    Not in the paper, which names its motors as a flaw (section 5, flaw 4): they take 37 ticks to slow an agent down to
    1/e. The numbers are what the highest level gives, ahead of the damping of physics and of contacts.
    """

    name = "motors"

    speed: float = number(5.0, low=0)  # metres a second, ahead or to the left
    spin: float = number(math.pi, low=0)  # radians a second

    @classmethod
    def slot(cls) -> type[Module]:
        return Motors

    def singletons(self) -> Iterable[Singleton]:
        return [Steer()]


@Steering.system(Phase.DRIVE)
def steer(
    body: Write[Body], wish: Read[Steer], entities: Read[Entity], agents: Rows[Side, Push], speed: float, spin: float
) -> None:
    """Turn the learner's wish into velocity."""
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e]:
            forward, sideways = speed * (wish.ahead[i] * THIRD), speed * (wish.left[i] * THIRD)
            body.vx[e] = body.cosine[e] * forward - body.sine[e] * sideways
            body.vy[e] = body.sine[e] * forward + body.cosine[e] * sideways
            body.omega[e] = spin * (wish.turn[i] * THIRD)
