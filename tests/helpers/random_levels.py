"""Games with random levels, and what must hold in all of them, for many worlds at once; float64.

Kinds of games differ in mechanics, and so in compiled code; their numbers are drawn from a generator.
"""

from typing import Any

import numpy as np

import outlast
from outlast import Scenario, systems

from outlast.components import (  # isort: skip
    Bag, Before, Body, BoxesPlaced, BoxPlaced, Item, Respawned, Return, Shape, Side, Solid, Spawned, Wall,
)  # fmt: skip
from outlast.distributions import choice, integers, uniform
from outlast.ecs import Clock, Entity, NumberError, Worlds
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.levels import FloorPlan
from tests.helpers.naive_walls import free_parts

Array = np.ndarray[Any, Any]
SLOP = 0.02  # metres by which Box2D lets bodies overlap, also as it pushes them apart late
NO_ROOM = ("wide, but agents", "do not fit", "must stay", "free place")  # in errors about passages or bodies: no room
BLOCKS = 8  # rectangles of a random floor plan


def scenario(kind: str, rng: np.random.Generator) -> Scenario:
    """A random game of one of KINDS of which worlds can be made."""
    while True:
        found = KINDS[kind](rng)
        try:
            outlast.make_vec(found, 1).close()
        except NumberError as error:
            if not any(words in str(error) for words in NO_ROOM):
                raise
        else:
            return found


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)


def _range(rng: np.random.Generator, low: float, high: float) -> Any:
    ends = sorted(_between(rng, low, high) for _ in range(2))
    return uniform(ends[0], ends[1] + 0.01)


def _game(name: str, rng: np.random.Generator, **numbers: Any) -> Scenario:
    """A variant in a room of random width and height; counts and lengths of episodes vary from world to world."""
    width, height = _between(rng, 16, 40), _between(rng, 14, 28)
    half = min(width, height) / 2
    return (
        outlast.variant(name)
        .replace(
            room_width=width,
            room_height=height,
            safe_zone_radii=(0.9 * half, 0.3 * half),
            safe_zone_damage=0,
            motors_ahead=_between(rng, 0.2, 0.7),
            melee_damage=20,
            agents_health=15,
            boxes_toughness=int(rng.integers(1, 20)),
            **numbers,
        )
        .vary(
            n_agents=integers(4, 4 + int(rng.integers(1, 4))),
            n_heals=integers(1, 12),
            n_boxes=integers(1, 8),
            ending_limit=integers(30, 90),
        )
    )


def _mazes(rng: np.random.Generator) -> Scenario:
    game = _game("ffa_3", rng, ending_rule="never", ending_limit=60)
    radii, delay = _range(rng, 0.2, 0.6), int(rng.integers(1, 20))
    columns, rows = (int(n) for n in rng.integers(2, 8, 2))
    return (
        game.with_(systems.Maze(columns=columns, rows=rows, blocks=columns * rows), systems.Respawn(ticks=delay))
        .vary(agents_radius=radii, maze_columns=integers(1, columns), maze_rows=integers(1, rows))
        .vary(maze_loops=_range(rng, 0, 0.9), maze_thickness=_range(rng, 0.02, 0.8))
    )


def _rooms(rng: np.random.Generator) -> Scenario:
    columns, rows = (int(n) for n in rng.integers(2, 5, 2))
    blocks = max(1, 2 * ((columns - 1) * rows + columns * (rows - 1)))
    hunter = outlast.role(1, agents_radius=_between(rng, 0.5, 0.9), motors_ahead=_between(rng, 0.2, 0.6))
    prey = outlast.role(agents_radius=_range(rng, 0.2, 0.5), preparation_ticks=0)
    waits = systems.Preparation(ticks=int(rng.integers(1, 40)), blind=True)
    return (
        _game("teams_3", rng, teams_sizes=(1, 6), boxes_dynamic=True)
        .with_(systems.Rooms(columns=columns, rows=rows, blocks=blocks), waits)
        .roles(hunter=hunter, prey=prey)
        .vary(rooms_columns=integers(1, columns), rooms_rows=integers(1, rows), rooms_doors=_range(rng, 0, 0.9))
        .vary(rooms_door=_range(rng, 1.4, 2.4), rooms_thickness=_range(rng, 0.05, 0.6), n_agents=integers(4, 7))
    )


def _pillars(rng: np.random.Generator) -> Scenario:
    big = outlast.role(1, agents_radius=_range(rng, 0.5, 1.0), agents_density=2.0)
    small = outlast.role(agents_radius=_range(rng, 0.1, 0.5))
    most = _between(rng, 0.6, 3)
    return (
        _game("ffa_4", rng, boxes_dynamic=True, boxes_offset=0.0)
        .with_(systems.Pillars(least=0.1, most=most, gap=_between(rng, 1.3, 2.5)))
        .roles(big=big, small=small, drawn="anyone")
        .vary(pillars_count=integers(1, int(rng.integers(2, 16))), pillars_least=_range(rng, 0.1, 0.5))
    )


def _plans(rng: np.random.Generator) -> Scenario:
    """Games with blocks anywhere, even across each other, and a start area for each team."""
    game = _game("teams_4", rng, ending_rule="never", ending_limit=60)
    width, height = game.numbers()["room_width"], game.numbers()["room_height"]

    def block() -> tuple[float, ...]:
        sides = rng.uniform(0.02, 0.25, 2) * (width, height)
        far = np.hypot(*sides) / 2
        x, y = ((side / 2 - far) * rng.uniform(-1, 1) for side in (width, height))
        return float(x), float(y), float(sides[0]), float(sides[1]), float(rng.uniform(-4, 4))

    def plan() -> FloorPlan:
        areas = [(side, (side - 0.5) * width * 0.6, 0.0, width * 0.3, height * 0.8) for side in (0, 1)]
        return FloorPlan([block() for _ in range(int(rng.integers(1, BLOCKS - 1)))], areas)

    plans = [plan() for _ in range(4)]
    layouts = choice(*(each.layout(BLOCKS + 2) for each in plans))
    walls, back = plans[0].mechanic(BLOCKS + 2), systems.Respawn(ticks=int(rng.integers(1, 20)))
    return game.with_(walls, back).vary(walls_layout=layouts, agents_radius=_range(rng, 0.2, 0.5))


KINDS = {"mazes": _mazes, "rooms": _rooms, "pillars": _pillars, "plans": _plans}


class LevelChecker:
    """What must hold in random levels, checked in all worlds after each reset and step.

    Attributes:
        floors: For how many more worlds to find out whether all of the floor can be reached.
        resets: Episodes whose start was checked.
        returns: Agents that came back.
        deep: Ticks of agents that were deeper than SLOP in a block, or in a wall of the room.
        ticks: Ticks of agents that were checked.
    """

    def __init__(self, env: SurvivalVectorEnv, floors: int) -> None:
        self.env, self.floors = env, floors
        self.resets = self.returns = self.deep = self.ticks = 0
        rows = env.worlds.layout.rows
        self.agents, self.blocks, self.spawned = rows(Side), rows(Wall), rows(Spawned)
        self.fixed = np.setdiff1d(rows(Solid), self.spawned)
        ahead = env.scenario.numbers().get("boxes_offset", 0.0)  # where boxes are set up, perhaps in a block
        dynamic = env.worlds[Solid].dynamic[0] != 0
        self.moving = self.agents if ahead else np.flatnonzero(dynamic)

    def check(self, rewards: Array | None = None) -> None:
        """Check after a step, or after a reset, which has no rewards."""
        started = np.flatnonzero(self.env.worlds[Clock].tick[:, 0] == 0)
        if started.size:
            self._starts_are_free(started)
        self._agents_are_in_the_room_and_not_in_blocks()
        self._absent_do_nothing(rewards)
        self._returned_touch_nothing()

    def _starts_are_free(self, started: Array) -> None:
        worlds = self.env.worlds
        self.resets += started.size
        bodies = [e for e in self.spawned if worlds[Entity].alive[started, e].any()]
        gaps = gap(worlds, started, bodies, [*self.fixed, *bodies])
        gaps[:, np.arange(len(bodies)), len(self.fixed) + np.arange(len(bodies))] = np.inf  # from each body to itself
        assert gaps.min(initial=np.inf) > 0.02 - 1e-3, np.unravel_index(gaps.argmin(), gaps.shape)
        present = worlds[Entity].identity >= 0
        agents = present[started][:, self.agents]
        assert (worlds[Entity].alive[started][:, self.agents].astype(bool) == agents).all()
        for w in started[: min(self.floors, 1)]:
            self.floors -= 1
            widest = worlds[Shape].radius[w, self.agents][present[w, self.agents]].max()
            parts = free_parts(worlds, int(w), float(widest), step=0.08)
            assert len(parts) == 1, (w, widest, parts)

    def _agents_are_in_the_room_and_not_in_blocks(self) -> None:
        worlds, everywhere = self.env.worlds, np.arange(self.env.num_worlds)
        alive = worlds[Entity].alive[:, self.agents].astype(bool)
        assert np.isfinite(worlds[Body].x[:, self.agents][alive]).all()
        gaps = gap(worlds, everywhere, self.agents, self.fixed)  # inf for dead agents
        assert deepest(worlds, self.moving, self.blocks) < 0, "the centre of a body is in a block"
        for place, side in zip((worlds[Body].x, worlds[Body].y), sides_of(worlds), strict=True):
            assert (abs(place[:, self.agents][alive]) < side / 2).all()
        deep = gaps.min(2) < -SLOP
        assert not deep[worlds[BoxesPlaced].boxes_placed[:, 0] == 0].any(), gaps.min()
        self.deep += int(deep.sum())
        self.ticks += int(alive.sum())

    def _absent_do_nothing(self, rewards: Array | None) -> None:
        worlds = self.env.worlds
        absent = worlds[Entity].identity < 0
        assert not worlds[Entity].alive[absent].any()
        assert (worlds[Side].side[:, self.agents][absent[:, self.agents]] == -1).all()
        assert not worlds[Bag].count[absent].any()
        items = worlds.layout.rows(Item)
        holders = worlds[Item].holder[:, items]
        assert (holders[absent[:, items]] == -1).all()
        assert not absent[np.arange(len(absent))[:, None], np.maximum(holders, 0)][holders >= 0].any()
        for kind in worlds.layout.events:
            entries = worlds.entries(kind)
            for name in (name for name, column in kind.columns.items() if column.unit == "entity"):
                rows = entries[name]
                assert not absent[entries["world"], rows][rows >= 0].any(), (kind, name)
        if rewards is not None:
            assert not rewards[absent[:, self.agents]].any()

    def _returned_touch_nothing(self) -> None:
        """This must hold before anything moved; boxes that were set up in the same tick came later and do not count."""
        if Return not in self.env.worlds:
            return
        worlds, back, placed = self.env.worlds, self.env.worlds.entries(Respawned), self.env.worlds.entries(BoxPlaced)
        for w, e in zip(back["world"].tolist(), back["agent"].tolist(), strict=True):
            late = placed["box"][placed["world"] == w]
            there = np.setdiff1d(worlds.layout.rows(Solid), [e, *late])
            gaps = gap(worlds, np.array([w]), [e], there, worlds[Before])
            assert gaps.min(initial=np.inf) > -1e-4, (w, e, gaps.min())
            self.returns += 1


def sides_of(worlds: Worlds) -> tuple[float, float]:
    """Width and height of the room, in metres."""
    room = next(module for module in worlds.modules if isinstance(module, systems.Room))
    return room.sides()


def deepest(worlds: Worlds, bodies: Any, blocks: Any) -> float:
    """How deep the middle of one of these bodies is in a block, metres; below 0 if it is in none."""
    one, two = (_bodies(worlds, np.arange(worlds.count), *each, None) for each in ((bodies, 2), (blocks, 1)))
    outside = _outside(two, one["place"] - two["place"])
    return -float(outside.min(initial=np.inf, where=one["alive"] & two["alive"]))


def gap(worlds: Worlds, where: Array, first: Any, second: Any, before: Any = None) -> Array:
    """Metres between bodies, along a side of one of them if both are rectangles; below 0 where they overlap.

    where: int (n,), worlds. first, second: rows. before: the table of Before, to take bodies that can move where they
    were before they did. Returns float64 (n, first, second); inf where one of the two is not there.
    """
    one, two = (_bodies(worlds, where, rows, axis, before) for rows, axis in ((first, 2), (second, 1)))
    away = two["place"] - one["place"]
    discs = abs(away) - one["radius"] - two["radius"]
    found = np.where((one["radius"] > 0) & (two["radius"] > 0), discs, _of_rectangles(one, two, away))
    for disc, other in ((one, two), (two, one)):
        mixed = _outside(other, away * (1 if other is one else -1)) - disc["radius"]
        found = np.where((disc["radius"] > 0) & (other["radius"] == 0), mixed, found)
    there: Array = np.where(one["alive"] & two["alive"], found, np.inf)
    return there


def _bodies(worlds: Worlds, where: Array, rows: Any, axis: int, before: Any) -> dict[str, Array]:
    """Columns of bodies, (worlds, rows), with an axis of length 1 at `axis` for the other bodies."""
    at, body, shape = np.ix_(where, np.asarray(rows, int)), worlds[Body], worlds[Shape]
    x, y = body.x[at], body.y[at]
    if before is not None:
        x, y = (np.where(worlds[Solid].dynamic[at], *pair) for pair in ((before.x[at], x), (before.y[at], y)))
    columns = {
        "place": x + 1j * y.astype(float),
        "turn": np.exp(1j * body.angle[at].astype(float)),
        "wide": shape.half_width[at].astype(float),
        "high": shape.half_height[at].astype(float),
        "radius": shape.radius[at].astype(float),
        "alive": worlds[Entity].alive[at].astype(bool),
    }
    return {name: np.expand_dims(column, axis) for name, column in columns.items()}


def _outside(rectangle: dict[str, Array], away: Array) -> Array:
    """Metres from the rims of rectangles to points that are `away` from their middles; below 0 inside."""
    local = away * rectangle["turn"].conj()
    beside, above = abs(local.real) - rectangle["wide"], abs(local.imag) - rectangle["high"]
    far = np.hypot(np.maximum(beside, 0), np.maximum(above, 0))
    return np.asarray(far + np.minimum(np.maximum(beside, above), 0))


def _of_rectangles(one: dict[str, Array], two: dict[str, Array], away: Array) -> Array:
    """The widest gap between two rectangles along their four axes."""
    gaps = []
    for axis in (one["turn"], 1j * one["turn"], two["turn"], 1j * two["turn"]):
        reach = sum(
            abs((each["turn"] * axis.conj()).real) * each["wide"]
            + abs((each["turn"] * axis.conj()).imag) * each["high"]
            for each in (one, two)
        )
        gaps.append(abs((away * axis.conj()).real) - reach)
    return np.asarray(np.max(np.broadcast_arrays(*gaps), axis=0))
