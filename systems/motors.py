"""Motors: agents push themselves ahead, sideways and around, in their own frame. FineMotors do so in hundredths."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Body, Drive, Phase, Push, Side, Solid, Throttle
from outlast.components.body import ONE, inverse
from outlast.components.limits import STRONG
from outlast.components.motor import HUNDREDTH, Control
from outlast.components.respawn import inactive
from outlast.ecs import Entity, Module, Read, Rows, Singleton, System, WorldsView, Write, kernel, number, of


@dataclass(frozen=True)
class Motors(Module):
    """Dynamic control (paper, section 3.1 and appendix): the effect of one tick of full thrust.

    give = "evenly": a force throughout the tick, as in the paper's text. "at once": an impulse before the tick, as in
    the paper's runs (reference rules, section 6, point 1).
    """

    ahead: float = number(
        0.25, low=0, high=STRONG, per_agent=True, unit="newton-seconds per tick", about="full thrust ahead or back"
    )
    left: float = number(
        0.25, low=0, high=STRONG, per_agent=True, unit="newton-seconds per tick", about="full thrust to a side"
    )
    turn: float = number(
        0.0125,
        low=0,
        high=STRONG,
        per_agent=True,
        unit="newton-metre-seconds per tick",
        about="full thrust around the centre",
    )
    give: str = number(
        "evenly",
        choices=("evenly", "at once"),
        about="thrust is a force throughout the tick (evenly), or an impulse before it (at once)",
    )

    @classmethod
    def slot(cls) -> type:
        return Control

    def singletons(self) -> Iterable[Singleton]:
        return [Drive()]

    def idle_actions(self, worlds: WorldsView) -> Mapping[str, Any]:
        return dict.fromkeys(("ahead", "left", "turn"), inactive(worlds))


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
    """Turn actions into momentum."""
    push_all(drive, ONE, body, push, solid, entities, agents, ahead, left, turn, give)


@kernel
def push_all(
    action: Any,
    share: Any,
    body: Any,
    push: Any,
    solid: Any,
    entities: Any,
    agents: Any,
    ahead: Any,
    left: Any,
    turn: Any,
    give: int,
) -> None:
    """Push living agents. share: the share of full thrust for an action of 1, float32."""
    for i in range(agents.size):
        e = agents[i]
        if not entities.alive[e]:
            continue
        forward = of(ahead, e) * (action.ahead[i] * share)
        sideways = of(left, e) * (action.left[i] * share)
        around = of(turn, e) * (action.turn[i] * share)
        x = body.cosine[e] * forward - body.sine[e] * sideways
        y = body.sine[e] * forward + body.cosine[e] * sideways
        if give == 0:
            push.x[e], push.y[e], push.turn[e] = x, y, around
        else:
            push.x[e], push.y[e], push.turn[e] = 0, 0, 0  # left over from ticks with the other choice of `give`
            inverse_mass = inverse(solid.mass[e])
            body.vx[e] += inverse_mass * x
            body.vy[e] += inverse_mass * y
            body.omega[e] += inverse(solid.inertia[e]) * around


@dataclass(frozen=True)
class FineMotors(Motors):
    """Motors whose thrust is given in hundredths, for continuous actions. Not in the paper."""

    def singletons(self) -> Iterable[Singleton]:
        return [Throttle()]

    def systems(self) -> Iterable[System]:
        return [system for system in super().systems() if system.name != "drive"]


@FineMotors.system(Phase.DRIVE)
def drive_finely(
    body: Write[Body],
    push: Write[Push],
    solid: Read[Solid],
    throttle: Read[Throttle],
    entities: Read[Entity],
    agents: Rows[Side, Push],
    ahead: float,
    left: float,
    turn: float,
    give: int,
) -> None:
    """Turn actions into momentum."""
    push_all(throttle, HUNDREDTH, body, push, solid, entities, agents, ahead, left, turn, give)
