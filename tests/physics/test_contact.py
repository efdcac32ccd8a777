"""Games with filters, materials, joints and bodies that are driven."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from outlast.components import (
    Body,
    Driven,
    Fault,
    Filter,
    Material,
    Phase,
    Polygon,
    Push,
    Rope,
    RopeBroken,
    Shape,
    Solid,
    Touch,
    Touching,
    Weld,
    WeldBroken,
)  # fmt: skip
from outlast.components.contact import fix, free
from outlast.components.joint import hold, let_go, tie
from outlast.ecs import (
    RESET,
    STEP,
    Archetype,
    Array,
    CapacityError,
    Component,
    Entity,
    Module,
    Read,
    Rows,
    Singleton,
    Worlds,
    Write,
    column,
)
from outlast.systems import Contacts, Physics, Room
from tests.conftest import COMPILED
from tests.helpers.mechanics import mechanic

GHOST = Archetype("ghost", (Body(), Shape(radius=0.3)), 1)
WEDGES = [
    [(0, 0), (1.2, 0), (0, 0.6)],
    [(-0.5, -0.2), (0.5, -0.2), (0.3, 0.3), (-0.4, 0.3)],
    [(0.6 * math.cos(k), 0.4 * math.sin(k)) for k in range(6)],
    [(0.5 * math.cos(k * math.pi / 4), 0.5 * math.sin(k * math.pi / 4)) for k in range(8)],
]
KINDS: dict[str, tuple[int, tuple[Component, ...]]] = {
    "ball": (5, (Shape(radius=0.4), Solid(dynamic=1), Filter(), Material(), Weld())),
    "crate": (4, (Shape(half_width=0.6, half_height=0.3), Solid(dynamic=1), Filter(), Rope())),
    "stone": (3, (Shape(half_width=0.5, half_height=0.5), Solid(dynamic=1), Material())),
    "post": (2, (Shape(radius=0.5), Solid())),
    "spike": (1, (Polygon([(0, 0.7), (-0.4, -0.3), (0.4, -0.3)]), Solid())),
    "wedge": (4, (Polygon(WEDGES), Solid(dynamic=1), Filter(), Material())),
    "gate": (1, (Polygon(WEDGES[2]), Solid(), Driven())),
    "door": (2, (Shape(half_width=0.1, half_height=1.0), Solid(), Driven(), Filter())),
}


class Held(Component):
    """Whether a stone is to be static."""

    fixed: Array = column("u1", high=1)


class Wish(Component):
    """What a ball is to hold, and a crate to be tied to, from now on."""

    other: Array = column("i4", fill=-1, unit="entity")  # -1: as before; itself: nothing any more


@dataclass(frozen=True)
class Zoo(Module):
    def archetypes(self) -> Iterable[Archetype]:
        kinds = [Archetype(name, (Body(), Push(), *parts), count) for name, (count, parts) in KINDS.items()]
        own = {"stone": Held(), "wedge": Held(), "ball": Wish(), "crate": Wish()}
        return [*kinds, GHOST, *(Archetype(name, (each,)) for name, each in own.items())]

    def singletons(self) -> Iterable[Singleton]:
        return [WeldBroken(), RopeBroken()]


@Zoo.system(Phase.DRIVE)
def stand(solid: Write[Solid], body: Write[Body], held: Write[Held], stones: Rows[Held]) -> None:
    for e in stones:
        if held.fixed[e]:
            fix(solid, body, e)
        else:
            free(solid, e)


@Zoo.system(Phase.DRIVE, after="zoo.stand")
def grip(
    welds: Write[Weld],
    ropes: Write[Rope],
    wish: Write[Wish],
    body: Read[Body],
    balls: Rows[Weld, Wish],
    crates: Rows[Rope, Wish],
) -> None:
    for e in balls:
        if wish.other[e] == e:
            let_go(welds, e)
        elif wish.other[e] >= 0:
            hold(welds, body, e, wish.other[e])
        wish.other[e] = -1
    for e in crates:
        if wish.other[e] == e:
            let_go(ropes, e)
        elif wish.other[e] >= 0:
            tie(ropes, body, e, wish.other[e])
        wish.other[e] = -1


def worlds(count: int = 1, size: float = 8.0, **numbers: Any) -> Worlds:
    made = Worlds((Room(size=size), Physics(**numbers), Contacts(), Zoo()), count)
    made.run(np.full(count, RESET, np.int8))
    return made


def bodies_of(made: Worlds) -> slice:
    """Return all rows but those of the walls, which come first."""
    return slice(made.span("ball").start, made.span("wedge").stop)


def tick(made: Worlds) -> None:
    """Step, and check that Touching has the pairs of Touch, and that those began that it had not had."""
    known = pairs(made[Touching])
    made.run(np.full(made.count, STEP, np.int8))
    assert not made[Fault].physics.any()
    assert pairs(made[Touching]) == pairs(made[Touch])
    for w, here in enumerate(pairs(made[Touch])):
        assert made[Touch].began[w, : len(here)].tolist() == [pair not in known[w] for pair in here]
        assert not made[Touching].solid[w, len(here) :].any() | made[Touching].other[w, len(here) :].any()


def pairs(table: Any) -> list[list[tuple[int, int]]]:
    columns = zip(table.solid.tolist(), table.other.tolist(), table.count.ravel().tolist(), strict=True)
    return [[*zip(solid[:count], other[:count], strict=True)] for solid, other, count in columns]


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
    for kind in "stone", "wedge":
        made[Held].fixed[:, made.span(kind)] = (rng.random(shape) < 0.3)[:, made.span(kind)]
    for name, most in ("friction", 1), ("restitution", 1), ("linear_damping", 9), ("angular_damping", 9):
        values = np.where(rng.random(shape) < 0.3, -1, rng.uniform(0, most, shape))
        getattr(made[Material], name)[:, bodies] = values[:, bodies]
    made[Filter].layer[:, bodies] = 1 << rng.integers(0, 3, shape)[:, bodies]
    made[Filter].hits[:, bodies] = rng.choice([0xFFFF, 1, 3, 0], shape, p=[0.7, 0.1, 0.1, 0.1])[:, bodies]
    made[Filter].sensor[:, bodies] = (rng.random(shape) < 0.1)[:, bodies]
    for joints in made[Weld], made[Rope]:
        for name, most in ("hertz", 8), ("damping", 2), ("breaks_at", 400):
            getattr(joints, name)[:] = rng.uniform(0, most, shape) * (rng.random(shape) < 0.5)
    made[Rope].rod[:] = rng.random(shape) < 0.5
    some = rng.integers(0, bodies.stop, shape)  # walls, too
    made[Wish].other[:] = np.where(rng.random(shape) < 0.5, some, -1)


def touched(made: Worlds) -> list[tuple[float, ...]]:
    """The touches of the last tick in all worlds: rows, place, impulse and whether it began."""
    table, found = made[Touch], list[tuple[float, ...]]()
    for w in range(made.count):
        count = table.count[w].item()
        columns = (table.solid, table.other, table.x, table.y, table.impulse, table.began)
        found += zip(*(column[w, :count].tolist() for column in columns), strict=True)
    return found


def test_a_crate_that_four_hold_stays_within_a_centimetre() -> None:
    """Each pulls its own way, with 60 newtons, which give it alone 120 m/s²."""
    made = worlds(size=200.0)
    alone(made, stone=(0, 0))
    body, stone, balls = made[Body], made.span("stone").start, made.span("ball").start + np.arange(4)
    made[Entity].alive[0, balls], made[Wish].other[0, balls] = 1, stone
    body.x[0, balls], body.y[0, balls] = [1, 0, -1, 0], [0, 1, 0, -1]
    rng = np.random.default_rng(1)
    for k in range(120):
        if k % 10 == 0:
            ways = rng.uniform(0, 2 * np.pi, 4)
            made[Push].x[0, balls], made[Push].y[0, balls] = 2 * np.cos(ways), 2 * np.sin(ways)
        tick(made)
        for e in balls:
            x, y, c, s = (float(v[0, e]) for v in (made[Weld].x, made[Weld].y, body.cosine, body.sine))
            grip = body.x[0, e] + c * x - s * y, body.y[0, e] + s * x + c * y
            assert math.dist(grip, (body.x[0, stone], body.y[0, stone])) < 0.01
    assert (made[Weld].force[0, balls] > 1).all()


def test_a_rope_holds_up_to_its_strength_and_then_breaks() -> None:
    made = worlds(linear_damping=0.0)
    rows = alone(made, crate=(2, 0), post=(0, 0))
    made[Wish].other[0, rows["crate"]], made[Rope].breaks_at[0, rows["crate"]] = rows["post"], 100
    made[Push].x[0, rows["crate"]] = 90 / 30
    for _ in range(20):
        tick(made)
        assert made[RopeBroken].count[0] == 0
    assert made[Body].x[0, rows["crate"]] == pytest.approx(2, abs=0.01)
    assert made[Rope].force[0, rows["crate"]] == pytest.approx(90, rel=0.01)
    made[Push].x[0, rows["crate"]] = 110 / 30
    tick(made)
    broken = made[RopeBroken]
    assert broken.count[0] == 1
    assert (broken.solid[0, 0], broken.other[0, 0]) == (rows["crate"], rows["post"])
    assert broken.force[0, 0] == pytest.approx(110, rel=0.01)
    tick(made)
    assert made[RopeBroken].count[0] == 0
    assert made[Rope].other[0, rows["crate"]] == -1
    assert made[Body].vx[0, rows["crate"]] > 0.5


@pytest.mark.parametrize("what", ["itself", "the dead", "no solid", "its holder is dead"])
def test_an_impossible_joint_ends(what: str) -> None:
    made = worlds()
    rows = alone(made, ball=(-2, 0), crate=(0, 0))
    ball, crate = rows["ball"], rows["crate"]
    other = {"itself": ball, "the dead": crate + 1, "no solid": made.span("ghost").start}.get(what, crate)
    made[Weld].other[0, ball] = other
    made[Entity].alive[0, ball] = what != "its holder is dead"
    before = made[Body].x[0, [ball, crate]].tolist()
    tick(made)
    assert made[Weld].other[0, ball] == -1
    assert made[Body].x[0, [ball, crate]].tolist() == before
    assert made[WeldBroken].count[0] == 0


def test_an_angle_that_loses_whole_turns_tears_no_weld() -> None:
    made = worlds(angular_damping=0.0, linear_damping=0.0)
    rows = alone(made, ball=(0, 0), crate=(1.2, 0))
    made[Wish].other[0, rows["ball"]] = rows["crate"]
    tick(made)
    made[Body].angle[0, rows["crate"]] += 40 * np.pi
    for _ in range(5):
        tick(made)
    assert abs(made[Body].omega[0, rows["ball"]]) < 0.01


@pytest.mark.parametrize(
    ("place", "speed", "turn", "met"),
    [((1.2, 0), 30, 0, True), ((1.6, 0), 30, 0, False), ((-0.8, 0.8), 0, 15, True), ((-1.2, 0.8), 0, 15, False)],
)
def test_a_driven_door_pushes_what_rests_in_its_way(place: Any, speed: float, turn: float, met: bool) -> None:
    """Only these two go to Box2D, not the walls of the room, which touch each other."""
    made = worlds()
    rows = alone(made, ball=place, door=(0, 0, speed, 0))
    made[Body].omega[0, rows["door"]] = turn
    tick(made)
    assert np.flatnonzero(made[Solid].may_collide[0]).tolist() == sorted(rows.values()) * met
    assert (made[Body].vx[0, rows["ball"]] != 0) == met


def test_touches_begin_and_go_on() -> None:
    made = worlds(linear_damping=0.0)
    rows = alone(made, ball=(-2, 1, 4, 0), post=(0, 1))
    made[Push].x[0, rows["ball"]] = 1
    seen = []
    for _ in range(25):
        tick(made)
        seen.append(touched(made))
    first = next(k for k, each in enumerate(seen) if each)
    assert all(not each for each in seen[:first])
    assert all(len(each) == 1 and each[0][:2] == (rows["ball"], rows["post"]) for each in seen[first:])
    assert [each[0][5] for each in seen[first:]] == [1] + [0] * (24 - first)
    mass = made[Solid].mass[0, rows["ball"]]
    assert seen[first][0][4] > 4 * mass
    assert seen[-1][0][4] == pytest.approx(1, rel=0.01)  # what it is pushed with
    assert seen[-1][0][2:4] == pytest.approx((-0.5, 1), abs=0.02)
    made[Entity].alive[0, rows["ball"]] = 0
    tick(made)
    assert touched(made) == []


def test_a_sensor_tells_what_overlaps_it_and_stops_nothing() -> None:
    made = worlds(linear_damping=0.0)
    rows = alone(made, ball=(-2, 0, 4, 0), crate=(0, 0))
    made[Filter].sensor[0, rows["crate"]] = 1
    seen = []
    for _ in range(30):
        tick(made)
        seen.append(bool(touched(made)))
    assert made[Body].x[0, rows["ball"]] == pytest.approx(2, abs=1e-4)
    assert 14 <= sum(seen) <= 17  # 2 m at 4 m/s are 15 ticks
    assert sorted(seen[seen.index(True) :], reverse=True) == seen[seen.index(True) :]


def test_more_touches_than_there_is_room_for_are_an_error() -> None:
    made = Worlds((Room(size=8.0), Physics(), Contacts(most=1), Zoo()), 1)
    made.run(np.full(1, RESET, np.int8))
    rows = alone(made, ball=(0, 0), crate=(0.5, 0), stone=(-0.5, 0))
    assert len(rows) == 3
    with pytest.raises(CapacityError, match="touch"):
        tick(made)


@pytest.mark.parametrize(
    ("table", "column", "value"),
    [(Weld, "x", np.nan), (Weld, "angle", np.nan), (Weld, "hertz", np.nan), (Material, "friction", np.inf),
     (Material, "friction", 1e6)],
)  # fmt: skip
def test_what_physics_cannot_take_is_a_fault(table: Any, column: str, value: float) -> None:
    made = worlds()
    rows = alone(made, ball=(0, 0), crate=(0.5, 0))
    made[Weld].other[0, rows["ball"]] = rows["crate"]
    getattr(made[table], column)[0, rows["ball"]] = value
    made.run(np.full(1, STEP, np.int8))
    assert made[Fault].physics[0]


@pytest.mark.skipif(not COMPILED, reason="compares with machine code")
def test_games_without_them_have_neither_columns_nor_machine_code_for_them() -> None:
    crates = mechanic("Crates", archetypes=[Archetype("crate", (Body(), Push(), *KINDS["crate"][1][:2]), 2)])
    plain = Worlds((Room(size=8.0), Physics(), crates), 1)
    assert not {Filter, Material, Driven, Weld, Rope, Touch, Touching, Polygon} & {*plain.components}
    source = plain.source().lower()
    assert not [
        name
        for name in ("filter", "material", "driven", "weld", "rope", "touch", "polygon")
        if f"view_{name}" in source
    ]
