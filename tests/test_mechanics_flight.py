"""Bodies that touch nothing, the limits of what physics takes, and the numbers that it hands to Box2D."""

import math
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pytest

import outlast
from outlast.components import Body
from outlast.ecs import NumberError
from outlast.envs.errors import FaultError
from outlast.systems import Contacts, physics
from outlast.systems.box2d import portable, scene
from tests.stage import Stage

F4 = np.float32


class Flying(NamedTuple):
    """The columns of components.Body that a flight changes, of one body."""

    x: np.ndarray
    y: np.ndarray
    angle: np.ndarray
    vx: np.ndarray
    vy: np.ndarray
    omega: np.ndarray


class Pushed(NamedTuple):
    inverse_mass: np.ndarray
    inverse_inertia: np.ndarray
    x: np.ndarray
    y: np.ndarray
    turn: np.ndarray


@pytest.mark.parametrize("speed", [0.0, 1.0, 60.0, 300.0])  # the last one is beyond 2 m and a quarter turn a substep
def test_what_touches_nothing_flies_as_in_box2d(speed: float) -> None:
    rng, settings, radius = np.random.default_rng(1), scene.Settings(), 0.5
    mass = math.pi * radius**2
    for _ in range(10):
        row = np.zeros((1, scene.COLUMNS), F4)
        row[0, : scene.RADIUS] = rng.normal(0, 1, 6) * [5, 5, 3, speed, speed, speed]
        row[0, [scene.RADIUS, scene.DYNAMIC, scene.REACH]] = radius, 1, 1e5
        row[0, scene.JX :] = rng.normal(0, 0.3, 3)
        body = Flying(*(np.array([value]) for value in row[0, : scene.RADIUS]))
        shares = (np.array([settings.substeps * value], F4) for value in row[0, scene.JX :])
        push = Pushed(np.array([1 / mass], F4), np.array([2 / (mass * radius**2)], F4), *shares)
        slow, calm = (F4(1 - settings.dt * d) for d in (settings.linear_damping, settings.angular_damping))
        for _ in range(settings.substeps):
            physics.integrate(body, push, 0, settings.dt, slow, calm, F4(settings.substeps))
        assert portable.solve(None, settings, row, 1) == scene.SOLVED
        assert [float(column[0]) for column in body] == pytest.approx(row[0, : scene.RADIUS].tolist(), rel=1e-5)


@pytest.mark.parametrize("column", ["x", "y", "vx", "vy", "omega"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_a_fault(column: str, value: float) -> None:
    """Of a body that is alone in the world, so that Box2D never gets to see it."""
    alone = Stage("ffa_1", n_agents=1, n_heals=1, room_walls=False)
    getattr(alone.column(Body), column)[0, 0] = value
    with pytest.raises(FaultError, match="world 0"):
        alone.step()


@pytest.mark.parametrize("column", ["x", "y"])
@pytest.mark.parametrize("sign", [1, -1])
def test_what_is_a_million_metres_away_is_a_fault(column: str, sign: int) -> None:
    alone = Stage("ffa_1", n_agents=1, n_heals=1, room_walls=False)
    alone.put("agent", 0, 0, 0)
    getattr(alone.column(Body), column)[0, 0] = sign * 0.999e6
    alone.step()
    getattr(alone.column(Body), column)[0, 0] = sign * 1e6
    with pytest.raises(FaultError, match="world 0"):
        alone.step()


def test_physics_takes_as_many_bodies_as_a_scene_holds() -> None:
    """Agents and four walls."""
    most = scene.CAPACITY - 4
    crowd = outlast.variant("ffa_1").replace(n_heals=1, spawn_cells=23)
    outlast.make_vec(crowd.replace(n_agents=most), 1).close()
    with pytest.raises(NumberError, match=f"{scene.CAPACITY + 1} bodies"):
        outlast.make_vec(crowd.replace(n_agents=most + 1), 1)


def test_a_scene_is_stepped_by_the_numbers_of_contacts() -> None:
    """If nobody says otherwise; Box2D's own limits are those of its header."""
    numbers: dict[str, Any] = asdict(Contacts())
    expected = {"dt": F4(1 / numbers.pop("rate")), "continuous": int(numbers.pop("continuous"))}
    del numbers["bridge"]
    expected |= {name: F4(value) if isinstance(value, float) else value for name, value in numbers.items()}
    assert scene.Settings()._asdict() == expected
    assert float(physics.MOST) == pytest.approx(math.pi / 2)
    assert scene.LONGEST == 2
