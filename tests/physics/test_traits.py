"""Bodies that differ, filters, sensors and bodies that are driven: both backends agree to the bit, and with sense."""

from typing import Any

import numpy as np
import pytest

from outlast.systems.box2d import native, portable
from tests.physics.test_box2d import (
    SETTINGS,
    backends,
    boxes,
    circles,
    needs_native,
    random_batch,
)

from outlast.systems.box2d.batch import (  # isort: skip
    ABANDONED, DRIVEN, DYNAMIC, HITS, INVALID, LAYER, LINEAR_DAMPING, MAX_TRAVEL, OMEGA, RESTITUTION, SENSOR, SOLVED,
    TRAITS, VX, X, ContactBatch,
)  # fmt: skip

ALL = 0xFFFF


def usual(count: int) -> np.ndarray[Any, Any]:
    return np.tile(portable._usual(SETTINGS), (count, 1))


def random_traits(rng: np.random.Generator, batch: ContactBatch) -> np.ndarray[Any, Any]:
    """Random numbers of all bodies, in a batch in which some of those that stand become driven ones."""
    count = len(batch)
    traits = np.zeros((count, TRAITS), np.float32)
    traits[:, :LAYER] = rng.uniform(0, 1, (count, LAYER)) * [1.5, 1.2, 20, 60]
    traits[:, LAYER] = 1 << rng.integers(0, 3, count)
    traits[:, HITS] = rng.choice([ALL, 1, 6, 0], count, p=[0.6, 0.15, 0.2, 0.05])
    traits[:, SENSOR] = rng.random(count) < 0.15
    driven = (batch[:, DYNAMIC] == 0) & (rng.random(count) < 0.5)
    batch[driven, DYNAMIC] = DRIVEN
    batch[driven, VX : OMEGA + 1] = rng.normal(0, rng.choice([0.5, 5, 100]), (driven.sum(), 3))
    return traits


def solved(backend: Any, memory: Any, batch: ContactBatch, traits: Any) -> tuple[int, ContactBatch]:
    batch = batch.copy()
    return backend.solve(memory, SETTINGS, batch, len(batch), traits), batch


@needs_native
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 8))])
def test_backends_agree_about_bodies_that_differ(seed: int) -> None:
    rng, workspace, results = np.random.default_rng(seed), native.make_workspace(), set()
    for _ in range(1000):
        batch = random_batch(rng)
        traits = random_traits(rng, batch)
        own, other = solved(native, workspace, batch, traits), solved(portable, None, batch, traits)
        assert own[0] == other[0]
        assert own[1].tobytes() == other[1].tobytes()
        results.add(own[0])
        plain = solved(native, workspace, batch, None), solved(portable, None, batch, None)
        assert plain[0][1].tobytes() == plain[1][1].tobytes()  # nothing of the traits is left in the workspace
    assert results == {SOLVED, ABANDONED}


@backends
@pytest.mark.parametrize(
    ("one", "two", "touch"),
    [((1, ALL), (2, ALL), True), ((1, 1), (2, ALL), False), ((1, 2), (2, 1), True), ((1, 2), (2, 2), False),
     ((0, ALL), (1, ALL), False), ((1, 0), (1, ALL), False)],
)  # fmt: skip
def test_two_touch_if_each_hits_the_layer_of_the_other(backend: Any, one: Any, two: Any, touch: bool) -> None:
    batch, traits = circles((0, 0), (0.9, 0)), usual(2)
    traits[0, [LAYER, HITS]], traits[1, [LAYER, HITS]] = one, two
    after = solved(backend, backend.make_workspace(), batch, traits)[1]
    assert bool(after[1, X] > batch[1, X]) == touch


@backends
def test_a_sensor_pushes_nothing(backend: Any) -> None:
    batch, traits = circles((0, 0), (0.9, 0)), usual(2)
    traits[1, SENSOR] = 1
    np.testing.assert_array_equal(solved(backend, backend.make_workspace(), batch, traits)[1], batch)


@backends
def test_a_driven_body_pushes_and_is_not_pushed(backend: Any) -> None:
    batch = np.concatenate([boxes((0, 0, 0.5, 0.5)), circles((1.01, 0))])
    batch[0, DYNAMIC], batch[0, VX], batch[:, MAX_TRAVEL] = DRIVEN, 3, 10
    result, after = solved(backend, backend.make_workspace(), batch, None)
    assert (result, after[0, VX]) == (SOLVED, 3)
    assert after[0, X] == pytest.approx(0.1)
    assert after[1, X] > 1.05


@backends
def test_each_has_its_own_damping_and_bounces_on_its_own(backend: Any) -> None:
    batch, traits = circles((0, 0), (10, 0), (20.95, 0)), usual(3)
    batch[:2, VX], batch[2, VX] = 3, 3
    batch = np.concatenate([batch, boxes((22, 0, 0.5, 3))])
    traits = usual(4)
    traits[1, LINEAR_DAMPING], traits[2, RESTITUTION] = 0, 1
    after = solved(backend, backend.make_workspace(), batch, traits)[1]
    assert after[0, VX] < after[1, VX] == 3
    assert after[2, VX] < -2.9


@backends
@pytest.mark.parametrize(
    ("column", "value"), [(LINEAR_DAMPING, np.nan), (RESTITUTION, np.inf), (LAYER, -1), (HITS, 1 << 17)]
)
def test_traits_that_box2d_would_reject_are_invalid(backend: Any, column: int, value: float) -> None:
    batch, traits = circles((0, 0), (0.9, 0)), usual(2)
    traits[1, column] = value
    assert solved(backend, backend.make_workspace(), batch, traits)[0] == INVALID
