"""Steering: agents set their velocity, in their own frame, in seven levels; with FineSteering, in hundredths."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Body, Phase, Push, Side, Steer, Throttle
from outlast.components.limits import FAST
from outlast.components.motor import HUNDREDTH, Control
from outlast.components.respawn import inactive
from outlast.ecs import Entity, Module, Read, Rows, Singleton, System, WorldsView, Write, kernel, number, of

THIRD = np.float32(1 / 3)  # Steer has three levels each way


@dataclass(frozen=True)
class Steering(Module):
    """Direct control of velocity in seven levels, instead of Motors: agents do not slide.

    Not in the paper, which names its motors as a flaw (section 5, flaw 4): with them, an agent takes 37 ticks to slow
    down to 1/e. The numbers are the velocities at the highest level, before the physics' damping and contacts.
    """

    speed: float = number(
        5.0,
        low=0,
        high=FAST,
        per_agent=True,
        unit="metres per second",
        about="speed at the highest level, ahead, back or to a side",
    )
    spin: float = number(
        math.pi,
        low=0,
        high=FAST,
        per_agent=True,
        unit="radians per second",
        about="speed of turning at the highest level",
    )

    @classmethod
    def slot(cls) -> type:
        return Control

    def singletons(self) -> Iterable[Singleton]:
        return [Steer()]

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        return dict.fromkeys(("ahead", "left", "turn"), inactive(worlds))


@Steering.system(Phase.DRIVE)
def steer(
    body: Write[Body], steer: Read[Steer], entities: Read[Entity], agents: Rows[Side, Push], speed: float, spin: float
) -> None:
    """Turn actions into velocity."""
    move_all(steer, THIRD, body, entities, agents, speed, spin)


@kernel
def move_all(action: Any, share: Any, body: Any, entities: Any, agents: Any, speed: Any, spin: Any) -> None:
    """Set the velocity of living agents. share: the share of the maximum for an action of 1, float32."""
    for i in range(agents.size):
        e = agents[i]
        if entities.alive[e]:
            most = of(speed, e)
            forward, sideways = most * (action.ahead[i] * share), most * (action.left[i] * share)
            body.vx[e] = body.cosine[e] * forward - body.sine[e] * sideways
            body.vy[e] = body.sine[e] * forward + body.cosine[e] * sideways
            body.omega[e] = of(spin, e) * (action.turn[i] * share)


@dataclass(frozen=True)
class FineSteering(Steering):
    """Steering whose velocity is given in hundredths, for continuous actions. Not in the paper."""

    def singletons(self) -> Iterable[Singleton]:
        return [Throttle()]

    def systems(self) -> Iterable[System]:
        return [system for system in super().systems() if system.name != "steer"]


@FineSteering.system(Phase.DRIVE)
def steer_finely(
    body: Write[Body],
    throttle: Read[Throttle],
    entities: Read[Entity],
    agents: Rows[Side, Push],
    speed: float,
    spin: float,
) -> None:
    """Turn actions into velocity."""
    move_all(throttle, HUNDREDTH, body, entities, agents, speed, spin)
