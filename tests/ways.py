"""Ways to run worlds which must all give the same bits, and how they are run beside each other."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from outlast import Scenario, make_vec, variant
from outlast.components import Body
from outlast.ecs import Entity
from outlast.envs.errors import FaultError
from tests.conftest import digest, scaled
from tests.digests import SEED, numbered_actions

BATCH = scaled(1024, least=14)
FEW = 7
SHORT: dict[str, Any] = {  # episodes of different lengths, all of them within 80 ticks
    "agents_health": 10, "safe_zone_radii": (9.0, 4.0), "safe_zone_stand": 10, "safe_zone_shrink": 10,
    "ending_limit": 60,
}  # fmt: skip
CHANCE = 0.03  # that something is done to a world in a tick, beside playing it
Actions = np.ndarray[Any, Any]


def short(name: str) -> Scenario:
    """A variant whose episodes are short."""
    return variant(name).replace(**SHORT)


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """The same arrays by the same names."""
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


class Way:
    """A way to run some worlds of the batch, which all began with the same seed.

    numbers: which worlds; the first `watched` of them are compared. `step` takes the actions of the whole batch.
    """

    compared_from = 0  # ticks

    def __init__(self, scenario: Scenario, numbers: Sequence[int], watched: int | None = None, **options: Any) -> None:
        self.numbers, self.rng = np.array(numbers), np.random.default_rng(SEED)
        self.env = make_vec(scenario, len(numbers), first_world=int(numbers[0]), **options)
        self.watched = self.numbers[:watched]
        self.env.reset(seed=SEED)

    def step(self, actions: Actions) -> None:
        self.env.step(actions[self.numbers])

    def digest(self) -> str:
        return digest(self.env.worlds, slice(0, len(self.watched)))


class Used(Way):
    """Another seed was played before. Right after a reset, notes of what is stale in the buffers may differ."""

    compared_from = 1

    def __init__(self, scenario: Scenario, numbers: Sequence[int]) -> None:
        super().__init__(scenario, numbers)
        self.env.reset(seed=SEED + 1)
        for tick in range(scaled(150, least=5)):
            self.env.step(numbered_actions(self.env, tick + 1000))
        self.env.reset(seed=SEED)


class Reordered(Way):
    """The worlds stand in the batch in another order."""

    def __init__(self, scenario: Scenario, numbers: Sequence[int]) -> None:
        super().__init__(scenario, numbers)
        self.numbers = self.watched = self.rng.permutation(self.numbers)
        self.env.set_state(self.env.get_state()[self.numbers])


class Restored(Way):
    """Now and then it goes astray for some ticks and is put back; or another environment goes on in its place."""

    def __init__(self, scenario: Scenario, numbers: Sequence[int]) -> None:
        super().__init__(scenario, numbers)
        self.other = Way(scenario, numbers, threads=2).env

    def step(self, actions: Actions) -> None:
        if self.rng.random() < CHANCE:
            state = self.env.get_state()
            for astray in range(self.rng.integers(4)):
                self.env.step(numbered_actions(self.env, astray))
            if self.rng.random() < 0.5:
                self.env, self.other = self.other, self.env
            self.env.set_state(state)
        super().step(actions)


class BesideNaN(Way):
    """Now and then something in the last world, which is not compared, becomes NaN; then that world is reset."""

    def __init__(self, scenario: Scenario, numbers: Sequence[int]) -> None:
        super().__init__(scenario, [*numbers, numbers[-1] + 1], watched=len(numbers))
        self.harmed, self.calm = np.arange(len(self.numbers)) == len(numbers), False

    def step(self, actions: Actions) -> None:
        if self.calm and self.rng.random() < CHANCE:
            self._harm()
        try:
            *_, terminated, truncated, _ = self.env.step(actions[self.numbers])
            self.calm = not (terminated | truncated)[-1]  # or the next step would reset it
        except FaultError:
            self.env.reset(options={"reset_mask": self.harmed})

    def _harm(self) -> None:
        """An agent that lives, as nobody looks at the dead."""
        alive = self.env.worlds[Entity].alive[-1, self.env.worlds.span("agent")]
        column = getattr(self.env.worlds[Body], self.rng.choice(["x", "vy", "omega"]))
        column[-1, alive.argmax()] = np.nan


def shuffled(scenario: Scenario) -> Scenario:
    """Its modules in another order."""
    order = np.random.default_rng(1).permutation(len(scenario.modules))
    return dataclasses.replace(scenario, modules=tuple(scenario.modules[k] for k in order))


def ways(scenario: Scenario) -> dict[str, Way]:
    """All of them, on worlds of a batch of BATCH."""
    few, middle = range(FEW), range(BATCH // 2, BATCH // 2 + FEW)
    portable = scenario.replace(physics_backend="portable")
    return {
        "the first world alone": Way(scenario, [0]),
        "a world alone": Way(scenario, [BATCH // 2 + 1]),
        "the last world alone": Way(scenario, [BATCH - 1]),
        "another run": Way(scenario, few),
        "two threads": Way(scenario, few, threads=2),
        "three threads": Way(scenario, middle, threads=3),
        "five threads": Way(scenario, few, threads=5),
        "modules in another order": Way(shuffled(scenario), few),
        "the portable backend": Way(portable, few),
        "after other episodes": Used(scenario, few),
        "worlds in another order": Reordered(scenario, few),
        "saved and restored": Restored(scenario, few),
        "beside a world with NaN": BesideNaN(scenario, few),
    }


def lockstep(scenario: Scenario, ticks: int) -> None:
    """Play all ways beside one large batch; after each tick they are equal to the bit."""
    batch, runs = Way(scenario, range(BATCH)), ways(scenario)
    for tick in range(ticks):
        if tick:
            actions = numbered_actions(batch.env, tick)
            for way in (batch, *runs.values()):
                way.step(actions)
        whole: dict[bytes, str] = {}  # digests of worlds of the batch, by their numbers
        for name, way in ((name, way) for name, way in runs.items() if tick >= way.compared_from):
            key = way.watched.tobytes()
            if key not in whole:
                whole[key] = digest(batch.env.worlds, way.watched)
            assert way.digest() == whole[key], f"{name}, tick {tick}: {unlike(batch, way)}"


def unlike(batch: Way, way: Way) -> str:
    """Which column of which component differs, or all that can be said."""
    for component in batch.env.worlds.components:
        for column in component.columns:
            whole, own = (getattr(each.env.worlds[component], column) for each in (batch, way))
            if whole[way.watched].tobytes() != own[: len(way.watched)].tobytes():
                return f"{component.__name__}.{column} differs"
    return "some byte between the columns differs"
