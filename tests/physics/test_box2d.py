"""The two Box2D backends: equal bit for bit, free of history, close to a world that is never taken apart."""

import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import Box2D
import numpy as np
import pytest

from outlast.ecs.kernels.jit import compiled
from outlast.systems.box2d import layout as box2d_layout
from outlast.systems.box2d import native as box2d_native
from outlast.systems.box2d import portable as box2d_portable
from outlast.systems.box2d import verify as box2d_verify
from outlast.systems.box2d import workspace as box2d_workspace

from outlast.systems.box2d.batch import (  # isort: skip
    ABANDONED, ANGLE, COLUMNS, DYNAMIC, HALF_HEIGHT, HALF_WIDTH, INERTIA, INVALID, JTURN, JX, MASS, OMEGA, RADIUS,
    LIMITS, MAX_TRAVEL, SOLVED, VX, VY, X, Y, IncompatibleBox2D, ContactBatch, Settings,
)  # fmt: skip

SETTINGS = Settings()
needs_native = pytest.mark.skipif(not box2d_native.available(), reason="the native backend does not run here")
backends = pytest.mark.parametrize("backend", [box2d_portable, pytest.param(box2d_native, marks=needs_native)])
f4 = np.float32


def random_batch(rng: np.random.Generator) -> ContactBatch:
    """Two to nine bodies in a space of 2 to 6 metres: overlaps, high speeds, impulses, sometimes short MAX_TRAVEL."""
    count = rng.integers(2, 10)
    batch = np.zeros((count, COLUMNS), np.float32)
    span = rng.choice([1.0, 2.0, 3.0])
    batch[:, X : Y + 1] = rng.uniform(-span, span, (count, 2))
    batch[:, VX : VY + 1] = rng.normal(0, rng.choice([0.1, 3, 15, 150]), (count, 2))
    batch[:, OMEGA] = rng.normal(0, rng.choice([2, 50]), count)
    batch[:, RADIUS] = np.where(rng.random(count) < 0.6, rng.uniform(0.2, 0.7, count), 0)
    batch[:, HALF_WIDTH : HALF_HEIGHT + 1] = rng.uniform(0.05, 1.5, (count, 2))
    batch[:, DYNAMIC] = rng.random(count) < 0.7
    batch[:, ANGLE] = np.where(rng.random(count) < 0.5, 0, rng.uniform(-3, 3, count))
    batch[:, VX : OMEGA + 1] *= batch[:, DYNAMIC : DYNAMIC + 1]
    batch[:, MASS : INERTIA + 1] = rng.uniform(0.1, 3, (count, 2))
    batch[:, MAX_TRAVEL] = rng.choice([100, 0.5])
    batch[:, JX:] = rng.normal(0, 0.2, (count, 3)) * (rng.random((count, 1)) < 0.5)
    return batch


def random_batches(number: int, seed: int = 0) -> list[ContactBatch]:
    rng = np.random.default_rng(seed)
    return [random_batch(rng) for _ in range(number)]


def solved(
    backend: Any, workspace: Any, batch: ContactBatch, settings: Settings = SETTINGS
) -> tuple[int, ContactBatch]:
    batch = batch.copy()
    return backend.solve(workspace, settings, batch, len(batch)), batch


@needs_native
@pytest.mark.parametrize("settings", [
    SETTINGS,
    Settings(substeps=4, velocity_iterations=3, position_iterations=2, friction=f4(0.9), restitution=f4(0.6)),
    Settings(dt=f4(1 / 30), linear_damping=f4(0), angular_damping=f4(40), continuous=0),
    Settings(dt=f4(0.3), substeps=3, linear_damping=f4(3)),  # a tick in which Box2D would let bodies fall asleep
])  # fmt: skip
def test_backends_agree(settings: Settings) -> None:
    workspace, results = box2d_native.make_workspace(), set()
    for batch in random_batches(1500, seed=settings.substeps):
        native, portable = (
            solved(box2d_native, workspace, batch, settings),
            solved(box2d_portable, None, batch, settings),
        )
        assert native[0] == portable[0]
        assert native[1].tobytes() == portable[1].tobytes()
        assert native[0] == SOLVED or native[1].tobytes() == batch.tobytes()
        results.add(native[0])
    assert results == {SOLVED, ABANDONED}


@needs_native
def test_backends_agree_about_discs_of_millimetres_beside_boxes() -> None:
    """Box2D keeps the centres of such small discs further from boxes than their radius."""
    rng, workspace = np.random.default_rng(2), box2d_native.make_workspace()
    for _ in range(500):
        radius, off = rng.uniform(0.0011, 0.02), rng.uniform(-0.01, 0.02)
        batch = np.concatenate(
            [circles((rng.uniform(0.03, 0.05) + radius, rng.uniform(-0.1, 0.1))), boxes((0, 0, 0.02, 0.1))]
        )
        batch[0, [RADIUS, MASS, INERTIA]] = radius, np.pi * radius**2, np.pi * radius**4 / 2
        batch[0, VX] = (0.02 + radius - off - batch[0, X]) / (2 * SETTINGS.dt)
        results = [
            solved(backend, memory, batch) for backend, memory in ((box2d_native, workspace), (box2d_portable, None))
        ]
        assert results[0][1].tobytes() == results[1][1].tobytes()


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
    rng, workspace, worst = (
        np.random.default_rng(4),
        backend.make_workspace(),
        Settings(friction=f4(1e5), restitution=f4(1)),
    )
    for k in range(200):
        batch = far_batch(rng)
        settings = (SETTINGS, worst, worst._replace(dt=f4(1)), worst._replace(dt=f4(1e-4)))[k % 4]
        result, after = solved(backend, workspace, batch, settings)
        assert result == SOLVED
        assert np.isfinite(after[:, X : OMEGA + 1]).all()
        if backend is box2d_native:
            np.testing.assert_array_equal(after, solved(box2d_portable, None, batch, settings)[1])


@backends
def test_reach_exceeded_leaves_the_batch_untouched(backend: Any) -> None:
    batch = circles((0, 0), (0.9, 0))
    batch[0, VX] = 6
    batch[:, MAX_TRAVEL] = 10
    assert solved(backend, backend.make_workspace(), batch)[0] == SOLVED
    batch[1, MAX_TRAVEL] = 0.01
    result, after = solved(backend, backend.make_workspace(), batch)
    assert result == ABANDONED
    assert after.tobytes() == batch.tobytes()


@backends
@pytest.mark.parametrize(
    ("column", "value"),
    [(X, np.nan), (VY, np.inf), (X, 2e6), (RADIUS, -1), (JTURN, np.nan), (MASS, 0), (INERTIA, -1), (INERTIA, 1e27)],
)
def test_what_box2d_would_reject_is_invalid(backend: Any, column: int, value: float) -> None:
    batch = circles((0, 0), (0.9, 0))
    batch[1, column] = value
    assert solved(backend, backend.make_workspace(), batch)[0] == INVALID


@backends
def test_flat_boxes_and_too_many_bodies_are_invalid(backend: Any) -> None:
    batch = circles((0, 0), (0.9, 0))
    batch[1, RADIUS] = 0
    assert solved(backend, backend.make_workspace(), batch)[0] == INVALID
    crowd = circles(*((2.0 * k, 0) for k in range(box2d_native.CAPACITY + 1)))
    assert solved(backend, backend.make_workspace(), crowd)[0] == INVALID


@needs_native
def test_the_world_of_an_arena_ends_with_its_last_view_and_before_its_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    ended, destroy = [], box2d_workspace._destroy

    def watched(base: int, memory: np.ndarray[Any, Any]) -> None:
        destroy(base, memory)
        ended.append(0 <= base - memory.ctypes.data < 64)

    monkeypatch.setattr(box2d_workspace, "_destroy", watched)
    view = box2d_native.make_workspace()[64:]
    gc.collect()
    assert not ended
    del view
    assert ended == [True]


@needs_native
def test_a_full_arena_agrees_and_is_as_good_as_new_afterwards() -> None:
    rng, workspace = np.random.default_rng(5), box2d_native.make_workspace()
    crowd = circles(*rng.uniform(-6, 6, (box2d_native.CAPACITY, 2)))
    assert solved(box2d_native, workspace, crowd)[1].tobytes() == solved(box2d_portable, None, crowd)[1].tobytes()
    fresh = box2d_native.make_workspace()
    for batch in random_batches(50):
        assert solved(box2d_native, workspace, batch)[1].tobytes() == solved(box2d_native, fresh, batch)[1].tobytes()


@needs_native
def test_history_and_threads_leave_no_trace() -> None:
    batches = random_batches(400, seed=3)
    expected = [solved(box2d_native, box2d_native.make_workspace(), batch)[1].tobytes() for batch in batches]
    found: dict[int, list[bytes]] = {}

    def work(seed: int) -> None:
        workspace, order = box2d_native.make_workspace(), np.random.default_rng(seed).permutation(len(batches))
        results = {k: solved(box2d_native, workspace, batches[k])[1].tobytes() for k in (*order, *order[::-1])}
        found[seed] = [results[k] for k in range(len(batches))]

    threads = [threading.Thread(target=work, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == {1: expected, 2: expected}


@backends
def test_free_flight_is_the_formula(backend: Any) -> None:
    rng, workspace = np.random.default_rng(1), backend.make_workspace()
    for speed in (0.0, 1.0, 30.0, 300.0):  # the last one is beyond 2 m and a quarter turn a substep
        for _ in range(20):
            batch = circles((0, 0))
            batch[0, X : OMEGA + 1] = rng.normal(0, 1, 6) * [5, 5, 3, speed, speed, speed]
            batch[0, RADIUS] = rng.uniform(0.1, 2)
            batch[0, JX:] = rng.normal(0, 0.3, 3)
            result, after = solved(backend, workspace, batch)
            assert result == SOLVED
            assert after[0, X : OMEGA + 1].tobytes() == flown(batch[0]).tobytes()


def flown(row: ContactBatch) -> ContactBatch:
    """Two substeps of a circle that touches nothing, in float32."""
    dt, damping = SETTINGS.dt, SETTINGS.linear_damping
    place, motion, push = row[X : ANGLE + 1].copy(), row[VX : OMEGA + 1].copy(), row[JX:]
    inverse_mass, inverse_inertia = f4(1) / row[MASS], f4(1) / row[INERTIA]
    for _ in range(SETTINGS.substeps):
        motion += np.array([inverse_mass, inverse_mass, inverse_inertia]) * push
        motion *= np.clip(f4(1) - dt * damping, f4(0), f4(1))
        step = dt * motion
        length = step[0] * step[0] + step[1] * step[1]
        if length > 4:
            motion[:2] *= f4(2) / np.sqrt(length)
        if step[2] * step[2] > f4(0.5 * np.pi) * f4(0.5 * np.pi):
            motion[2] *= f4(0.5 * np.pi) / abs(step[2])
        place += dt * motion
    return np.concatenate([place, motion])


# Nothing persists between calls, also not the impulses with which a lasting contact would start its next tick. How
# far does that lead from one world that is kept? A circle against anything that stands still: nowhere (the last bit
# of a float). Bodies that push each other: 0.1 mm; 1 cm after 10 seconds where a circle is balanced on the round
# or turning body that it pushes, a situation in which every deviation grows.

DRIVES: dict[str, tuple[float, float, float]] = {
    "straight": (0.125, 0, 0), "sliding": (0.125, 0.04, 0), "spinning": (0.125, 0, 0.00625),
}  # fmt: skip


def circles(*places: Any) -> ContactBatch:
    batch = np.zeros((len(places), COLUMNS), np.float32)
    batch[:, X : Y + 1] = places
    batch[:, RADIUS], batch[:, DYNAMIC], batch[:, MAX_TRAVEL] = 0.5, 1, 1e5
    batch[:, MASS], batch[:, INERTIA] = np.pi / 4, np.pi / 32
    return batch


def room(*rows: ContactBatch) -> ContactBatch:
    """The rows between four walls, 6 metres apart."""
    walls = boxes((3, 0, 0.125, 3), (-3, 0, 0.125, 3), (0, 3, 3, 0.125), (0, -3, 3, 0.125))
    return np.concatenate([*rows, walls])


def boxes(*sizes: tuple[float, float, float, float], dynamic: int = 0) -> ContactBatch:
    batch = np.zeros((len(sizes), COLUMNS), np.float32)
    batch[:, [X, Y, HALF_WIDTH, HALF_HEIGHT]] = sizes
    batch[:, DYNAMIC], batch[:, MAX_TRAVEL] = dynamic, 1e5
    width, height = batch[:, HALF_WIDTH], batch[:, HALF_HEIGHT]
    batch[:, MASS], batch[:, INERTIA] = 4 * width * height, 4 * width * height * (width**2 + height**2) / 3
    return batch


def deviation(batch: ContactBatch, drive: Callable[[ContactBatch, int], None]) -> float:
    """Metres between 300 ticks of solved batches and of one pybox2d world that is kept; the largest of all."""
    backend = box2d_native if box2d_native.available() else box2d_portable
    world, workspace, largest = Box2D.b2World(gravity=(0, 0)), backend.make_workspace(), 0.0
    bodies = [box2d_portable._build(world, row, box2d_portable._usual(SETTINGS)) for row in batch]
    for tick in range(300):
        drive(batch, tick)
        for _ in range(SETTINGS.substeps):
            for body, row in zip(bodies, batch, strict=True):
                box2d_portable._push(body, row)
            world.Step(float(SETTINGS.dt), SETTINGS.velocity_iterations, SETTINGS.position_iterations)
        assert backend.solve(workspace, SETTINGS, batch, len(batch)) == SOLVED
        places = np.array([tuple(body.position) for body in bodies])
        largest = max(largest, float(np.linalg.norm(places - batch[:, X : Y + 1], axis=1).max()))
    return largest


def constant(name: str) -> Callable[[ContactBatch, int], None]:
    def drive(batch: ContactBatch, tick: int) -> None:
        batch[0, JX : JTURN + 1] = DRIVES[name]

    return drive


def wandering(seed: int, bodies: int) -> Callable[[ContactBatch, int], None]:
    rng = np.random.default_rng(seed)

    def drive(batch: ContactBatch, tick: int) -> None:
        if tick % 15 == 0:
            batch[:bodies, JX : JTURN + 1] = rng.uniform(-1, 1, (bodies, 3)) * [0.125, 0.125, 0.00625]

    return drive


@pytest.mark.parametrize("name", DRIVES)
def test_no_warm_start_against_static_bodies(name: str) -> None:
    assert deviation(room(circles((1, 0))), constant(name)) < 1e-6
    assert deviation(room(circles((-1, 0.1)), boxes((0.5, 0, 0.5, 0.7))), constant(name)) < 1e-6


def test_no_warm_start_of_bodies_that_push_each_other() -> None:
    assert deviation(room(circles((-1, 0), (0.5, 0))), constant("straight")) < 1e-3
    assert deviation(room(circles((-1, 0.1), (0.5, 0))), constant("straight")) < 0.05
    assert deviation(room(circles((-1, 0.1)), boxes((0.5, 0, 0.5, 0.7), dynamic=1)), constant("straight")) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_no_warm_start_of_two_that_wander(seed: int) -> None:
    assert deviation(room(circles((-1, 0.1), (0.5, 0)), boxes((0, 2, 0.4, 0.3))), wandering(seed, 2)) < 1e-3


@needs_native
def test_this_box2d_is_the_known_one() -> None:
    box2d_native.verify()
    assert not box2d_layout.missing_symbols()


@needs_native
@pytest.mark.parametrize("offset", [
    "BODY_ANGLE", "BODY_COS", "BODY_EDGES", "BODY_NEXT", "CIRCLE_RADIUS", "CONSTRAINT_SIZE", "CONTACT_FLAGS",
    "CONTACT_NEXT", "DEF_ANGLE", "FIXTURE_PROXIES", "FIXTURE_SHAPE", "IMPULSES_1", "MANAGER_CONTACTS",
    "MOVE_COUNT", "NODE_NEXT", "POLYGON_VERTICES", "SHAPE_TYPE", "TREE_FREE", "WORLD_BODIES", "WORLD_MANAGER",
])  # fmt: skip
def test_verify_finds_a_wrong_offset(offset: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(box2d_layout, offset, getattr(box2d_layout, offset) + 8)
    monkeypatch.setattr(box2d_verify, "_report", box2d_verify._report.__wrapped__)
    with pytest.raises(IncompatibleBox2D, match=f"{offset} holds .*portable"):
        box2d_native.verify()
    assert not box2d_native.available()


def test_verify_finds_a_missing_symbol(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(box2d_layout.SIGNATURES, "_ZN7b2World4LeapEv", ("void",))
    monkeypatch.setattr(box2d_verify, "_report", box2d_verify._report.__wrapped__)
    with pytest.raises(IncompatibleBox2D, match="_ZN7b2World4LeapEv"):
        box2d_native.verify()


OUTER = """
import sys

import numpy as np

from outlast.ecs.kernels.jit import entry_point
from outlast.systems.box2d import native as box2d_native
from outlast.systems.box2d.batch import Settings


def twice(workspace, settings, batch, count):
    first = box2d_native.solve(workspace, settings, batch, count)
    return first + box2d_native.solve(workspace, settings, batch, count)


def main(file):
    outer, batch = entry_point(twice), np.load(file)
    outer.enable_caching()
    assert outer(box2d_native.make_workspace(), Settings(), batch, len(batch)) == 0
    print(sum(outer.stats.cache_hits.values()), batch.tobytes().hex())
"""


@pytest.mark.nightly
@needs_native
def test_a_cached_kernel_runs_in_another_process(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(OUTER)
    batch = room(circles((0, 0), (0.9, 0.1)))
    np.save(tmp_path / "batch.npy", batch)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", f"import outer; outer.main({str(tmp_path / 'batch.npy')!r})"]
    first, second = (subprocess.check_output(command, env=environment, text=True).split() for _ in range(2))
    expected = solved(box2d_portable, None, solved(box2d_portable, None, batch)[1])[1].tobytes().hex()
    assert first == ["0", expected]
    assert second == ["1", expected]


def test_uncompiled_runs_use_the_portable_backend() -> None:
    assert compiled() or not box2d_native.available()


@pytest.mark.parametrize("strict", ["error", "error::DeprecationWarning"])
def test_outlast_can_be_imported_where_warnings_are_errors(strict: str) -> None:
    """Box2D alone cannot: the warning about its types ends the process. The filters are then as they were."""
    code = "import outlast, warnings; warnings.warn('late', DeprecationWarning)"
    found = subprocess.run([sys.executable, "-W", strict, "-c", code], capture_output=True, text=True)
    assert (found.returncode, found.stderr.splitlines()[-1:]) == (1, ["DeprecationWarning: late"])
