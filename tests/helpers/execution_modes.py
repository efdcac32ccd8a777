"""Modes of execution that must give the same bits, and how they are compared tick by tick."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from outlast import Scenario, make_vec, role, variant
from outlast.components import Body
from outlast.distributions import integers
from outlast.ecs import RESET, STEP, Entity
from outlast.ecs.checks import trial
from outlast.ecs.checks.traced import Traced
from outlast.ecs.compilation.tick import in_python, segments
from outlast.ecs.kernels.jit import interpreted
from outlast.ecs.memory.tables import Tables
from outlast.envs.errors import FaultError
from outlast.systems import Maze
from tests.conftest import digest, draw_actions, few_by_day, scaled
from tests.digests import SEED, numbered_actions

BATCH = scaled(1024, least=14)
FEW = 7
SHORT: dict[str, Any] = {  # episodes of different lengths, all of them within 80 ticks
    "agents_health": 10, "safe_zone_radii": (9.0, 4.0), "safe_zone_stand": 10, "safe_zone_shrink": 10,
    "ending_limit": 60,
}  # fmt: skip
HUNT = "one against three"  # unequal teams, with roles
COUNTS, ROLES, MAZE, ALL = "other counts", "roles that are drawn", "a maze", "other counts, roles and a maze"
LEVELS = (COUNTS, ROLES, MAZE, ALL)  # what differs from world to world and from episode to episode
EACH_LEVEL = few_by_day(LEVELS, (ALL,))  # parameters of tests
PROBABILITY = 0.03  # of an intervention, in each tick
Actions = np.ndarray[Any, Any]


def short(name: str) -> Scenario:
    """A variant, HUNT or one of LEVELS with short episodes; all but the variants have four agents, or up to four."""
    if name == HUNT:
        hunter, prey = role(1, melee_damage=8, cameras_depth=14, agents_radius=0.7, agents_health=20), role(3)
        return variant("teams_3").replace(teams_sizes=(1, 3), **SHORT).roles(hunter=hunter, prey=prey, observed=False)
    scenario = variant("teams_3" if name in LEVELS else name).replace(**SHORT)
    if name in (COUNTS, ALL):
        scenario = scenario.vary(n_agents=integers(2, 4), n_heals=integers(1, 15), n_boxes=integers(1, 8))
    if name in (ROLES, ALL):
        strong = role(1, melee_damage=integers(5, 8), agents_radius=0.7, agents_health=20)
        scenario = scenario.roles(strong=strong, other=role(), drawn="anyone")
    if name in (MAZE, ALL):
        scenario = scenario.with_(Maze(columns=4, rows=3))
    return scenario


def equal(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether both have the same arrays by the same names."""
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


def same(one: Any, other: Any, typed: bool = True) -> bool:
    """Whether dicts of dicts, arrays and arrays of dicts are equal, and of equal types if `typed`.

    Rows that a mask leaves out are compared, too: they must be empty.
    """
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key], typed) for key in one)
    if isinstance(one, np.ndarray) and one.dtype == object:
        return len(one) == len(other) and all(same(a, b, typed) for a, b in zip(one, other, strict=True))
    return (not typed or type(one) is type(other)) and np.array_equal(one, other)


class ExecutionMode:
    """A way to run some worlds of a batch, which all start from the same seed.

    world_numbers: Which worlds; the first `compared` of them are compared. `step` takes the actions of the whole batch.
    """

    compared_from = 0  # the first tick that is compared

    def __init__(
        self, scenario: Scenario, world_numbers: Sequence[int], compared: int | None = None, **options: Any
    ) -> None:
        self.world_numbers, self.rng = np.array(world_numbers), np.random.default_rng(SEED)
        self.env = make_vec(scenario, len(world_numbers), first_world=int(world_numbers[0]), **options)
        self.compared = self.world_numbers[:compared]
        self.env.reset(seed=SEED)

    def step(self, actions: Actions) -> None:
        self.env.step(actions[self.world_numbers])

    def digest(self) -> str:
        return digest(self.env.worlds, slice(0, len(self.compared)))


class AfterOtherEpisodes(ExecutionMode):
    """Another seed was played before. Right after a reset it is not compared, as dirty flags of buffers may differ."""

    compared_from = 1

    def __init__(self, scenario: Scenario, world_numbers: Sequence[int]) -> None:
        super().__init__(scenario, world_numbers)
        self.env.reset(seed=SEED + 1)
        for tick in range(scaled(150, least=5)):
            self.env.step(numbered_actions(self.env, tick + 1000))
        self.env.reset(seed=SEED)


class Reordered(ExecutionMode):
    """The worlds are in another order in the batch."""

    def __init__(self, scenario: Scenario, world_numbers: Sequence[int]) -> None:
        super().__init__(scenario, world_numbers)
        self.world_numbers = self.compared = self.rng.permutation(self.world_numbers)
        self.env.set_state(self.env.get_state()[self.world_numbers])


class Restored(ExecutionMode):
    """Now and then it plays other actions and is restored, or another environment goes on from its state."""

    def __init__(self, scenario: Scenario, world_numbers: Sequence[int]) -> None:
        super().__init__(scenario, world_numbers)
        self.other = ExecutionMode(scenario, world_numbers, threads=2).env

    def step(self, actions: Actions) -> None:
        if self.rng.random() < PROBABILITY:
            state = self.env.get_state()
            for tick in range(self.rng.integers(4)):
                self.env.step(numbered_actions(self.env, tick))
            if self.rng.random() < 0.5:
                self.env, self.other = self.other, self.env
            self.env.set_state(state)
        super().step(actions)


class BesideNaN(ExecutionMode):
    """Now and then a number of the last world, which is not compared, becomes NaN; then that world is reset."""

    def __init__(self, scenario: Scenario, world_numbers: Sequence[int]) -> None:
        super().__init__(scenario, [*world_numbers, world_numbers[-1] + 1], compared=len(world_numbers))
        self.harmed, self.may_harm = np.arange(len(self.world_numbers)) == len(world_numbers), False

    def step(self, actions: Actions) -> None:
        if self.may_harm and self.rng.random() < PROBABILITY:
            self._harm()
        try:
            *_, terminated, truncated, _ = self.env.step(actions[self.world_numbers])
            self.may_harm = not (terminated | truncated)[-1]  # else the next step would reset it
        except FaultError:
            self.env.reset(options={"reset_mask": self.harmed})

    def _harm(self) -> None:
        """Harm a living agent, as dead ones are not checked."""
        alive = self.env.worlds[Entity].alive[-1, self.env.worlds.span("agent")]
        column = getattr(self.env.worlds[Body], self.rng.choice(["x", "vy", "omega"]))
        column[-1, alive.argmax()] = np.nan


def shuffled(scenario: Scenario) -> Scenario:
    """The scenario with its modules in another order, which no Scenario has by itself: it sorts them."""
    order, made = np.random.default_rng(1).permutation(len(scenario.modules)), dataclasses.replace(scenario)
    object.__setattr__(made, "modules", tuple(scenario.modules[k] for k in order))
    return made


def execution_modes(scenario: Scenario, specialize: bool) -> dict[str, ExecutionMode]:
    """All modes by name, on worlds of a batch of BATCH. specialize: Also the mode with machine code of its own."""
    few, middle = range(FEW), range(BATCH // 2, BATCH // 2 + FEW)
    portable = scenario.replace(physics_backend="portable")
    alone = {"compiled for it alone": ExecutionMode(scenario, few, specialize=True)} if specialize else {}
    return alone | {
        "the first world alone": ExecutionMode(scenario, [0]),
        "a world alone": ExecutionMode(scenario, [BATCH // 2 + 1]),
        "the last world alone": ExecutionMode(scenario, [BATCH - 1]),
        "another run": ExecutionMode(scenario, few),
        "two threads": ExecutionMode(scenario, few, threads=2),
        "three threads": ExecutionMode(scenario, middle, threads=3),
        "five threads": ExecutionMode(scenario, few, threads=5),
        "modules in another order": ExecutionMode(shuffled(scenario), few),
        "the portable backend": ExecutionMode(portable, few),
        "after other episodes": AfterOtherEpisodes(scenario, few),
        "worlds in another order": Reordered(scenario, few),
        "saved and restored": Restored(scenario, few),
        "beside a world with NaN": BesideNaN(scenario, few),
    }


def lockstep(scenario: Scenario, ticks: int, specialize: bool = True) -> None:
    """Run all modes beside one large batch, and check that they are equal to the bit after each tick."""
    batch, runs = ExecutionMode(scenario, range(BATCH)), execution_modes(scenario, specialize)
    for tick in range(ticks):
        if tick:
            actions = numbered_actions(batch.env, tick)
            for mode in (batch, *runs.values()):
                mode.step(actions)
        whole: dict[bytes, str] = {}  # digests of worlds of the batch, by their numbers
        for name, mode in ((name, mode) for name, mode in runs.items() if tick >= mode.compared_from):
            key = mode.compared.tobytes()
            if key not in whole:
                whole[key] = digest(batch.env.worlds, mode.compared)
            assert mode.digest() == whole[key], f"{name}, tick {tick}: {first_difference(batch, mode)}"


def first_difference(batch: ExecutionMode, mode: ExecutionMode) -> str:
    """Say which column of which component differs, if one does."""
    for component in batch.env.worlds.components:
        for column in component.columns:
            whole, own = (getattr(each.env.worlds[component], column) for each in (batch, mode))
            if whole[mode.compared].tobytes() != own[: len(mode.compared)].tobytes():
                return f"{component.__name__}.{column} differs"
    return "some byte between the columns differs"


def python_digests(scenario: Scenario, ticks: int, stand_ins: bool) -> list[str]:
    """Digests of a world after each tick as Python, on plain arrays or with all compiled systems on stand-ins.

    What only machine code can do is left out.
    """
    worlds = scenario.worlds(1)
    tables, names, chosen = Tables(worlds.layout, 1), trial.PYTHON_ONLY, worlds.schedule.systems
    chosen = [system for system in chosen if not trial.python_refusal(system)]
    if stand_ins:
        chosen = [dataclasses.replace(s, kernel=Traced(s, worlds.layout, names)) if s.compiled else s for s in chosen]
    units = [unit for each in segments(worlds.layout, chosen, python=True) for unit in each.units]
    calls = [call for *_, call in in_python(units, tables)]
    rng, found = np.random.default_rng(SEED), list[str]()
    for tick in range(ticks):
        tables.mode[:] = STEP if tick else RESET
        tables.actions[:] = rng.integers(0, 2, tables.actions.shape)
        with interpreted():
            for call in calls:
                call()
        found.append(digest(tables))
    return found


def assert_stand_ins_change_nothing(scenario: Scenario, ticks: int) -> None:
    """And nothing is refused."""
    portable = scenario.replace(physics_backend="portable")
    assert python_digests(portable, ticks, stand_ins=True) == python_digests(portable, ticks, stand_ins=False)


def assert_played_alike(one: Scenario, other: Scenario, steps: int, worlds: int = 8) -> tuple[Any, Any]:
    """Check that by the same random actions observations, rewards and ends are equal; returns the environments."""
    envs, rng = [make_vec(scenario, worlds, seed=1) for scenario in (one, other)], np.random.default_rng(2)
    seen = [env.reset()[0] for env in envs]
    for _ in range(steps):
        assert equal(*seen)
        actions = draw_actions(envs[0], rng)
        (mine, *ends, _), (its, *others, _) = (env.step(actions) for env in envs)
        assert all(map(np.array_equal, ends, others))
        seen = [mine, its]
    return envs[0], envs[1]
