"""Games whose bodies have filters and materials, or are driven: both backends do the same, and what the tables say."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from outlast.components import Body, Driven, Fault, Filter, Material, Phase, Push, Shape, Solid
from outlast.components.contact import fix, free
from outlast.ecs import RESET, STEP, Archetype, Array, Component, Entity, Module, Rows, Worlds, Write, column
from outlast.systems import Physics, Room
from tests.conftest import COMPILED

KINDS: dict[str, tuple[int, tuple[Component, ...]]] = {
    "ball": (5, (Shape(radius=0.4), Solid(dynamic=1), Filter(), Material())),
    "crate": (4, (Shape(half_width=0.6, half_height=0.3), Solid(dynamic=1), Filter())),
    "stone": (3, (Shape(half_width=0.5, half_height=0.5), Solid(dynamic=1), Material())),
    "post": (2, (Shape(radius=0.5), Solid())),
    "door": (2, (Shape(half_width=0.1, half_height=1.0), Solid(), Driven(), Filter())),
}


class Held(Component):
    """Whether a stone is to be static."""

    fixed: Array = column("u1", high=1)


@dataclass(frozen=True)
class Zoo(Module):
    """Bodies of all kinds."""

    def archetypes(self) -> Iterable[Archetype]:
        kinds = [Archetype(name, (Body(), Push(), *parts), count) for name, (count, parts) in KINDS.items()]
        return [*kinds, Archetype("stone", (Held(),))]


@Zoo.system(Phase.DRIVE)
def hold(solid: Write[Solid], body: Write[Body], held: Write[Held], stones: Rows[Held]) -> None:
    for e in stones:
        if held.fixed[e]:
            fix(solid, body, e)
        else:
            free(solid, e)


def worlds(count: int = 1, backend: str = "auto", **numbers: Any) -> Worlds:
    made = Worlds((Room(size=8.0), Physics(backend=backend, **numbers), Zoo()), count)
    made.run(np.full(count, RESET, np.int8))
    return made


def bodies_of(made: Worlds) -> slice:
    """Return all rows but those of the walls, which come first."""
    return slice(made.span("ball").start, made.span("stone").stop)


def tick(made: Worlds) -> None:
    made.run(np.full(made.count, STEP, np.int8))
    assert not made[Fault].physics.any()


def alone(made: Worlds, **places: tuple[float, ...]) -> dict[str, int]:
    """Leave only the first of these kinds alive, at these places: x, y, and maybe vx, vy. Their rows by kind."""
    rows = {kind: made.span(kind).start for kind in places}
    made[Entity].alive[0, bodies_of(made)] = 0
    for kind, place in places.items():
        made[Entity].alive[0, rows[kind]] = 1
        for name, value in zip(("x", "y", "vx", "vy"), place, strict=False):
            getattr(made[Body], name)[0, rows[kind]] = value
    return rows


def stir(made: Worlds, rng: np.random.Generator) -> None:
    """Give all bodies random places and speeds, and random numbers of all that they may differ in."""
    body, shape = made[Body], (made.count, made.dims["rows"])
    bodies = bodies_of(made)
    for name, span in ("x", 3.5), ("y", 3.5), ("angle", 3), ("vx", 6), ("vy", 6), ("omega", 6):
        getattr(body, name)[:, bodies] = rng.uniform(-span, span, shape)[:, bodies]
    for name, function in ("cosine", np.cos), ("sine", np.sin):
        getattr(body, name)[:, bodies] = function(body.angle[:, bodies])
    made[Held].fixed[:, made.span("stone")] = rng.random((made.count, 3)) < 0.3
    for name, most in ("friction", 1), ("restitution", 1), ("linear_damping", 9), ("angular_damping", 9):
        values = np.where(rng.random(shape) < 0.3, -1, rng.uniform(0, most, shape))
        getattr(made[Material], name)[:, bodies] = values[:, bodies]
    made[Filter].layer[:, bodies] = 1 << rng.integers(0, 3, shape)[:, bodies]
    made[Filter].hits[:, bodies] = rng.choice([0xFFFF, 1, 3, 0], shape, p=[0.7, 0.1, 0.1, 0.1])[:, bodies]
    made[Filter].sensor[:, bodies] = (rng.random(shape) < 0.1)[:, bodies]


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_backends_agree_in_games_whose_bodies_differ(seed: int) -> None:
    native, portable = worlds(8), worlds(8, "portable")
    for k in range(60):
        if k % 15 == 0:
            stir(native, np.random.default_rng([seed, k]))
            portable.block[:] = native.block
        tick(native)
        tick(portable)
        assert native.block.tobytes() == portable.block.tobytes(), f"tick {k}"


@pytest.mark.parametrize(
    ("layer", "mask", "stops"), [(1, 0xFFFF, True), (2, 0xFFFF, True), (1, 0xFFFE, False), (0, 0xFFFF, False)]
)
def test_a_filter_says_what_a_ball_passes_through(layer: int, mask: int, stops: bool) -> None:
    """A post without a filter is in layer 1 and hits all; a ball in layer 0 touches nothing at all."""
    made = worlds(linear_damping=0.0)
    rows = alone(made, ball=(-2, 0, 4, 0), post=(0, 0))
    made[Filter].layer[0, rows["ball"]], made[Filter].hits[0, rows["ball"]] = layer, mask
    for _ in range(25):
        tick(made)
    assert made[Body].x[0, rows["ball"]] == pytest.approx(-0.9 if stops else -2 + 4 * 25 / 30, abs=0.01)


def test_the_room_holds_what_touches_nothing() -> None:
    made = worlds(linear_damping=0.0)
    rows = alone(made, ball=(-2, 0, 9, 0))
    made[Filter].hits[0, rows["ball"]] = 0
    for _ in range(40):
        tick(made)
    assert made[Body].x[0, rows["ball"]] < 4


def test_a_door_moves_through_walls_and_pushes_balls() -> None:
    made = worlds()
    rows = alone(made, door=(-1, 0, 2, 0), ball=(0, 0))
    for _ in range(30):
        tick(made)
    assert made[Body].x[0, rows["door"]] == pytest.approx(1, abs=1e-5)
    assert made[Body].x[0, rows["ball"]] > 1.4
    for _ in range(60):
        tick(made)
    assert made[Body].x[0, rows["door"]] == pytest.approx(5, abs=1e-5)


def test_a_door_that_turns_strikes_what_is_beside_it() -> None:
    """Its end moves, though its centre does not."""
    made = worlds()
    rows = alone(made, door=(0, 0), ball=(0.6, 0.8))
    made[Body].omega[0, rows["door"]] = -6
    for _ in range(6):
        tick(made)
    assert np.hypot(made[Body].vx[0, rows["ball"]], made[Body].vy[0, rows["ball"]]) > 1


def test_what_is_fixed_stays_and_what_is_freed_can_be_pushed() -> None:
    made = worlds()
    rows = alone(made, stone=(0, 0, 3, 0), ball=(-2, 0, 6, 0))
    made[Held].fixed[0, rows["stone"]] = 1
    for _ in range(20):
        tick(made)
    assert made[Body].x[0, rows["stone"]] == 0
    made[Held].fixed[0, rows["stone"]] = 0
    made[Body].x[0, rows["ball"]], made[Body].vx[0, rows["ball"]] = -2, 6
    for _ in range(20):
        tick(made)
    assert made[Body].x[0, rows["stone"]] > 0.05


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e6])
def test_a_material_that_physics_cannot_take_is_a_fault(value: float) -> None:
    made = worlds()
    rows = alone(made, ball=(0, 0), crate=(0.5, 0))
    made[Material].friction[0, rows["ball"]] = value
    made.run(np.full(1, STEP, np.int8))
    assert made[Fault].physics[0]


@pytest.mark.skipif(not COMPILED, reason="compares with machine code")
def test_games_without_them_have_neither_columns_nor_machine_code_for_them() -> None:
    plain = Worlds((Room(size=8.0), Physics(), Crates()), 1)
    assert not {Filter, Material, Driven} & {*plain.components}
    assert "filter" not in plain.source().split("physics.collide")[1].split("physics.fly")[0].lower()


@dataclass(frozen=True)
class Crates(Module):
    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("crate", (Body(), Push(), *KINDS["crate"][1][:2]), 2)]
