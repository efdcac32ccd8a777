"""Batches of bodies for the two Box2D backends: simple ones, and random ones with all that bodies can differ in."""

import math
from typing import Any

import numpy as np

from outlast.components import Polygon
from outlast.ecs import DeclarationError
from outlast.systems.box2d import portable

from outlast.systems.box2d.batch import (  # isort: skip
    ANGLE, COLUMNS, CORNER, CORNERS, DRIVEN, DYNAMIC, FIRST, FORCE, HALF_HEIGHT, HALF_WIDTH, HERTZ, HITS, INERTIA,
    JOINTS, JX, KIND, LAYER, MASS, MAX_TRAVEL, OMEGA, OUTLINE, OWN_X, RADIUS, REST, ROD, ROPE, SECOND, SENSOR, TRAITS,
    VX, VY, WELD, X, Y, ContactBatch, Settings,
)  # fmt: skip

SETTINGS = Settings()
Matrix = np.ndarray[Any, Any]


def circles(*places: Any) -> ContactBatch:
    batch = np.zeros((len(places), COLUMNS), np.float32)
    batch[:, X : Y + 1] = places
    batch[:, RADIUS], batch[:, DYNAMIC], batch[:, MAX_TRAVEL] = 0.5, 1, 1e5
    batch[:, MASS], batch[:, INERTIA] = np.pi / 4, np.pi / 32
    return batch


def boxes(*sizes: tuple[float, float, float, float], dynamic: int = 0) -> ContactBatch:
    batch = np.zeros((len(sizes), COLUMNS), np.float32)
    batch[:, [X, Y, HALF_WIDTH, HALF_HEIGHT]] = sizes
    batch[:, DYNAMIC], batch[:, MAX_TRAVEL] = dynamic, 1e5
    width, height = batch[:, HALF_WIDTH], batch[:, HALF_HEIGHT]
    batch[:, MASS], batch[:, INERTIA] = 4 * width * height, 4 * width * height * (width**2 + height**2) / 3
    return batch


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


def usual_traits(count: int) -> Matrix:
    return np.tile(portable._usual(SETTINGS), (count, 1))


def random_traits(rng: np.random.Generator, batch: ContactBatch) -> Matrix:
    """Random numbers of all bodies, in a batch in which some of those that stand become driven ones."""
    count = len(batch)
    traits = np.zeros((count, TRAITS), np.float32)
    traits[:, :LAYER] = rng.uniform(0, 1, (count, LAYER)) * [1.5, 1.2, 20, 60]
    traits[:, LAYER] = 1 << rng.integers(0, 3, count)
    traits[:, HITS] = rng.choice([0xFFFF, 1, 6, 0], count, p=[0.6, 0.15, 0.2, 0.05])
    traits[:, SENSOR] = rng.random(count) < 0.15
    driven = (batch[:, DYNAMIC] == 0) & (rng.random(count) < 0.5)
    batch[driven, DYNAMIC] = DRIVEN
    batch[driven, VX : OMEGA + 1] = rng.normal(0, rng.choice([0.5, 5, 100]), (driven.sum(), 3))
    return traits


def rope(first: int, second: int, rest: float) -> Matrix:
    row = np.zeros((1, JOINTS), np.float32)
    row[0, [KIND, FIRST, SECOND, REST]] = ROPE, first, second, rest
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


def random_polygon(rng: np.random.Generator) -> Polygon:
    """Three to eight corners on an ellipse of 10 cm to 3 m, which is turned by any angle."""
    while True:
        angles, turn = np.sort(rng.uniform(0, 2 * math.pi, rng.integers(3, 9))), np.exp(2j * math.pi * rng.random())
        points = (rng.uniform(0.05, 1.5) * np.cos(angles) + 1j * rng.uniform(0.05, 1.5) * np.sin(angles)) * turn
        try:
            return Polygon([(point.real, point.imag) for point in points])
        except DeclarationError:
            continue  # corners too near to each other


def corners_of(polygon: Polygon) -> list[tuple[float, float]]:
    fills = polygon.fills
    return [(float(x), float(y)) for x, y in zip(fills["x"], fills["y"], strict=True)][: fills["corners"]]


def outline_of(polygon: Polygon) -> Matrix:
    row, fills = np.zeros(OUTLINE, np.float32), polygon.fills
    row[CORNERS], row[CORNER::2], row[CORNER + 1 :: 2] = fills["corners"], fills["x"], fills["y"]
    return row


def become(batch: ContactBatch, outlines: Matrix, k: int, polygon: Polygon) -> None:
    outlines[k] = outline_of(polygon)
    batch[k, RADIUS], (shape,) = 0, polygon.brings()
    batch[k, HALF_WIDTH], batch[k, HALF_HEIGHT] = shape.fills["half_width"], shape.fills["half_height"]


def random_outlines(rng: np.random.Generator, batch: ContactBatch) -> Matrix:
    outlines = np.zeros((len(batch), OUTLINE), np.float32)
    for k in np.flatnonzero((batch[:, RADIUS] == 0) & (rng.random(len(batch)) < 0.7)):
        become(batch, outlines, k, random_polygon(rng))
    return outlines


def solved(
    backend: Any, workspace: Any, batch: ContactBatch, settings: Settings = SETTINGS, **parts: Any
) -> tuple[int, ContactBatch, Any, Any]:
    """Solve copies of a batch and its parts; returns the result, the bodies, the joints and the touches."""
    batch, parts = batch.copy(), {name: part.copy() for name, part in parts.items()}
    joined = {"joined": len(parts["joints"])} if "joints" in parts else {}
    result = backend.solve(workspace, settings, batch, len(batch), **parts, **joined)
    return result, batch, parts.get("joints"), parts.get("touches")
