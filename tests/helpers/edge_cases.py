"""Degenerate worlds for hypothesis: places on a coarse grid, right angles, slivers, full bags, the dead, the void.

On the grid float32 is exact, so that edges of all kinds are hit to the bit: rims, corners, equal distances, the very
same place. A sketch says what is where in plain numbers; `build` sets it up.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st

from outlast.components import Body, Box, Guard, Health, Weapon, Zone
from outlast.ecs import Clock, Entity
from tests.helpers.naive_mechanics import zone_at
from tests.helpers.naive_world import read
from tests.helpers.scenario_builder import ScenarioBuilder

AGENTS, HEALS, BOXES = 4, 6, 2
SLOTS = 4
grid = st.integers(-3, 3).map(lambda k: k / 2)  # metres
place = st.tuples(grid, grid)
sizes = st.sampled_from([(0.003, 0.003), (0.003, 4.0), (0.1, 0.1), (1.0, 1.0), (1.0, 3.0), (2.0, 2.0), (4.0, 4.0)])
# Around these ticks the zone stands, begins to shrink, is a point or void; on the grid its rim is met to the bit.
ticks = st.sampled_from([0, 99, 150, 600, 650, 699, 800, 1300, 1398, 1399, 1400, 1401, 1700])
PLACES = [(0.0, 0.0), (3.0, 4.0), (4.0, 3.0), (5.0, 0.0), (0.0, 4.0), (-3.0, -4.0)]  # some on rims of zones around 0


@dataclass(frozen=True)
class Agent:
    place: tuple[float, float]
    quarters: int  # how often it has turned by a right angle
    health: int
    alive: bool
    wait: int
    acts: tuple[int, int, int]  # attack, use, give


@dataclass(frozen=True)
class Prop:
    """A heal, or a box in one of its states. holder: the agent that carries it, if it lives and has room."""

    state: str
    place: tuple[float, float]
    size: tuple[float, float] = (1.0, 1.0)
    holder: int = 0
    owner: int = -1


@dataclass(frozen=True)
class Sketch:
    tick: int
    agents: list[Agent]
    heals: list[Prop]
    boxes: list[Prop]


def _some(count: int, kind: Any) -> Any:
    return st.lists(kind, min_size=count, max_size=count)


anywhere = place | st.sampled_from(PLACES)
agents = st.builds(
    Agent,
    anywhere,
    st.integers(0, 3),
    st.sampled_from([100, 5, 20, 1, 0, -3]),
    st.sampled_from([True, True, True, False]),
    st.sampled_from([0, 0, 0, 1]),
    st.tuples(*[st.sampled_from([1, 1, 0])] * 3),
)
holders = st.integers(0, AGENTS - 1)
heals = st.builds(Prop, st.sampled_from(["ground", "bag", "bag", "gone"]), anywhere, holder=holders)
boxes = st.builds(
    Prop,
    st.sampled_from(["stands"] * 5 + ["broken", "ground", "bag"]),
    anywhere,
    sizes,
    holders,
    st.sampled_from([-1, -1, 0, 1]),
)
hoard = holders.map(lambda holder: [Prop("bag", (0.0, 0.0), holder=holder)] * HEALS)
sketches = st.builds(Sketch, ticks, _some(AGENTS, agents), _some(HEALS, heals) | hoard, _some(BOXES, boxes))


def at(x: float, y: float, acts: str = "", quarters: int = 0, health: int = 100, alive: bool = True) -> Agent:
    """An agent at a place that does what `acts` says, as in "attack give"."""
    attack, use, give = (int(act in acts) for act in ("attack", "use", "give"))
    return Agent((x, y), quarters, health, alive, 0, (attack, use, give))


def case(*agents: Agent, heals: tuple[Prop, ...] = (), boxes: tuple[Prop, ...] = (), tick: int = 0) -> Sketch:
    """A sketch with these; all other agents stand aside, all other things do not exist."""
    corners = [at(-9, -9), at(9, -9), at(9, 9), at(-9, 9)]
    nowhere = Prop("gone", (0.0, 0.0))
    return Sketch(
        tick,
        [*agents, *corners[len(agents) :]],
        [*heals, *[nowhere] * (HEALS - len(heals))],
        [*boxes, *[nowhere] * (BOXES - len(boxes))],
    )


def carried(holder: int, count: int = 1) -> tuple[Prop, ...]:
    return (Prop("bag", (0.0, 0.0), holder=holder),) * count


CASES = {
    "takers equally near": case(at(0, 0, "give"), at(1, 0), at(-1, 0), at(0, 1), heals=carried(0)),
    "takers equally near, the other way round": case(at(1, 0), at(-1, 0), at(0, 1), at(0, 0, "give"), heals=carried(3)),
    "a taker exactly in reach": case(at(0, 0, "give"), at(2, 0), heals=carried(0)),
    "a taker at the very same place": case(at(0, 0, "give"), at(0, 0), heals=carried(0)),
    "all give and are full": case(*[at(0, y, "give use") for y in (0, 1, 2, 3)], heals=carried(0, 4) + carried(1, 2)),
    "a strike that begins on a rim": case(at(0, 0, "attack"), at(1.5, 0), heals=(Prop("ground", (0.25, 0)),)),
    "a strike that leaves from a rim": case(at(0, 0, "attack"), at(1.5, 0), heals=(Prop("ground", (-0.25, 0)),)),
    "a strike that ends on a rim": case(at(0, 0, "attack"), at(0, 0, "attack", 1), at(2.5, 0), at(0, 2.5)),
    "a strike that touches": case(at(0, 0, "attack"), at(2, 0.5), at(1, -0.5)),
    "a strike from inside of another": case(at(0, 0, "attack"), at(0.25, 0), at(0, 0.25), at(1, 0)),
    "a strike along an edge": case(at(0, 0, "attack"), boxes=(Prop("stands", (1.5, 0.5)),)),
    "a strike that ends on an edge": case(at(0, 0, "attack"), boxes=(Prop("stands", (2.5, 0)),)),
    "a strike from an edge": case(at(0, 0, "attack"), at(1.5, 0), boxes=(Prop("stands", (0.5, 0)),)),
    "a strike on a sliver": case(at(0, 0, "attack"), boxes=(Prop("stands", (1.5, 0), (0.003, 0.003)),)),
    "two at equal distance": case(at(0, 0, "attack"), at(1.5, 0), at(1.5, 0)),
    "on the rim of the zone": case(at(3, 4), at(4, -3), at(-5, 0), at(0, 5.5), tick=600),
    "on the rim of the next zone": case(at(4, 0), at(0, 4.5), tick=799),
    "the zone is a point": case(at(0, 0), at(1, 0), tick=1399),
    "the void": case(at(0, 0, health=1), at(4, 4, health=1), tick=1400),
    "all dead": case(*[at(x, 0, alive=False) for x in range(4)]),
    "all die": case(*[at(3.0 * x, 0, health=0) for x in range(4)], heals=carried(0, 3) + carried(2, 3)),
    "all die but for a heal": case(*[at(3.0 * x, 0, "use", health=0) for x in range(4)], heals=carried(1)),
    "all at one place": case(*[at(0, 0, "attack give", k) for k in range(4)], heals=(Prop("ground", (0, 0)),) * 6),
    "an item between two": case(at(0, 0), at(1, 0), heals=(Prop("ground", (0.5, 0)),)),
    "a box on an agent": case(at(0, 0, "use"), boxes=(Prop("bag", (0, 0), (1, 1), 0),)),
    "two boxes on one": case(at(0, 0, "use"), at(0, 0, "use"), boxes=carried(0) + carried(1)),
    "boxes break into one place": case(boxes=(Prop("broken", (1, 1)), Prop("broken", (1, 1)))),
}  # fmt: skip


def build(sketch: Sketch, variant: str, **numbers: Any) -> ScenarioBuilder:
    """The sketch as a world, before a tick."""
    agents = {"n_agents": AGENTS} if variant.startswith("ffa") else {}
    game = ScenarioBuilder(variant, n_heals=HEALS, n_boxes=BOXES, **agents | numbers)
    game.column(Clock).tick[:], game.column(Clock).episode[:] = sketch.tick, 1  # always the same random numbers
    for k, agent in enumerate(sketch.agents):
        _put_agent(game, k, agent, sketch.tick)
    for k, box in enumerate(sketch.boxes):
        _put_box(game, k, box)
    for k, heal in enumerate(sketch.heals):
        _put_item(game, "heal", k, heal)
    zone = game.column(Zone)
    zone.centres[:] = 0
    for column, value in zip(zone[:6], zone_at(read(game.env, 0), sketch.tick), strict=True):
        column[:] = value
    return game


def _put_agent(game: ScenarioBuilder, k: int, agent: Agent, tick: int) -> None:
    game.put("agent", k, *agent.place, agent.quarters * math.pi / 2)
    body, health = game.column(Body), game.column(Health)
    for column in (body.cosine, body.sine):
        column[0, k] = np.round(column[0, k])  # else a right angle would be off in the last bit
    game.column(Entity).alive[0, k] = agent.alive
    health.points[0, k] = agent.health if agent.alive else min(agent.health, 0)
    health.damage_type[0, k], health.source[0, k] = 0, -1
    health.fatal_tick[0, k] = tick if health.points[0, k] <= 0 else -1
    game.column(Weapon).cooldown[0, k] = agent.wait


def _put_box(game: ScenarioBuilder, k: int, box: Prop) -> None:
    game.put("box", k, *box.place, size=box.size)
    row = game.row("box", k)
    game.column(Entity).alive[0, row] = box.state == "stands"
    game.column(Box).broken[0, row] = box.state == "broken"
    game.column(Guard).vulnerable_only_to[0, row] = box.owner
    _put_item(game, "box_item", k, box)


def _put_item(game: ScenarioBuilder, kind: str, k: int, item: Prop) -> None:
    """On the ground, or in a bag; what does not fit, or whose holder is dead, is gone."""
    row, holder = game.row(kind, k), item.holder
    body = game.column(Body)
    body.x[0, row], body.y[0, row] = item.place
    game.column(Entity).alive[0, row] = item.state == "ground"
    fits = len(game.bag(holder)) < SLOTS and game.column(Entity).alive[0, holder]
    if item.state == "bag" and fits:
        game.hand(holder, kind, k)
