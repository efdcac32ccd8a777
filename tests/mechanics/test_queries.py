"""Queries about bodies: in systems and from Python, they answer what plain geometry of corners and edges does."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Body, Phase, Polygon, Shape, Side, Solid
from outlast.ecs import Archetype, Array, Bitset, Module, Rows, Singleton, Write, column
from outlast.queries import Bodies, around, distance, first_on_ray, line_of_sight, nearest, within
from tests.conftest import scaled
from tests.helpers import naive_geometry as naive
from tests.helpers.contact_batches import corners_of, random_polygon

FAR = np.float32(2)
ENOUGH = 1e-4  # metres: where an answer turns, rounding decides
WORLDS = scaled(10, least=4)


class Answers(Singleton):
    distances: Array = column("f4", "rows", "rows")
    near: Array = column("u1", "rows", "rows")  # of each point that a body stands on
    near_body: Array = column("u1", "rows", "rows")
    best: Array = column("i4", "rows")
    first: Array = column("i4", "rows")
    seen: Array = column("u1", "rows", "rows")


class Rubble(Module):
    """Polygons of all sizes, some of which move."""

    def archetypes(self) -> list[Archetype]:
        polygons = Polygon([corners_of(random_polygon(np.random.default_rng(k))) for k in range(8)])
        return [Archetype("rubble", (Body(), polygons, Solid()), 8)]


class Asks(Module):
    def singletons(self) -> list[Singleton]:
        return [Answers()]


@Asks.system(Phase.LOOK)
def ask(answers: Write[Answers], bodies: Bodies, everything: Rows[Shape], agents: Bitset[Side]) -> None:
    for e in everything:
        x, y = bodies.body.x[e], bodies.body.y[e]
        answers.near[e], answers.near_body[e] = 0, 0
        for k in range(around(bodies, bodies.members, x, y, FAR)):
            answers.near[e, bodies.rows[k]] = 1
        for k in range(within(bodies, bodies.members, e, FAR)):
            answers.near_body[e, bodies.rows[k]] = 1
        answers.best[e] = nearest(bodies, agents, e, FAR)
        dx, dy = 4 * bodies.body.cosine[e], 4 * bodies.body.sine[e]
        answers.first[e] = first_on_ray(bodies, bodies.members, x, y, dx, dy, e)[0]
        for o in everything:
            answers.distances[e, o] = distance(bodies, e, o)
            answers.seen[e, o] = line_of_sight(bodies, bodies.members, e, o)


@pytest.fixture(scope="module")
def env() -> Any:
    """Worlds with discs, rectangles and polygons, some of them dead, close together."""
    scenario = (
        outlast.variant("ffa_4").with_(Asks(), Rubble()).replace(room_size=9.0, safe_zone_radii=(4.0, 2.0), n_heals=4)
    )
    env, rng = outlast.make_vec(scenario, WORLDS, seed=0), np.random.default_rng(0)
    env.reset()
    for k in range(env.worlds.span("box").stop - env.worlds.span("box").start):
        env.place("box", k, angle=rng.uniform(-3, 3, WORLDS), half_width=rng.uniform(0.1, 1.5, WORLDS))
    for k in range(8):
        x, y = rng.uniform(-4, 4, (2, WORLDS))
        env.place("rubble", k, x=x, y=y, angle=rng.uniform(-3, 3, WORLDS))
    env.place("agent", 0, angle=rng.uniform(-3, 3, WORLDS))
    env.step(np.tile(env.noop, (WORLDS, env.num_agents, 1)))
    return env


def outlines(env: Any, w: int) -> dict[int, Any]:
    """The corners of living rectangles and polygons, and centre and radius of living discs, by row."""
    found = dict[int, Any]()
    for e in env.worlds.layout.rows(Shape):
        view = env.worlds.entity(int(e), w)
        body, shape, centre = view.Body, view.Shape, (float(view.Body.x), float(view.Body.y))
        if view.Entity.alive:
            size = float(shape.half_width), float(shape.half_height)
            corners = None if shape.radius else naive.box_corners(centre, float(body.angle), *size)
            if e in env.worlds.layout.rows(Polygon):
                count = int(view.Polygon.corners)
                turn = complex(math.cos(float(body.angle)), math.sin(float(body.angle)))
                pairs = zip(view.Polygon.x.tolist(), view.Polygon.y.tolist(), strict=True)
                points = [complex(*centre) + turn * complex(*pair) for pair in pairs][:count]
                corners = [(point.real, point.imag) for point in points]
            found[int(e)] = (centre, float(shape.radius), float(body.angle), size, corners)
    return found


def apart(one: Any, other: Any) -> float:
    """Metres between two outlines, from their corners and edges."""
    (a, r, _, _, first), (b, s, _, _, second) = one, other
    if first is None and second is None:
        return max(math.dist(a, b) - r - s, 0.0)
    if first is None or second is None:
        (centre, radius, *_), corners = (one, second) if first is None else (other, first)
        return 0.0 if naive.in_polygon(centre, corners) else max(naive.edge_distance(centre, corners) - radius, 0.0)
    inside = any(naive.in_polygon(p, second) for p in first) or any(naive.in_polygon(p, first) for p in second)
    edges = [(p, q) for p, q in pairwise([*first, first[0]])]
    crossed = any(naive.ray_polygon(p, (q[0] - p[0], q[1] - p[1]), second) <= 1 for p, q in edges)
    gaps = [naive.edge_distance(p, second) for p in first] + [naive.edge_distance(p, first) for p in second]
    return 0.0 if inside or crossed else min(gaps)


def entered(outline: Any, o: Any, d: Any) -> float:
    """The fraction at which a ray enters an outline; above 1 if it does not."""
    centre, radius, _, _, corners = outline
    return naive.ray_circle(o, d, centre, radius) if corners is None else naive.ray_polygon(o, d, corners)


def test_distances_lists_and_rays_are_those_of_plain_geometry(env: Any) -> None:
    answers, agents = env.worlds[Answers], {*env.worlds.layout.rows(Side).tolist()}
    met = seen = 0
    for w in range(WORLDS):
        there = outlines(env, w)
        for e, own in there.items():
            ways = {o: apart(own, other) for o, other in there.items()}
            assert answers.distances[w, e, [*ways]] == pytest.approx([*ways.values()], abs=ENOUGH)
            points = {o: apart(((own[0]), 0.0, 0.0, (0, 0), None), other) for o, other in there.items()}
            for found, far in ((answers.near[w, e], points), (answers.near_body[w, e], ways)):
                assert {*np.flatnonzero(found)} <= {*there}
                for o, way in far.items():
                    assert abs(way - FAR) < ENOUGH or found[o] == (way <= FAR and (far is points or o != e))
            best, mine = answers.best[w, e], {o: way for o, way in ways.items() if o in agents - {e} and way <= FAR}
            assert (best < 0) == (not mine)
            assert not mine or ways[best] == pytest.approx(min(mine.values()), abs=ENOUGH)
            o, d = own[0], (4 * math.cos(own[2]), 4 * math.sin(own[2]))
            hits = {k: at for k, other in there.items() if k != e and (at := entered(other, o, d)) <= 1}
            first = int(answers.first[w, e])
            assert (first < 0) == (not hits)
            assert not hits or hits[first] == pytest.approx(min(hits.values()), abs=ENOUGH)
            met += len(hits) > 0
            for target, other in there.items():
                d = (other[0][0] - o[0]) * (1 + 1e-6), (other[0][1] - o[1]) * (1 + 1e-6)
                at = {k: entered(each, o, d) for k, each in there.items() if k != e}
                between = min((v for k, v in at.items() if k != target), default=2.0)
                if target != e and abs(between - at[target]) > ENOUGH:
                    sees = at[target] <= 1 and between > at[target]
                    assert answers.seen[w, e, target] == sees
                    seen += sees
    assert met > WORLDS
    assert seen > 10 * WORLDS


def test_python_gets_the_answers_that_systems_get(env: Any) -> None:
    answers = env.worlds[Answers]
    for w in range(0, WORLDS, 4):
        query = env.query(w)
        for e in outlines(env, w):
            body = env.worlds.entity(e, w).Body
            assert query.near(body.x, body.y, 2.0) == np.flatnonzero(answers.near[w, e]).tolist()
            assert query.within(e, 2.0) == np.flatnonzero(answers.near_body[w, e]).tolist()
            assert query.nearest(e, 2.0, Side) == answers.best[w, e]
            ray = query.first_on_ray(body.x, body.y, 4 * body.cosine, 4 * body.sine, skip=e)
            assert (ray[0] if ray else -1) == answers.first[w, e]
            for o in range(0, env.worlds.dims["rows"], 5):
                assert query.distance(e, o) == answers.distances[w, e, o] or o not in env.worlds.layout.rows(Shape)
                assert query.overlap(e, o) == (query.distance(e, o) == 0)


def test_questions_about_what_there_is_not_are_refused(env: Any) -> None:
    with pytest.raises(ValueError, match=f"world = {WORLDS}: there are the worlds 0 to"):
        env.query(WORLDS)
    with pytest.raises(ValueError, match="row 99 does not exist: there are"):
        env.query().distance(0, 99)
