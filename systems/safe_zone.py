"""The safe zone: a circle that rests, then shrinks and moves; agents outside it are damaged."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from outlast.components import Body, DamageType, Floor, Guard, Health, Hit, Phase, Side, Zone, ZoneView
from outlast.components.health import MOST, hurt
from outlast.components.limits import TICKS
from outlast.components.zone import outside
from outlast.ecs import (
    Array,
    Clock,
    Entity,
    Layout,
    Module,
    NumberError,
    Random,
    Read,
    Rows,
    Singleton,
    Write,
    kernel,
    number,
    of,
)
from outlast.ecs.kernels.random import uniform2

from .geometry.bounds import ROUNDING, ends, floor_sides
from .observation_rows import observe

HALF = np.float32(0.5)


@dataclass(frozen=True)
class SafeZone(Module):
    """Phases of `stand` ticks of rest and `shrink` ticks of linear change (paper, section 3.3).

    radii: the radius of each phase, in metres; after the last phase the zone is void. centres = "random": independent,
    uniform over all places where the circle fits into the room. "middle": always the origin.
    """

    stream = "zone"
    damage_type: ClassVar[str] = "zone"

    radii: tuple[float, ...] = number(
        (12.5, 10.0, 7.5, 5.0, 4.0, 2.0, 1.0),
        above=0,
        scales_with="room_size",
        unit="metres",
        about="radius of the zone in each phase; after the last phase there is no zone",
    )
    stand: int = number(100, low=0, high=TICKS, unit="ticks", about="how long the zone rests in a phase")
    shrink: int = number(
        100, low=1, high=TICKS, unit="ticks", about="how long it takes to move and shrink to the next phase"
    )
    damage: int = number(
        1, low=0, high=MOST, per_agent=True, unit="hit points per tick", about="what agents outside of the zone lose"
    )
    centres: str = number(
        "random",
        choices=("random", "middle"),
        about="the zone is wherever it fits into the room (random), or always at the origin (middle)",
    )

    def singletons(self) -> Iterable[Singleton]:
        return [Zone(), ZoneView(), Hit()]

    def dims(self) -> dict[str, int | str]:
        return {"zones": len(self.radii) + 1, "hits": "agents"}

    def check(self, layout: Layout) -> None:
        if not self.radii:
            raise NumberError("safe_zone.radii is empty: at least one phase is needed; leave SafeZone out for no zone")
        size = min(floor_sides(layout))
        if max(self.radii) > size / 2:
            raise NumberError(
                f"safe_zone.radii: {max(self.radii):g} does not fit into a room of side {size:g} (at most half); set "
                f"radii that do, as in safe_zone_radii={_shown(self.radii, size)}"
            )

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        x, y = floor_sides(layout)
        circle = ends((x / 2 * ROUNDING, y / 2 * ROUNDING)) | {"radius": (0, max(self.radii) * ROUNDING)}
        return {"zone": circle | {f"next_{name}": ends for name, ends in circle.items()}}


def _shown(radii: tuple[float, ...], size: float) -> str:
    """Return these radii, scaled to a room whose shorter side is `size`, as text to type."""
    return ",".join(f"{radius * size / 2 / max(radii):.3g}" for radius in radii)


@SafeZone.system(Phase.DRAW)
def draw(zone: Write[Zone], floor: Read[Floor], radii: tuple[float, ...], centres: int, key: Random) -> None:
    """Draw a centre for every phase, including the void one."""
    for k in range(zone.centres.shape[0]):
        radius = radii[k] if k < len(radii) else np.float32(0)
        width = floor.size[0] - radius - radius if centres == 0 else np.float32(0)
        height = floor.size[floor.size.size - 1] - radius - radius if centres == 0 else np.float32(0)
        x, y = uniform2(key, k)
        zone.centres[k, 0], zone.centres[k, 1] = width * (x - HALF), height * (y - HALF)


@kernel
def zone_at(zone: Array, radii: Array, tick: int, stand: int, shrink: int) -> None:
    """Compute the zone after `tick` ticks: a function of time alone."""
    cycle = stand + shrink
    phase = min(tick // cycle, len(radii))
    zone.x[0], zone.y[0] = zone.centres[phase, 0], zone.centres[phase, 1]
    zone.radius[0] = radii[phase] if phase < len(radii) else 0
    if phase == len(radii):
        zone.next_x[0], zone.next_y[0], zone.next_radius[0] = 0, 0, 0
        return
    zone.next_x[0], zone.next_y[0] = zone.centres[phase + 1, 0], zone.centres[phase + 1, 1]
    zone.next_radius[0] = radii[phase + 1] if phase + 1 < len(radii) else 0
    share = np.float32(max(0, tick - phase * cycle - stand)) / np.float32(shrink)
    rest = np.float32(1) - share
    zone.x[0] = rest * zone.x[0] + share * zone.next_x[0]
    zone.y[0] = rest * zone.y[0] + share * zone.next_y[0]
    zone.radius[0] = rest * zone.radius[0] + share * zone.next_radius[0]


@SafeZone.system(Phase.SPAWN)
def begin(zone: Write[Zone], radii: tuple[float, ...], stand: int, shrink: int) -> None:
    """Set up the zone of the first phase."""
    zone_at(zone, radii, 0, stand, shrink)


@SafeZone.system(Phase.ZONE)
def apply_damage(
    health: Write[Health],
    hits: Write[Hit],
    guard: Read[Guard],
    body: Read[Body],
    zone: Read[Zone],
    entities: Read[Entity],
    clock: Read[Clock],
    agents: Rows[Side, Health],
    damage: int,
    damage_type: DamageType,
) -> None:
    """Damage agents whose centre is beyond the rim. It kills at the next check, unless a heal is used before that."""
    for e in agents:
        if entities.alive[e] and outside(zone, body, e):
            hurt(health, guard, hits, e, of(damage, e), damage_type, -1, clock.tick[0])


@SafeZone.system(Phase.ZONE, after="safe_zone.apply_damage")
def move(zone: Write[Zone], clock: Read[Clock], radii: tuple[float, ...], stand: int, shrink: int) -> None:
    """Move the zone to its place after this tick."""
    zone_at(zone, radii, int(clock.tick[0]), stand, shrink)


observe(SafeZone, ZoneView, "zone", Side, **{field.name: getattr(Zone, field.name) for field in ZoneView.zone.fields})
