"""The tasks: games of training and of tests, and budgets of both. Does not need PyTorch.

A name never changes meaning: a task whose game has changed gets another version, and a test pins each game.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs.declarations.distributions import Distribution, integers, uniform
from outlast.ecs.kernels.errors import did_you_mean
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import VARIANTS, variant
from outlast.systems import Behaviour, Lidar, Maze, Pillars, Rooms

from ..base.errors import TrainingError

PROTOCOL = 1  # version of the format of results and of the protocol
BUDGETS = {"10M": 10_000_000, "100M": 100_000_000}  # agent-steps of training, by track
RESPONSE = 5_000_000  # agent-steps of training of a best response
GAMES = 320  # games of a match, each in a world of its own
SEEDS = range(2**62, 2**62 + 64)  # seeds of the worlds of tests, one for each game of a match
LIDAR = Lidar(rays=16, depth=10.0)


@dataclass(frozen=True)
class TaskGame:
    """A game that agents are tested in.

    Attributes:
        name: "trained" for the game of training; otherwise the difference from it.
        scenario: The game: observations have the same shape in all games of a task.
        given: Numbers of the worlds in turn, by name: counts within the capacity of `scenario`, instead of drawn ones.
        seed: Seed of the worlds, the same for all agents.
    """

    name: str
    scenario: Scenario
    given: tuple[tuple[str, tuple[int, ...]], ...]
    seed: int

    def numbers(self, worlds: int) -> dict[str, np.ndarray[Any, Any]]:
        """Return the numbers given to each world, integers (worlds,) by name."""
        return {name: np.resize(values, worlds) for name, values in self.given}


@dataclass(frozen=True)
class Task:
    """A task.

    name: Name and version: "ffa_2-v1". games: Games of the tests: first the game of training and then, in tasks of
    generalisation, games outside of training.
    """

    name: str
    about: str
    scenario: Scenario
    games: tuple[TaskGame, ...]

    def game(self, name: str) -> TaskGame:
        """Return the game of that name."""
        return next(game for game in self.games if game.name == name)


def task_of(name: str) -> Task:
    """Return the task of that name. Raises a TrainingError that lists all tasks."""
    if name not in tasks():
        hint = did_you_mean(name, tasks(), after=" ")
        raise TrainingError(f"unknown task '{name}'; {hint}known: {', '.join(tasks())}")
    return tasks()[name]


def track_of(budget: int, games: int = GAMES) -> str:
    """Return the track of a budget of agent-steps and matches of `games` games; empty if it belongs to no track."""
    return next((name for name, steps in BUDGETS.items() if (budget, games) == (steps, GAMES)), "")


def response_steps(budget: int) -> int:
    """Return the agent-steps of training of a best response: those of the protocol, or the budget if smaller."""
    return min(RESPONSE, budget)


def check_training_seed(seed: int) -> None:
    """Check that a seed is not one of the tests: worlds are keyed by (seed, world), so others never meet them.

    Raises TrainingError.
    """
    if seed >= SEEDS.start:
        raise TrainingError(
            f"seed {seed}: seeds from 2**62 on are reserved for the worlds of tests, which training must not use; "
            "take a smaller one"
        )


def _task(name: str, about: str, trained: Scenario, outside: dict[str, Any] | None = None) -> Task:
    """Return a task of version 1.

    outside: By name, a Scenario, or (Scenario, numbers) with numbers that worlds are given.
    """
    found = {"trained": trained} | (outside or {})
    games = []
    for seed, (name_of_game, entry) in zip(SEEDS, found.items(), strict=False):
        scenario, given = entry if isinstance(entry, tuple) else (entry, {})
        described = scenario.with_(Behaviour()).titled_as(scenario)  # only measures
        games.append(TaskGame(name_of_game, described, tuple(given.items()), seed))
    return Task(f"{name}-v1", about, trained, tuple(games))


def _mended() -> Iterator[Task]:
    for name, ablations in (
        ("ffa_2", "health_cap+bounty+steering"),
        ("ffa_3", "health_cap+bounty+steering"),
        ("teams_2", "health_cap+team_share+bounty+steering"),
        ("teams_3", "health_cap+team_share+bounty+steering"),
    ):
        yield _task(f"{name}-mended", f"{name} without the flaws of the paper's game", variant(f"{name}+{ablations}"))


def _generalisation() -> Iterator[Task]:
    duel = variant("ffa_2+health_cap+bounty+steering")
    trained = {"melee_damage": integers(5, 15), "safe_zone_damage": integers(1, 3), "steering_speed": uniform(4.0, 6.0)}
    changes: dict[str, dict[str, Distribution]] = {
        "strong blows": {"melee_damage": integers(25, 40)},
        "harsh zone": {"safe_zone_damage": integers(5, 10)},
        "slow agents": {"steering_speed": uniform(2.0, 3.0)},
    }
    yield _task(
        "numbers",
        "numbers that vary, tested beyond their ranges",
        duel.vary(**trained),
        {name: duel.vary(**(trained | change)) for name, change in changes.items()},
    )
    # Policies change sides from world to world, so each number of boxes occurs twice: each side plays both.
    items, few = variant("ffa_3"), {"heals_count": (1, 2, 3), "boxes_count": (1, 1, 2, 2)}
    yield _task(
        "counts",
        "many heals and boxes, tested with few",
        items.vary(n_heals=integers(8, 15), n_boxes=integers(4, 8)),
        {"few items": (items.vary(n_heals=integers(1, 15), n_boxes=integers(1, 8)), few)},
    )
    crowd = variant("ffa_2").replace(n_agents=6)
    yield _task(
        "agents",
        "crowds of four to six, tested with two and three",
        crowd.vary(n_agents=integers(4, 6)),
        {
            "two agents": (crowd.vary(n_agents=integers(2, 6)), {"agents_count": (2,)}),
            "three agents": (crowd.vary(n_agents=integers(2, 6)), {"agents_count": (3,)}),
        },
    )
    open_floor = variant("ffa_2").with_(LIDAR)
    small, large = integers(2, 4), integers(6, 8)
    yield _task(
        "layouts",
        "small mazes, tested in larger ones, in rooms and among pillars",
        open_floor.with_(Maze(blocks=64)).vary(maze_columns=small, maze_rows=small),
        {
            "large mazes": open_floor.with_(Maze(blocks=160)).vary(maze_columns=large, maze_rows=large),
            "rooms": open_floor.with_(Rooms(columns=3, rows=3)),
            "pillars": open_floor.with_(Pillars(count=12)),
        },
    )


@functools.cache
def tasks() -> dict[str, Task]:
    """Return all tasks, by name."""
    variants = (_task(name, scenario.about, scenario) for name, scenario in VARIANTS.items())
    return {task.name: task for found in (variants, _mended(), _generalisation()) for task in found}
