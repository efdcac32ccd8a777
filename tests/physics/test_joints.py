"""Joints: both backends agree to the bit, a weld and a rod hold, a rope gives way inwards, and forces are measured."""

from typing import Any

import numpy as np
import pytest

from outlast.systems.box2d import native, portable
from tests.physics.test_box2d import SETTINGS, backends, boxes, circles, needs_native, random_batch
from tests.physics.test_traits import random_traits

from outlast.systems.box2d.batch import (  # isort: skip
    ABANDONED, ANGLE, AT_X, AT_Y, DYNAMIC, FIRST, FORCE, HERTZ, HIGH, IMPULSE, INVALID, JX, KIND, LOW, MAX_TRAVEL,
    OTHER_X, OWN_X, REST, ROD, ROPE, SECOND, SOLVED, TOUCHES, VX, VY, WELD, X, Y, ContactBatch, JOINTS,
)  # fmt: skip

Matrix = np.ndarray[Any, Any]


def joint(kind: int, first: int, second: int, rest: float = 0, x: float = 0) -> Matrix:
    row = np.zeros((1, JOINTS), np.float32)
    row[0, [KIND, FIRST, SECOND, OWN_X, REST]] = kind, first, second, x, rest
    return row


def random_joints(rng: np.random.Generator, count: int) -> Matrix:
    """Joints of all kinds, also several between two bodies, in circles and between bodies that stand."""
    number = rng.integers(0, 2 * count)
    joints = np.zeros((number, JOINTS), np.float32)
    joints[:, KIND] = rng.choice([WELD, ROD, ROPE], number)
    joints[:, FIRST] = rng.integers(0, count, number)
    joints[:, SECOND] = (joints[:, FIRST] + rng.integers(1, count, number)) % count
    joints[:, OWN_X:REST] = rng.uniform(-1, 1, (number, 4)) * rng.choice([0, 1])
    joints[:, REST] = np.where(joints[:, KIND] == WELD, rng.uniform(-3, 3, number), rng.uniform(0, 3, number))
    joints[:, HERTZ:FORCE] = rng.uniform(0, 1, (number, 2)) * [8, 2] * (rng.random((number, 1)) < 0.4)
    return joints


def solved(backend: Any, memory: Any, batch: ContactBatch, joints: Any, traits: Any = None, touches: Any = None) -> Any:
    batch, joints = batch.copy(), joints.copy()
    return backend.solve(memory, SETTINGS, batch, len(batch), traits, joints, len(joints), touches), batch, joints


@needs_native
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 20))])
def test_backends_agree_about_joints(seed: int) -> None:
    """About 5,000 body-ticks a seed, of all kinds of joints, with and without traits."""
    rng, workspace, results = np.random.default_rng(seed), native.make_workspace(), set()
    for k in range(1000):
        batch = random_batch(rng)
        joints, traits = random_joints(rng, len(batch)), random_traits(rng, batch) if k % 2 else None
        own = solved(native, workspace, batch, joints, traits)
        other = solved(portable, None, batch, joints, traits)
        assert own[0] == other[0]
        assert own[1].tobytes() == other[1].tobytes()
        if own[0] == SOLVED:
            np.testing.assert_array_equal(own[2], other[2])
        results.add(own[0])
        plain = solved(native, workspace, batch, joints[:0]), solved(portable, None, batch, joints[:0])
        assert plain[0][1].tobytes() == plain[1][1].tobytes()  # nothing of the joints is left in the workspace
    assert results == {SOLVED, ABANDONED}


@needs_native
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 6))])
def test_backends_agree_about_touches(seed: int) -> None:
    """Also about impacts, which Box2D solves on its own: some bodies fly as far as three metres in a substep."""
    rng, workspace, pairs, pushed = np.random.default_rng(seed), native.listen(native.make_workspace()), 0, 0
    for k in range(500):
        batch = random_batch(rng)
        batch[:, MAX_TRAVEL] = 100
        joints, traits = random_joints(rng, len(batch))[: k % 2], random_traits(rng, batch) if k % 3 else None
        found, expected = np.zeros((2, 50, TOUCHES), np.float32)
        own = solved(native, workspace, batch, joints, traits, found)
        other = solved(portable, None, batch, joints, traits, expected)
        assert own[1].tobytes() == other[1].tobytes()
        np.testing.assert_array_equal(found, expected)
        pairs, pushed = pairs + int(found[0, LOW]), pushed + int((found[1:, IMPULSE] > 0).sum())
        untouched = solved(native, workspace, batch, joints, traits)
        assert untouched[1].tobytes() == own[1].tobytes()
    assert pairs > pushed > 500


@backends
@pytest.mark.parametrize("speed", [3.0, 110.0])
def test_a_touch_tells_where_and_how_hard(backend: Any, speed: float) -> None:
    """A disc against a wall, so fast that it would be through in a substep, or not."""
    batch, touches = np.concatenate([circles((0, 0)), boxes((1.0, 0, 0.4, 3))]), np.zeros((4, TOUCHES), np.float32)
    batch[0, X], batch[0, VX] = 0.6 - 0.5 - speed / 120, speed
    memory = backend.listen(backend.make_workspace())
    result, after, _ = solved(backend, memory, batch, np.zeros((0, JOINTS), np.float32), None, touches)
    assert result == SOLVED
    assert touches[0, LOW] == 1
    assert touches[1, [LOW, HIGH]].tolist() == [0, 1]
    assert touches[1, IMPULSE] == pytest.approx(np.pi / 4 * speed, rel=0.05)
    assert touches[1, [AT_X, AT_Y]] == pytest.approx([0.6, 0], abs=0.02)
    assert abs(after[0, VX]) < 0.1


@backends
def test_a_weld_moves_two_bodies_as_one(backend: Any) -> None:
    batch, joints = circles((0, 0), (0.9, 0)), joint(WELD, 0, 1, x=0.9)
    batch[0, VY] = 3
    memory = backend.make_workspace()
    for _ in range(30):
        result, batch, joints = solved(backend, memory, batch, joints)
        assert result == SOLVED
    apart = batch[1, X : Y + 1] - batch[0, X : Y + 1]
    assert np.hypot(*apart) == pytest.approx(0.9, abs=1e-3)
    assert batch[1, ANGLE] == pytest.approx(batch[0, ANGLE], abs=1e-3)
    assert np.arctan2(apart[1], apart[0]) == pytest.approx(batch[0, ANGLE], abs=0.01)
    assert batch[0, ANGLE] < -0.5


@backends
@pytest.mark.parametrize(("kind", "speed", "limit"), [(ROD, 5, 2), (ROD, -5, 2), (ROPE, 5, 2), (ROPE, -5, None)])
def test_a_rod_keeps_a_length_and_a_rope_at_most_a_length(
    backend: Any, kind: int, speed: float, limit: float | None
) -> None:
    batch, joints = circles((0, 0), (2, 0)), joint(kind, 0, 1, rest=2)
    batch[1, VX] = speed
    after = solved(backend, backend.make_workspace(), batch, joints)[1]
    length = after[1, X] - after[0, X]
    assert length < 1.9 if limit is None else length == pytest.approx(limit, abs=0.02)


@backends
def test_the_force_on_a_joint_is_what_pulls_at_it(backend: Any) -> None:
    """A pull of 0.05 newton-seconds in each of 60 substeps a second, at a body that hangs on one that stands."""
    batch, joints = circles((0, 0), (2, 0)), joint(ROPE, 0, 1, rest=2)
    batch[0, DYNAMIC], batch[1, JX] = 0, 0.05
    found = solved(backend, backend.make_workspace(), batch, joints)[2]
    assert found[0, FORCE] == pytest.approx(0.05 * 60, rel=0.05)


@backends
@pytest.mark.parametrize(("column", "value"), [
    (SECOND, 0), (SECOND, 2), (FIRST, -1), (OTHER_X, np.nan), (REST, -1), (HERTZ, -1), (HERTZ, np.inf),
])  # fmt: skip
def test_joints_that_box2d_would_reject_are_invalid(backend: Any, column: int, value: float) -> None:
    batch, joints = circles((0, 0), (0.9, 0)), joint(ROPE, 0, 1, rest=2)
    joints[0, column] = value
    result, after, _ = solved(backend, backend.make_workspace(), batch, joints)
    assert result == INVALID
    assert after.tobytes() == batch.tobytes()
