"""Coins lie around, and mud in the middle slows agents down: the game of `outlast new`, with other rules."""

from dataclasses import dataclass

import outlast
from outlast import systems
from outlast.components import Body, Look, Phase, Reward, Shape, Side, Spawned
from outlast.ecs import Archetype, Component, Entity, Module, Rows, Write, number, ref
from outlast.queries import Bodies, overlap
from outlast.systems.observation_rows import rows


class Coin(Component):
    """A coin on the floor, alive until an agent takes it."""


@dataclass(frozen=True)
class Coins(Module):
    """Coins at random places. The agent that touches one takes it, and is paid."""

    count: int = number(6, low=1, high=14, about="number of coins")
    pay: float = number(1.0, unit="reward", about="for a coin")

    def archetypes(self):
        return [Archetype("coin", (Body(), Shape(radius=0.25), Spawned(), Coin()), ref("count"))]

    def singletons(self):
        return [Reward(), CoinRows()]

    def dims(self):
        return {"coins": ref("count")}

    def looks(self):
        return {"coin": Look(color=(240, 200, 0))}


@Coins.system(Phase.COLLECT)
def take(
    entities: Write[Entity], reward: Write[Reward], coins: Rows[Coin], agents: Rows[Side], bodies: Bodies, pay: float
) -> None:
    for e in coins:
        for i in range(agents.size):
            if entities.alive[e] and overlap(bodies, agents[i], e):
                entities.alive[e] = 0
                reward.reward[i] += pay


CoinRows = rows(Coins, "coins", Coin, x=Body.x, y=Body.y)  # what agents see of coins


class Mud(Component):
    """A circle of mud on the floor."""


@dataclass(frozen=True)
class MudPatch(Module):
    """Mud in the middle of the room. Agents in it are slow."""

    drag: float = number(0.8, low=0, high=1, about="share of its speed that an agent in the mud loses")

    def archetypes(self):
        return [Archetype("mud", (Body(), Shape(radius=1.5), Mud()), 1, order=70)]  # kinds without an order lie above

    def looks(self):
        return {"mud": Look(color=(160, 120, 80))}


@MudPatch.system(Phase.DRIVE, after=Body)  # after the steering has set the speed
def slow_down(body: Write[Body], mud: Rows[Mud], agents: Rows[Side], bodies: Bodies, drag: float) -> None:
    for e in agents:
        if overlap(bodies, e, mud[0]):
            body.vx[e] *= 1 - drag
            body.vy[e] *= 1 - drag


COINS = outlast.Scenario(
    "coins",
    (
        systems.Agents(count=2),
        systems.FreeForAll(),
        systems.Room(size=8.0),
        systems.SpawnGrid(cells=4),
        systems.Steering(),
        systems.Physics(),
        systems.Ending(rule="never", limit=300),
        systems.Record(),
        Coins(),
        MudPatch(),
    ),
)
