"""Columns that have to fit each other are written together."""

from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Phase, Shape, Solid
from outlast.components.body import face
from outlast.ecs import Archetype, Array, Component, Coupled, DeclarationError, Module, Rows, Write, column

ANGLE = 0.7
ORDERS: dict[Any, dict[str, Any]] = {
    Phase.SPAWN: {"before": (Shape, Solid), "after": Body},
    Phase.GIVE: {"after": Bag},
    Phase.MOVE: {"after": ("room", Body)},
}


class Door(Component):
    """A marker."""


def turn(body: Write[Body], doors: Rows[Door]) -> None:
    for e in doors:
        body.angle[e] += np.float32(0.1)


def mirror(body: Write[Body], doors: Rows[Door]) -> None:
    for e in doors:
        body.sine[e] = -body.sine[e]


def grow(shape: Write[Shape], doors: Rows[Door]) -> None:
    for e in doors:
        shape.half_width[e] += np.float32(0.1)


def lighten(solid: Write[Solid], doors: Rows[Door]) -> None:
    for e in doors:
        solid.density[e] = np.float32(0.5)


def empty(bag: Write[Bag], doors: Rows[Door]) -> None:
    for e in doors:
        bag.count[e] = 0


def turn_all(body: Write[Body], doors: Rows[Door]) -> None:
    for e in doors:
        face(body, e, body.angle[e] + np.float32(0.1))


def played(function: Any, phase: Any, **order: Any) -> Any:
    """A game with a turned door, after its reset and a step."""

    class Doors(Module):
        def archetypes(self) -> Any:
            solid = Body(x=2.0, angle=ANGLE), Shape(half_width=1.0, half_height=0.1), Solid(), Bag(), Door()
            return [Archetype("door", solid, 1)]

    Doors.system(phase, **(order or ORDERS[phase]))(function)
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Doors()), 1, seed=0)
    env.reset()
    env.step(np.tile(env.noop, (1, env.num_agents, 1)))
    return env


@pytest.mark.parametrize(
    ("function", "phase", "words"),
    [
        (turn, Phase.MOVE, "Body.angle, but not cosine and sine, which must fit it: turn a body by face"),
        (turn, Phase.SPAWN, "Body.angle, but not cosine and sine"),
        (mirror, Phase.MOVE, "Body.sine, but not angle and cosine"),
        (grow, Phase.MOVE, "Shape.half_width, but not bound, .* how close to walls it may stand$"),
        (lighten, Phase.MOVE, "Solid.density, but not mass and inertia, .*: by itself, it changes nothing$"),
        (empty, Phase.GIVE, "Bag.count, but not items, .*: put items in and take them out by push and pop"),
    ],
)
def test_a_column_that_is_written_without_what_must_fit_it_is_refused(function: Any, phase: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=rf"^doors.{function.__name__} writes {words}"):
        played(function, phase)


def test_the_system_that_computes_what_must_fit_comes_later() -> None:
    words = r"^doors.grow writes Shape.half_width, but not bound, .*; or run before room.compute_bounds, which computes"
    with pytest.raises(DeclarationError, match=words):
        played(grow, Phase.SPAWN, after=("room.compute_bounds", Body))


def test_mechanics_compute_bounds_and_masses_behind_a_system_of_a_reset() -> None:
    env = played(grow, Phase.SPAWN)
    door = env.worlds.span("door").start
    assert env.worlds[Shape].bound[0, door] == pytest.approx(np.hypot(1.1, 0.1))
    assert played(lighten, Phase.SPAWN).worlds[Solid].mass[0, door] == pytest.approx(2 * 0.2 * 0.5)


@pytest.mark.parametrize("phase", [Phase.MOVE, Phase.SPAWN])
def test_a_body_faces_its_angle(phase: Any) -> None:
    """A prefab's cosine and sine follow, too."""
    env = played(turn_all, phase)
    entity = env.worlds.entity(env.worlds.span("door").start)
    assert entity.Body.angle == pytest.approx(ANGLE + 0.1)
    assert entity.Body[3:5] == pytest.approx((np.cos(ANGLE + 0.1), np.sin(ANGLE + 0.1)))
    assert [*Body(angle=[0.0, ANGLE]).fills["sine"]] == pytest.approx([0, np.sin(ANGLE)])


def test_declarations_that_mean_nothing() -> None:
    with pytest.raises(DeclarationError, match=r"^Body\(sine=...\): it follows from the angle; give that"):
        Body(sine=1)
    with pytest.raises(DeclarationError, match=r"^Lamp.coupled: there is no column 'bright'; known: light"):

        class Lamp(Component):
            coupled = (Coupled(("light",), ("bright",), "write both"),)
            light: Array = column("f4")
