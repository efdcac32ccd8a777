"""The two Box2D backends: equal bit for bit, free of history, close to a world that is never taken apart."""

import gc
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from outlast.components import Polygon
from outlast.ecs.kernels.jit import compiled
from outlast.systems.box2d import native, portable
from outlast.systems.box2d import workspace as box2d_workspace
from tests.helpers.contact_batches import (
    SETTINGS,
    become,
    boxes,
    circles,
    random_batch,
    random_joints,
    random_outlines,
    random_traits,
    rope,
    solved,
    usual_traits,
)

from outlast.systems.box2d.batch import (  # isort: skip
    ABANDONED, ANGLE, CORNER, CORNERS, FIRST, HALF_HEIGHT, HALF_WIDTH, HERTZ, HITS, IMPULSE, INERTIA, INVALID, JTURN,
    JX, JY, LAYER, LIMITS, LINEAR_DAMPING, LOW, MASS, MAX_TRAVEL, OMEGA, OTHER_X, OUTLINE, OWN_X, RADIUS, RATIO, REST,
    SECOND, SENSOR, SOLVED, TOUCHES, VX, VY, X, Y, ContactBatch, Settings,
)  # fmt: skip

needs_native = pytest.mark.skipif(not native.available(), reason="the native backend does not run here")
backends = pytest.mark.parametrize("backend", [portable, pytest.param(native, marks=needs_native)])
f4, nan, inf = np.float32, np.nan, np.inf
ALL = ("traits", "joints", "touches", "outlines")
GAMES = (SETTINGS,
    Settings(substeps=4, velocity_iterations=3, position_iterations=2, friction=f4(0.9), restitution=f4(0.6)),
    Settings(dt=f4(1 / 30), linear_damping=f4(0), angular_damping=f4(40), continuous=0),
    Settings(dt=f4(0.3), substeps=3, linear_damping=f4(3)),  # a tick in which Box2D would let bodies fall asleep
)  # fmt: skip


def random_parts(rng: np.random.Generator, batch: ContactBatch, names: tuple[str, ...]) -> dict[str, Any]:
    """Random numbers of these parts for a batch, of which some bodies change."""
    made: dict[str, Callable[[], Any]] = {
        "traits": lambda: random_traits(rng, batch), "joints": lambda: random_joints(rng, len(batch)),
        "touches": lambda: np.zeros((50, TOUCHES), f4), "outlines": lambda: random_outlines(rng, batch),
    }  # fmt: skip
    return {name: made[name]() for name in names}


@needs_native
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in range(1, 20))])
@pytest.mark.parametrize("names", [(), ("joints", "touches"), ("traits", "outlines"), ALL], ids="+".join)
def test_backends_agree(names: tuple[str, ...], seed: int) -> None:
    """About results, bodies, forces on joints and touches; some bodies fly as far as three metres in a substep."""
    rng, workspace = np.random.default_rng(seed), native.listen(native.make_workspace())
    results, pairs, pushed = set(), 0, 0
    for k in range(400):
        batch, settings = random_batch(rng), GAMES[k % 4]
        if k % 3 == 0:
            batch[:, MAX_TRAVEL] = 100
        given = random_parts(rng, batch, names)
        own = solved(native, workspace, batch, settings, **given)
        other = solved(portable, None, batch, settings, **given)
        assert own[0] == other[0]
        assert own[1].tobytes() == other[1].tobytes()
        assert own[0] == SOLVED or own[1].tobytes() == batch.tobytes()
        if own[0] == SOLVED and "joints" in given:
            np.testing.assert_array_equal(own[2], other[2])
            np.testing.assert_array_equal(own[3], other[3])
            pairs, pushed = pairs + int(own[3][0, LOW]), pushed + int((own[3][1:, IMPULSE] > 0).sum())
        results.add(own[0])
        if k % 4 == 0:  # nothing of the parts is left in the workspace
            assert solved(native, workspace, batch)[1].tobytes() == solved(portable, None, batch)[1].tobytes()
    assert results == {SOLVED, ABANDONED}
    assert "joints" not in names or pairs > pushed > 200


@needs_native
def test_backends_agree_about_discs_of_millimetres_beside_boxes() -> None:
    """Box2D keeps the centres of such small discs further from boxes than their radius."""
    rng, workspace = np.random.default_rng(2), native.make_workspace()
    for _ in range(500):
        radius, off = rng.uniform(0.0011, 0.02), rng.uniform(-0.01, 0.02)
        place = rng.uniform(0.03, 0.05) + radius, rng.uniform(-0.1, 0.1)
        batch = np.concatenate([circles(place), boxes((0, 0, 0.02, 0.1))])
        batch[0, [RADIUS, MASS, INERTIA]] = radius, np.pi * radius**2, np.pi * radius**4 / 2
        batch[0, VX] = (0.02 + radius - off - batch[0, X]) / (2 * SETTINGS.dt)
        assert solved(native, workspace, batch)[1].tobytes() == solved(portable, None, batch)[1].tobytes()


def far_batch(rng: np.random.Generator) -> ContactBatch:
    """Return a random batch of millimetres to kilometres in size, far away, with the highest speeds and any density."""
    batch = random_batch(rng)
    size, density = (np.exp(rng.uniform(*np.log(ends))) for ends in ((0.01, 1e4), (1e-3, 1e6)))
    batch[:, [X, Y, RADIUS, HALF_WIDTH, HALF_HEIGHT]] *= size
    sizes = batch[:, RADIUS : HALF_HEIGHT + 1]
    sizes[sizes > 0] = np.maximum(sizes[sizes > 0], 0.0011)
    batch[:, X : Y + 1] += rng.choice([0, 1e5, 9e5]) * rng.uniform(-1, 1, 2)
    area = np.where(batch[:, RADIUS] > 0, batch[:, RADIUS] ** 2, batch[:, HALF_WIDTH] * batch[:, HALF_HEIGHT])
    batch[:, MASS], batch[:, INERTIA] = density * area, density * area**2
    batch[:, VX : OMEGA + 1] *= rng.choice([1, 1e6, 1e12], 3)
    batch[:, ANGLE] *= rng.choice([1, 1e5])
    batch[:, JX:] *= rng.choice([1, 1e5])
    batch[:, MAX_TRAVEL] = np.inf
    return np.clip(batch, -LIMITS, LIMITS)


@backends
def test_what_is_within_the_limits_stays_finite(backend: Any) -> None:
    rng, workspace = np.random.default_rng(4), backend.make_workspace()
    worst = Settings(friction=f4(1e5), restitution=f4(1))
    for k in range(200):
        batch = far_batch(rng)
        settings = (SETTINGS, worst, worst._replace(dt=f4(1)), worst._replace(dt=f4(1e-4)))[k % 4]
        result, after, *_ = solved(backend, workspace, batch, settings)
        assert result == SOLVED
        assert np.isfinite(after[:, X : OMEGA + 1]).all()
        if backend is native:
            np.testing.assert_array_equal(after, solved(portable, None, batch, settings)[1])


SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
CIRCLE_OR_BOX = [RADIUS, HALF_WIDTH, HALF_HEIGHT]


def answer(backend: Any, part: str, columns: Any, value: Any) -> int:
    """Solve a disc on a rope at a square, a number of which is changed; the result."""
    batch, outlines = np.concatenate([circles((0, 0)), boxes((1, 0, 1, 1))]), np.zeros((2, OUTLINE), f4)
    become(batch, outlines, 1, Polygon(SQUARE))
    given = {"traits": usual_traits(2), "joints": rope(0, 1, 2), "touches": np.zeros((9, TOUCHES), f4)}
    changed = given | {"outlines": outlines, "batch": batch}
    changed[part][0 if part in ("batch", "joints") else 1, columns] = value
    result, after, *_ = solved(backend, backend.make_workspace(), batch, outlines=outlines, **given)
    assert result == SOLVED or after.tobytes() == batch.tobytes()
    return result


@backends
@pytest.mark.parametrize(
    ("part", "columns", "value"),
    [*(("batch", *row) for row in ((X, nan), (RADIUS, -1), (RADIUS, 1e-3), (CIRCLE_OR_BOX, [0, 1e-3, 1]),
                                   (CIRCLE_OR_BOX, [0, 1, 1e-3]), (CIRCLE_OR_BOX, [-1, 1, 1]), (JTURN, nan), (MASS, 0),
                                   (INERTIA, 0))),
     *(("traits", *row) for row in ((LINEAR_DAMPING, nan), (LAYER, -0.5))),
     *(("joints", *row) for row in ((SECOND, 0), (SECOND, 2), (FIRST, -1), (OTHER_X, nan), (REST, -0.5), (HERTZ, -0.5),
                                    (RATIO, -0.5))),
     *(("outlines", *row) for row in ((CORNERS, 2), (CORNERS, 9), (CORNERS, nan), (CORNERS, -1), (CORNER, nan),
        (CORNER, 1e7), (CORNER, -0.5), (CORNER + 2, 0.6), ([CORNER + 4, CORNER + 5], 0), (CORNER + 5, -0.6)))],
)  # fmt: skip
def test_what_box2d_would_reject_is_invalid(backend: Any, part: str, columns: Any, value: float) -> None:
    assert answer(backend, part, columns, value) == INVALID


@backends
@pytest.mark.parametrize(
    ("part", "columns", "most"),
    [("batch", [X, Y, ANGLE, RADIUS, HALF_WIDTH, HALF_HEIGHT, JX, JY, JTURN], 1e6), ("batch", [VX, VY], 1e15),
     ("batch", [OMEGA], 1e19), ("batch", [MASS], 1e17), ("batch", [INERTIA], 1e26), ("traits", range(LAYER), 1e5),
     ("traits", [LAYER, HITS], 0xFFFF), ("traits", [SENSOR], 1), ("joints", range(OWN_X, HERTZ), 1e6),
     ("joints", [HERTZ, RATIO], 1e5)],
)  # fmt: skip
def test_numbers_are_valid_up_to_their_limits(backend: Any, part: str, columns: Any, most: float) -> None:
    for column in columns:
        assert answer(backend, part, column, most) != INVALID
        assert answer(backend, part, column, np.nextafter(f4(most), f4(inf))) == INVALID


@backends
def test_too_many_bodies_are_invalid(backend: Any) -> None:
    crowd = circles(*((2.0 * k, 0) for k in range(native.CAPACITY + 1)))
    for bodies, result in (crowd, INVALID), (crowd[1:], SOLVED):
        assert solved(backend, backend.make_workspace(), bodies)[0] == result != ABANDONED


@needs_native
def test_the_world_of_an_arena_ends_with_its_last_view_and_before_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    ended, destroy = [], box2d_workspace._destroy

    def watched(base: int, memory: np.ndarray[Any, Any]) -> None:
        destroy(base, memory)
        ended.append(0 <= base - memory.ctypes.data < 64)

    monkeypatch.setattr(box2d_workspace, "_destroy", watched)
    view = native.make_workspace()[64:]
    gc.collect()
    assert not ended
    del view
    assert ended == [True]


@needs_native
def test_a_full_arena_agrees_and_is_as_good_as_new_afterwards() -> None:
    rng, workspace = np.random.default_rng(5), native.make_workspace()
    crowd = circles(*rng.uniform(-6, 6, (native.CAPACITY, 2)))
    assert solved(native, workspace, crowd)[1].tobytes() == solved(portable, None, crowd)[1].tobytes()
    fresh = native.make_workspace()
    for k in range(50):
        batch = random_batch(np.random.default_rng(k))
        assert solved(native, workspace, batch)[1].tobytes() == solved(native, fresh, batch)[1].tobytes()


@needs_native
def test_history_and_threads_leave_no_trace() -> None:
    batches = [random_batch(np.random.default_rng([3, k])) for k in range(400)]
    expected = [solved(native, native.make_workspace(), batch)[1].tobytes() for batch in batches]
    found: dict[int, list[bytes]] = {}

    def work(seed: int) -> None:
        workspace, order = native.make_workspace(), np.random.default_rng(seed).permutation(len(batches))
        results = {k: solved(native, workspace, batches[k])[1].tobytes() for k in (*order, *order[::-1])}
        found[seed] = [results[k] for k in range(len(batches))]

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {1: expected, 2: expected}


def test_uncompiled_runs_use_the_portable_backend() -> None:
    assert compiled() or not native.available()


def test_outlast_can_be_imported_where_warnings_are_errors() -> None:
    """Box2D alone cannot: the warning about its types ends the process. The filters are then as they were."""
    code = "import outlast, warnings; warnings.warn('late', DeprecationWarning)"
    found = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (found.returncode, found.stderr.splitlines()[-1:]) == (1, ["DeprecationWarning: late"])
