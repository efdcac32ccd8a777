"""A game of a few lines, to test the engine without the survival game: walkers on a line, food, and weather."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast import ecs
from outlast.components import DamageType

from outlast.ecs import (  # isort: skip
    RESET, SKIP, STEP, Action, Add, Archetype, Array, Clock, Component, Entity, Module, Observation, Random, Read, Rows,
    Scratch, Signal, Singleton, Statistic, When, Worlds, Write, column, number, ref,
)  # fmt: skip
from outlast.ecs.kernels.random import uniform

__all__ = ["RESET", "SKIP", "STEP"]


class Phase(ecs.PhaseBase):
    BEGIN = When.RESET, "all are placed"
    MOVE = When.STEP, "all have moved"
    FEED = When.STEP, "all have eaten"
    SHOW = When.ALWAYS, "everything is seen"


class Place(Component):
    x: Array = column("f4")
    trail: Array = column("i2", "memory", fill=-1)  # where it was, newest first


class Energy(Component):
    left: Array = column("i4", fill=10)


class Wind(Singleton):
    push: Array = column("f8", fill=0.5)
    damage_type: Array = column("i4", fill=-1)
    felt: Array = column("i4", "memory", 2)


class Pace(Action):
    pace: Array = column("i1", "walkers", low=-1, high=1)


class Line(Observation):
    line: Array = column("f4", "walkers", low=-100, high=100)


class Pay(Signal):
    pay: Array = column("f4", "walkers")


class Meals(Statistic):
    meals: Array = column("i4")


@dataclass(frozen=True)
class Toy(Module):
    """Base of the mechanics below."""


@dataclass(frozen=True)
class Walkers(Toy):
    count: int = number(3, low=1)
    stride: float = number(0.5, above=0, high=10)

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("walker", (Place(), Energy(left=20)), ref("count"))]

    def singletons(self) -> Iterable[Singleton]:
        return [Pace(), Line(), Pay()]

    def dims(self) -> dict[str, int | str]:
        return {"walkers": ref("count"), "memory": 2}


@Walkers.system(Phase.BEGIN)
def scatter(place: Write[Place], entities: Read[Entity], walkers: Rows[Energy], key: Random) -> None:
    for e in walkers:
        place.x[e] = 10 * uniform(key, entities.identity[e])


@Walkers.system(Phase.MOVE)
def walk(place: Write[Place], pace: Read[Pace], walkers: Rows[Energy], stride: float) -> None:
    for i in range(walkers.size):
        e = walkers[i]
        for k in range(place.trail.shape[1] - 1, 0, -1):
            place.trail[e, k] = place.trail[e, k - 1]
        place.trail[e, 0] = np.int16(place.x[e])
        place.x[e] += stride * pace.pace[i]


@Walkers.system(Phase.SHOW)
def show(place: Read[Place], line: Write[Line], pay: Write[Pay], clock: Read[Clock], walkers: Rows[Energy]) -> None:
    for i in range(walkers.size):
        line.line[i] = place.x[walkers[i]]
        pay.pay[i] = clock.tick[0]


@dataclass(frozen=True)
class Food(Toy):
    damage_type = "hunger"

    count: int = number(2, low=1)
    worth: int = number(3, low=0)

    def archetypes(self) -> Iterable[Archetype]:
        return [Archetype("food", (Place(x=[-1.0] * self.count),), self.count, alive=False)]

    def singletons(self) -> Iterable[Singleton]:
        return [Meals()]

    def dims(self) -> dict[str, int | str]:
        return {"memory": 1}


@Food.system(Phase.BEGIN, after="walkers.scatter")
def grow(place: Write[Place], entities: Write[Entity], rows: Rows[Place], count: int, key: Random) -> None:
    for e in rows:
        if not entities.alive[e]:
            place.x[e] = 10 * uniform(key, entities.identity[e])
            entities.alive[e] = 1


@Food.system(Phase.FEED)
def eat(
    place: Read[Place], meals: Add[Meals], energy: Add[Energy], walkers: Rows[Energy], rows: Rows[Place], worth: int
) -> None:
    for e in walkers:
        for o in rows:
            if o != e and abs(place.x[o] - place.x[e]) < 1:
                energy.left[e] += np.int32(worth)
                meals.meals[0] += 1


@dataclass(frozen=True)
class Weather(Toy):
    damage_type = "cold"

    gusts: tuple[float, ...] = number((0.25, -0.5), low=-1, high=1)
    wild: bool = number(True)
    sky: str = number("grey", choices=("blue", "grey", "black"))

    def singletons(self) -> Iterable[Singleton]:
        return [Wind()]

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return np.zeros((dims["rows"], 2), np.int64)


@Weather.system(Phase.MOVE, after="walkers.walk")
def blow(
    place: Write[Place],
    wind: Write[Wind],
    rows: Rows[Place],
    gusts: tuple[float, ...],
    wild: bool,
    sky: int,
    damage_type: DamageType,
    memory: Scratch,
    key: Random,
) -> None:
    wind.push[0] = uniform(key, 0)
    wind.damage_type[0] = damage_type
    wind.felt[0, 1] = sky
    memory[0, 0] += 1  # ticks of all worlds that this thread has seen
    for e in rows:
        if wild:
            place.x[e] += gusts[e % gusts.size] * wind.push[0]


@Weather.system(Phase.FEED)
def freeze(energy: Add[Energy], wind: Read[Wind], walkers: Rows[Energy]) -> None:
    for e in walkers:
        energy.left[e] -= np.int32(1)


GAME = (Walkers(), Food(), Weather())


def system_of(function: Any, **options: Any) -> Module:
    """A mechanic named "local" whose only system is this function, in phase FEED."""

    class Local(Toy):
        pass

    Local.system(Phase.FEED, **options)(function)
    return Local()


def make(
    *modules: Module, count: int = 4, threads: int = 1, seed: int = 0, first: int = 0, specialize: bool = False
) -> Worlds:
    """Worlds of `modules` (those of GAME by default), seeded and reset."""
    worlds = Worlds(modules or GAME, count, threads, specialize=specialize)
    worlds.seed(np.full(count, seed), first + np.arange(count))
    run(worlds, RESET)
    return worlds


def run(worlds: Worlds, *modes: Any) -> Worlds:
    """Run a tick for each mode: SKIP, STEP or RESET for all worlds, or a list with one for each world."""
    for mode in modes:
        worlds.run(np.full(worlds.count, mode, np.int8) if np.ndim(mode) == 0 else np.array(mode, np.int8))
    return worlds


def walked(worlds: Worlds, ticks: int, start: int = 0) -> Worlds:
    """Run ticks with random paces, which depend on the tick and on each world's number."""
    numbers = worlds[Clock].world[:, 0].astype(int)
    for tick in range(start, start + ticks):
        worlds[Pace].pace[:] = np.random.default_rng(tick).integers(-1, 2, (1000, 3))[numbers]
        run(worlds, STEP)
    return worlds
