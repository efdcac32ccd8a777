"""One world as plain Python objects: what the naive forms take, what they give back, and how the two are compared."""

import copy
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from outlast.components import (  # isort: skip
    Bag, Body, Box, BoxesPlaced, Died, Episode, Guard, HealsUsed, Health, Item, Kills, Shape, Side, Weapon, Zone,
)  # fmt: skip
from outlast.ecs import Clock, Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv

TOLERANCE = 2e-5  # what float32 may lose of metres, radians and shares in a room of 25 metres


class Loss(NamedTuple):
    """Hit points lost at once."""

    tick: int
    damage_type: int
    side: int
    before: int
    after: int


@dataclass
class NaiveEntity:
    """One row of the tables: an agent, a box, an item or a wall."""

    row: int
    kind: str
    index: int  # among its kind
    here: bool
    x: float
    y: float
    angle: float
    vx: float
    vy: float
    omega: float
    radius: float
    half_width: float
    half_height: float
    health: int | None = None  # None: it has no health
    damage_type: int = -1
    source: int = -1
    losses: list[Loss] = field(default_factory=list)
    side: int = -1
    owner: int = -1
    broken: bool = False
    placed: bool = False  # a box that was set up from its item
    wait: int = 0
    bag: list[int] = field(default_factory=list)
    holder: int = -1


@dataclass
class World:
    """One world. statistics: Those of the episode so far. deaths: (agent, damage type, side) of each in this tick."""

    entities: list[NaiveEntity]
    tick: int
    numbers: dict[str, Any]
    damage_types: list[str]
    centres: list[tuple[float, float]]
    zone: list[float]
    deaths: list[tuple[int, int, int]]
    statistics: dict[str, Any]
    key: tuple[int, int, int]  # of its random numbers: seed, world, episode
    used: list[int] = field(default_factory=list)  # items used in this tick
    fallen: list[tuple[int, int]] = field(default_factory=list)  # (item, agent that dropped it dying) in this tick
    seen: list[set[int]] = field(default_factory=list)  # by agent: rows that its camera sees
    by_role: dict[str, list[Any]] = field(default_factory=dict)  # numbers that differ by role, by agent

    def of(self, *kinds: str) -> list[NaiveEntity]:
        return [entity for entity in self.entities if entity.kind in kinds]

    def live(self, *kinds: str) -> Iterator[NaiveEntity]:
        return (entity for entity in self.of(*kinds) if entity.here)

    def own(self, agent: NaiveEntity) -> dict[str, Any]:
        """The numbers of an agent."""
        return self.numbers | {name: values[agent.index] for name, values in self.by_role.items()}

    @property
    def teams(self) -> bool:
        return "teams_count" in self.numbers

    @property
    def sides(self) -> int:
        return self.numbers["teams_count"] if self.teams else len(self.of("agent"))

    def copy(self) -> "World":
        return copy.deepcopy(self)


def read(env: SurvivalVectorEnv, w: int) -> World:
    """World `w` of the environment as it stands in the tables."""
    tables = env.worlds
    body, shape, health, guard = (_rows(tables[c], w) for c in (Body, Shape, Health, Guard))
    side, weapon, item, bag = (_rows(tables[c], w) for c in (Side, Weapon, Item, Bag))
    boxes = _rows(tables[Box], w) if Box in tables else {name: [0] * tables.dims["rows"] for name in Box.columns}
    alive = tables[Entity].alive[w].tolist()
    entities = []
    for kind, span in tables.layout.spans.items():
        for index, row in enumerate(span):
            entity = NaiveEntity(
                row,
                kind,
                index,
                alive[row] == 1,
                *(body[name][row] for name in ("x", "y", "angle", "vx", "vy", "omega")),
                *(shape[name][row] for name in ("radius", "half_width", "half_height")),
            )
            if kind in ("agent", "box"):
                entity.health, entity.damage_type, entity.source = (
                    health[name][row] for name in ("points", "damage_type", "source")
                )
                entity.losses = _past(entity, health["fatal_tick"][row])
            if kind == "agent":
                entity.side, entity.wait = side["side"][row], weapon["cooldown"][row]
                entity.bag = bag["items"][row][: bag["count"][row]]
            entity.owner, entity.holder = guard["vulnerable_only_to"][row], item["holder"][row]
            entity.broken, entity.placed = boxes["broken"][row] == 1, boxes["placed"][row] == 1
            entities.append(entity)
    zone, clock = _rows(tables[Zone], w), _rows(tables[Clock], w)
    return World(
        entities,
        int(clock["tick"][0]),
        env.scenario.numbers(),
        tables.layout.labels["damage_type"],
        [tuple(centre) for centre in zone.pop("centres")],
        [value[0] for value in zone.values()],
        _deaths(env, w),
        _statistics(env, w),
        (int(clock["seed"][0]), int(clock["world"][0]), int(clock["episode"][0])),
        by_role={name: values[w].tolist() for name, values in tables.agent_numbers().items()},
    )


def differences(got: World, want: World, kinds: tuple[str, ...], *columns: str) -> list[str]:
    """Where the entities of these kinds differ, in words."""
    found = []
    for one, other in zip(got.of(*kinds), want.of(*kinds), strict=True):
        for column in columns:
            a, b = getattr(one, column), getattr(other, column)
            if abs(a - b) > TOLERANCE if isinstance(b, float) else a != b:
                found.append(f"{one.kind} {one.index}: {column} is {a}, the naive one's {b}")
    return found


def _rows(table: Any, w: int) -> dict[str, list[Any]]:
    return {name: getattr(table, name)[w].tolist() for name in table._fields}


def _past(entity: NaiveEntity, fatal_tick: int) -> list[Loss]:
    """What must have happened to it: the blow that brought its health to 0 or below, else its last blow."""
    kind, side, points = entity.damage_type, entity.source, entity.health
    if points <= 0:
        return [Loss(fatal_tick, kind, side, 1, points)]
    return [Loss(-1, kind, side, points + 1, points)] if kind >= 0 else []


def _deaths(env: SurvivalVectorEnv, w: int) -> list[tuple[int, int, int]]:
    death = _rows(env.worlds[Died], w)
    return [(i, death["damage_type"][i], death["source"][i]) for i in range(env.num_agents) if death["now"][i]]


def _statistics(env: SurvivalVectorEnv, w: int) -> dict[str, Any]:
    found = _rows(env.worlds[Episode], w) | _rows(env.worlds[Kills], w) | _rows(env.worlds[HealsUsed], w)
    if BoxesPlaced in env.worlds:
        found |= _rows(env.worlds[BoxesPlaced], w)
    single = ("length", "first_death", "heals_used", "boxes_placed")
    return {key: value[0] if key in single else value for key, value in found.items()}
