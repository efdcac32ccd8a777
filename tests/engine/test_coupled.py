"""Columns that have to fit each other are written together."""

from typing import Any

import numpy as np
import pytest

from outlast.components import Bag, Body, Phase, Shape, Solid
from outlast.components.body import face
from outlast.ecs import Archetype, Array, Component, Coupled, DeclarationError, Rows, Write, column
from tests.helpers.mechanics import duel, idle, kind, written

ANGLE = 0.7
ORDERS: dict[Any, dict[str, Any]] = {
    Phase.SPAWN: {"before": (Shape, Solid), "after": Body},
    Phase.GIVE: {"after": Bag},
    Phase.MOVE: {"after": ("room", Body)},
}


class Door(Component):
    """A marker."""


def turn_all(body: Write[Body], doors: Rows[Door]) -> None:
    for e in doors:
        face(body, e, body.angle[e] + np.float32(0.1))


def setting(line: str) -> Any:
    """A system that runs a line for doors."""
    table = line.partition(".")[0]
    head = f"def act({table}: Write[{table.title()}], doors: Rows[Door]) -> None:"
    return written(f"{head}\n    for e in doors:\n        {line}\n", globals())


def played(function: Any, phase: Any, **order: Any) -> Any:
    """A game with a turned door, after its reset and a step."""
    solid = Body(x=2.0, angle=ANGLE), Shape(half_width=1.0, half_height=0.1), Solid(), Bag(), Door()
    doors = kind("Doors", archetypes=[Archetype("door", solid, 1)])
    doors.system(phase, **(order or ORDERS[phase]))(function)
    env = duel(doors())
    env.step(idle(env))
    return env


TURN = "body.angle[e] += np.float32(0.1)"
GROW, LIGHTEN = "shape.half_width[e] += np.float32(0.1)", "solid.density[e] = np.float32(0.5)"


@pytest.mark.parametrize(
    ("line", "phase", "words"),
    [
        (TURN, Phase.MOVE, "Body.angle, but not cosine and sine, .*: turn a body by face"),
        (TURN, Phase.SPAWN, "Body.angle, but not cosine and sine"),
        ("body.sine[e] = -body.sine[e]", Phase.MOVE, "Body.sine, but not angle and cosine"),
        (GROW, Phase.MOVE, "Shape.half_width, but not bound, .* its distance to walls$"),
        (LIGHTEN, Phase.MOVE, "Solid.density, but not mass and inertia, .*: by itself, it changes nothing$"),
        ("bag.count[e] = 0", Phase.GIVE, "Bag.count, but not items, .*: put items in and take them out by push"),
    ],
)
def test_a_column_that_is_written_without_what_must_fit_it_is_refused(line: str, phase: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=rf"^doors.act writes {words}"):
        played(setting(line), phase)


def test_mechanics_compute_bounds_and_masses_behind_a_system_of_a_reset() -> None:
    env = played(setting(GROW), Phase.SPAWN)
    door = env.worlds.span("door").start
    assert env.worlds[Shape].bound[0, door] == pytest.approx(np.hypot(1.1, 0.1))
    mass = played(setting(LIGHTEN), Phase.SPAWN).worlds[Solid].mass[0, door]
    assert mass == pytest.approx(2 * 0.2 * 0.5)
    words = r"^doors.act writes Shape.half_width, but not bound, .*; or run before room.compute_bounds, which computes"
    with pytest.raises(DeclarationError, match=words):
        played(setting(GROW), Phase.SPAWN, after=("room.compute_bounds", Body))


@pytest.mark.parametrize("phase", [Phase.MOVE, Phase.SPAWN])
def test_a_body_faces_its_angle(phase: Any) -> None:
    env = played(turn_all, phase)
    entity = env.worlds.entity(env.worlds.span("door").start)
    assert entity.Body.angle == pytest.approx(ANGLE + 0.1)
    assert entity.Body[3:5] == pytest.approx((np.cos(ANGLE + 0.1), np.sin(ANGLE + 0.1)))
    assert [*Body(angle=[0.0, ANGLE]).fills["sine"]] == pytest.approx([0, np.sin(ANGLE)])


def test_declarations_that_mean_nothing() -> None:
    with pytest.raises(DeclarationError, match=r"^Body\(sine=...\): it follows from the angle; give that"):
        Body(sine=1)
    with pytest.raises(DeclarationError, match=r"^Lamp.coupled: unknown column 'bright'; known: light"):

        class Lamp(Component):
            coupled = (Coupled(("light",), ("bright",), "write both"),)
            light: Array = column("f4")
