"""Things: crates, planks and ramps, which agents push, hold and lock."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from outlast.components import Body, Look, Material, Phase, Shape, Solid, Spawned
from outlast.components.hide_and_seek import Crate, Movable, Ramp
from outlast.components.limits import FAR, HEAVY, LIGHT, MANY
from outlast.ecs import Archetype, Layout, Module, Read, Rows, Singleton, Write, number, ref
from outlast.systems.geometry.bounds import check_fits, ends, farthest_body
from outlast.systems.observation_rows import rows

KINDS = ("crate", "plank", "ramp")
LONG, THIN, SLOPE = 3.3, 0.3, 1.5  # sides of planks, and the length of ramps, in sides of a crate


@dataclass(frozen=True)
class Things(Module):
    """Crates, planks and ramps. Each counts from 0, and may vary.

    Sizes are those of the published environments (objects.py), where crates and planks are "boxes" and "elongated
    boxes". A ramp is as wide as a crate, and half as long again; theirs is a mesh.
    """

    crates: int = number(2, low=0, high=MANY, about="number of crates: squares")
    planks: int = number(0, low=0, high=MANY, about="number of planks: 3.3 times as long as a crate, 0.3 times as wide")
    ramps: int = number(1, low=0, high=MANY, about="number of ramps")
    size: float = number(0.5, low=0.1, high=FAR, unit="metres", about="side of a crate")
    density: float = number(
        1.0, low=LIGHT, high=HEAVY, unit="kilograms per square metre", about="density of crates, planks and ramps"
    )
    damping: float = number(
        6.0, low=0, high=FAR, unit="per second", about="share of its speed that a thing loses, by friction on the floor"
    )
    lockable_ramps: bool = number(False, about="ramps can be locked, too")

    def archetypes(self) -> Iterable[Archetype]:
        floor = Material(linear_damping=ref("damping"), angular_damping=ref("damping"))
        solid, half = Solid(dynamic=1, density=ref("density")), self.size / 2
        shapes = (half, half), (LONG * half, THIN * half), (SLOPE * half, half)
        marks = (Movable(), Crate()), (Movable(), Crate()), (Movable(lockable=ref("lockable_ramps")), Ramp())
        for kind, (width, height), parts in zip(KINDS, shapes, marks, strict=True):
            shape = Shape(half_width=width, half_height=height)
            yield Archetype(kind, (Body(), shape, solid, floor, Spawned(), *parts), ref(f"{kind}s"), order=20)

    def singletons(self) -> Iterable[Singleton]:
        return [CratesView(), RampsView()]

    def dims(self) -> dict[str, int | str]:
        squares, long = ref("crates"), ref("planks")
        return {"squares": squares, "planks": long, "crates": "squares + planks", "ramps": ref("ramps")}

    def looks(self) -> Mapping[str, Look]:
        """Return looks: a thing has the colour of the side that has locked it."""
        return {kind: Look(tint=Movable.locked_by) for kind in KINDS}

    def check(self, layout: Layout) -> None:
        check_fits(layout, "things.size", self.size, LONG * self.size if self.planks else SLOPE * self.size)

    def bounds(self, layout: Layout) -> Mapping[str, Any]:
        return dict.fromkeys(("crates", "ramps"), ends(farthest_body(layout)))


@Things.system(Phase.SPAWN, after=Body)
def remember_start(movable: Write[Movable], body: Read[Body], things: Rows[Movable]) -> None:
    """Note where everything stands."""
    for e in things:
        movable.start_x[e], movable.start_y[e] = body.x[e], body.y[e]


MOTION = {name: getattr(Body, name) for name in ("x", "y", "angle", "vx", "vy", "omega")}
CratesView = rows(Things, "crates", Crate, **MOTION, half_width=Shape.half_width, half_height=Shape.half_height)
RampsView = rows(Things, "ramps", Ramp, **MOTION)
