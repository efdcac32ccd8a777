"""One emptied world of a variant, in which tests place agents and items and give agents their actions."""

import functools
import math
from typing import Any

import numpy as np

import outlast
from outlast.components import Bag, Body, Box, Died, Health, Item, Shape, Zone
from outlast.ecs import Clock, Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv

IDLE = (1, 1, 1, 0, 0, 0)
ACTIONS = {"ahead": (0, 2), "left": (1, 2), "turn": (2, 2), "attack": (3, 1), "use": (4, 1), "give": (5, 1)}
CORNERS = ((-7, -7), (-7, 7), (7, -7), (7, 7))  # far apart, in the first zone


@functools.cache
def _environment(variant: str, numbers: frozenset[tuple[str, Any]]) -> SurvivalVectorEnv:
    return outlast.make_vec(outlast.variant(variant).replace(**dict(numbers)), 1, seed=0)


class ScenarioBuilder:
    """A world whose agents idle in the corners; heals and boxes are nowhere until they are put somewhere."""

    def __init__(self, variant: str = "ffa_4", **numbers: Any) -> None:
        numbers = {"n_heals": 6} | ({"n_boxes": 2} if "boxes" in outlast.variant(variant) else {}) | numbers
        self.env = _environment(variant, frozenset(numbers.items()))
        self.env.reset()
        self.rewards: list[float] = []
        self.done = False
        self.observation: dict[str, np.ndarray] = {}
        for kind in ("heal", "box", "box_item"):
            self.column(Entity).alive[0, self.env.worlds.span(kind)] = 0
        for agent, (x, y) in enumerate(CORNERS[: self.env.num_agents]):
            self.put("agent", agent, x, y)

    def column(self, component: type) -> Any:
        """The table of a component."""
        return self.env.worlds[component]

    def row(self, kind: str, index: int) -> int:
        return int(self.env.worlds.span(kind).start + index)

    def put(
        self, kind: str, index: int, x: float, y: float, angle: float = 0.0, size: tuple[float, float] = (1, 1)
    ) -> None:
        """Put an agent, an item or a box there, at rest; `size` is that of a box."""
        row, body, shape = self.row(kind, index), self.column(Body), self.column(Shape)
        body.x[0, row], body.y[0, row], body.angle[0, row] = x, y, angle
        body.cosine[0, row], body.sine[0, row] = np.cos(np.float32(angle)), np.sin(np.float32(angle))
        body.vx[0, row] = body.vy[0, row] = body.omega[0, row] = 0
        if kind == "box":
            shape.half_width[0, row], shape.half_height[0, row] = size[0] / 2, size[1] / 2
            shape.bound[0, row] = np.hypot(*size) / 2 + 1e-5
        self.column(Entity).alive[0, row] = 1

    def hand(self, agent: int, kind: str, index: int) -> None:
        """Put an item into an agent's bag, as the last one."""
        bag, row = self.column(Bag), self.row(kind, index)
        bag.items[0, agent, bag.count[0, agent]] = row
        bag.count[0, agent] += 1
        self.column(Item).holder[0, row] = agent
        self.column(Entity).alive[0, row] = 0

    def wound(self, agent: int, points: int) -> None:
        """Leave an agent with `points` hit points."""
        self.column(Health).points[0, agent] = points

    def step(self, acts: dict[int, str] | None = None, times: int = 1) -> "ScenarioBuilder":
        """Step `times` ticks, in which agents do what `acts` says, as in {0: "ahead attack"}, and all others idle."""
        actions = np.tile(np.array(IDLE), (1, self.env.num_agents, 1))
        for agent, words in (acts or {}).items():
            for word in words.split():
                actions[0, agent, ACTIONS[word][0]] = ACTIONS[word][1]
        for _ in range(times):
            assert not self.done
            self.observation, rewards, terminated, _, _ = self.env.step(actions)
            self.rewards, self.done = rewards[0].tolist(), bool(terminated[0])
        return self

    def state(self, agent: int) -> list[float]:
        """x, y, angle, vx, vy, omega of an agent."""
        return [float(column[0, agent]) for column in (*self.column(Body)[:3], *self.column(Body)[5:])]

    def health(self, agent: int) -> int:
        return int(self.column(Health).points[0, agent])

    def here(self, kind: str, index: int) -> bool:
        return bool(self.column(Entity).alive[0, self.row(kind, index)])

    def place(self, kind: str, index: int) -> tuple[float, float]:
        row = self.row(kind, index)
        return float(self.column(Body).x[0, row]), float(self.column(Body).y[0, row])

    def bag(self, agent: int) -> list[int]:
        """Rows of the items that an agent carries, in the order of the bag."""
        return self.column(Bag).items[0, agent, : self.column(Bag).count[0, agent]].tolist()

    def death(self, agent: int) -> tuple[str, int]:
        """What killed an agent, and which side did."""
        death = self.column(Died)
        return self.env.worlds.layout.labels["damage_type"][death.damage_type[0, agent]], int(death.source[0, agent])

    def sees(self, agent: int, key: str) -> list[int]:
        """The mask of a key that an agent observes."""
        return self.observation[f"{key}_mask"][0, agent].astype(int).tolist()

    @property
    def tick(self) -> int:
        return int(self.column(Clock).tick[0, 0])

    @property
    def zone(self) -> list[float]:
        return [float(column[0, 0]) for column in self.column(Zone)[:6]]

    @property
    def broken(self) -> list[int]:
        return self.column(Box).broken[0, self.env.worlds.span("box")].tolist()


def duel(game: ScenarioBuilder, far: float = 2.0) -> ScenarioBuilder:
    """Put agent 0 at the origin, looking at agent 1, which looks back."""
    game.put("agent", 0, 0, 0)
    game.put("agent", 1, far, 0, math.pi)
    return game


def mates(game: ScenarioBuilder) -> ScenarioBuilder:
    """Let two teams face each other: agents 0 and 1 on the left, 2 and 3 on the right."""
    for agent, (x, y) in enumerate(((-1, 0), (-1, 5), (1, 0), (1, 5))):
        game.put("agent", agent, x, y, math.pi if x > 0 else 0.0)
    return game
