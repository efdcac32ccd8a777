"""Preparation: the first ticks of an episode, in which some agents are frozen, or blind."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Body, Phase, Push, Rays, SelfView, Side, Sight, Weapon
from outlast.components.limits import MANY, TICKS
from outlast.ecs import Array, Clock, Field, Layout, Module, NumberError, Read, Rows, System, Write, kernel, number, of

from .observation_rows import observe


def usual_ticks(layout: Layout) -> float:
    """Return the length of the preparation: the scale of the remaining ticks."""
    return layout.numbers("preparation").get("ticks") or 1.0


@dataclass(frozen=True)
class Preparation(Module):
    """Agents of some sides wait for `ticks` ticks, like seekers while others hide.

    frozen: they have no motors and do not attack, but others can push and hurt them. blind: they see nothing, as if
    their cameras and lidar were off. Each agent observes its remaining ticks of waiting, in the field
    "preparation" of its row.
    """

    ticks: int = number(100, low=0, high=TICKS, per_agent=True, unit="ticks", about="how long agents wait")
    sides: tuple[float, ...] = number((), low=0, high=MANY, about="numbers of the sides that wait; (): all sides")
    frozen: bool = number(True, about="waiting agents stand still and do not attack")
    blind: bool = number(False, about="waiting agents see nothing")

    def systems(self) -> Iterable[System]:
        left_out = {"see_nothing", "measure_nothing"} if not self.blind else set[str]()
        left_out |= {"hold", "hold_fire"} if not self.frozen else set()
        return [system for system in super().systems() if system.name not in left_out]

    def fields(self) -> Mapping[str, tuple[Field, ...]]:
        return {"own": (Field("preparation", "ticks", low=0, scale=usual_ticks),)}

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return {"own": {"preparation": (0, self.ticks)}}

    def check(self, layout: Layout) -> None:
        if not (self.frozen or self.blind):
            raise NumberError(
                "preparation.frozen and preparation.blind are both False, so that it changes nothing; set one of them, "
                "or leave it out"
            )
        if len({*self.sides}) < len(self.sides):
            raise NumberError(f"preparation.sides = {self.sides}: a side occurs twice; give it once")
        known = layout.dims.get("sides", 0)
        for side in self.sides:
            if side != int(side) or side >= known:
                raise NumberError(f"preparation.sides: side {side:g} does not exist; take sides from 0 to {known - 1}")
        mode = layout.numbers("cameras").get("mode", "omniscient")
        if self.blind and mode == "omniscient":
            raise NumberError(
                "preparation.blind: agents see everything, as cameras are missing or cameras_mode is omniscient; add "
                "Cameras, or set preparation_blind=False"
            )


@kernel
def left(side: Array, sides: Array, ticks: int, tick: int, e: int) -> int:
    """Return the remaining ticks of waiting of agent `e`."""
    waits = len(sides) == 0
    for s in sides:
        waits = waits or s == side.side[e]
    return max(ticks - tick, 0) if waits else 0


@Preparation.system(Phase.SPAWN)
def hold_fire(
    weapon: Write[Weapon], side: Read[Side], agents: Rows[Weapon, Side], sides: tuple[float, ...], ticks: int
) -> None:
    """Begin with a cooldown for the weapons of waiting agents."""
    for e in agents:
        weapon.cooldown[e] = left(side, sides, of(ticks, e), 0, e)


@Preparation.system(Phase.DRIVE, after=(Body, Push))
def hold(
    body: Write[Body],
    push: Write[Push],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side, Push],
    sides: tuple[float, ...],
    ticks: int,
) -> None:
    """Keep waiting agents still."""
    for e in agents:
        if left(side, sides, of(ticks, e), int(clock.tick[0]) - 1, e) > 0:
            body.vx[e], body.vy[e], body.omega[e] = 0, 0, 0
            push.x[e], push.y[e], push.turn[e] = 0, 0, 0


@Preparation.system(Phase.SEE, after=Sight)
def see_nothing(
    sight: Write[Sight], side: Read[Side], clock: Read[Clock], agents: Rows[Side], sides: tuple[float, ...], ticks: int
) -> None:
    """Blind waiting agents. In the last tick of the wait they see again, as its observation is for the next action."""
    for i in range(agents.size):
        if left(side, sides, of(ticks, agents[i]), int(clock.tick[0]), agents[i]) > 0:
            for b in range(sight.visible.shape[1]):
                sight.visible[i, b] = 0


@Preparation.system(Phase.SEE)
def measure_nothing(
    state: Write[Rays],
    side: Read[Side],
    clock: Read[Clock],
    agents: Rows[Side, Rays],
    sides: tuple[float, ...],
    ticks: int,
) -> None:
    """Switch off the rays of blind agents while they wait."""
    for e in agents:
        state.off[e] = left(side, sides, of(ticks, e), int(clock.tick[0]), e) > 0


@kernel
def waits(i: int, e: int, side: Read[Side], clock: Read[Clock], sides: tuple[float, ...], ticks: int) -> int:
    """Return the remaining ticks of waiting of an agent, dead or alive."""
    return left(side, sides, of(ticks, e), int(clock.tick[0]), e)


observe(Preparation, SelfView, "own", Side, preparation=waits)
