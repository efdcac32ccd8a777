"""The tasks: the games of training, validation and test, and the numbers of the protocol. Does not need PyTorch.

A name never changes meaning: a task whose game has changed gets another version, and a test pins each game.
"""

import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.ecs.declarations.distributions import integers, uniform
from outlast.ecs.kernels.errors import did_you_mean
from outlast.envs.scenarios.hide_and_seek import HIDE_SMALL
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.variants import variant
from outlast.systems import Behaviour, Lidar, Maze, Pillars, Rooms

from ..base.errors import TrainingError

PROTOCOL = 2  # version of the protocol, and of all files of results
BUDGETS = {"1M": 1_000_000, "10M": 10_000_000, "100M": 100_000_000}  # agent-steps of training, by track
CHECKPOINTS = 5  # candidates of each training, after equal shares of it
GAMES = 320  # games of a test, each in a world of its own; a validation has a tenth
RESPONSES = (5_000_000, 20_000_000, 80_000_000)  # agent-steps of best responses
TEST_SEEDS = range(2**62, 2**62 + 64)  # of worlds, one for each game of a task
VALIDATION_SEED = 2**62 + 64  # of the worlds of validations
SITUATION_SEED = TEST_SEEDS[-1]  # of the worlds of situations
TRAINED = "trained"  # the game of training, as a test
STYLES = ("random", "scripted", "camper", "hunter", "hoarder", "healer")  # opponents in the survival game


@dataclass(frozen=True)
class TaskGame:
    """A game that agents are tested in: TRAINED, that of training, or another one, named by the difference from it.

    scenario: The game: observations have the same shape in all games of a task. given: Numbers of the worlds in turn,
    by name: counts within the capacity of `scenario`, instead of drawn ones. seed: Of the worlds, for all agents.
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
    """A task, by its name and version: "ffa_2-v2".

    about: One line for tables. scenario: The game of training. validation: The game by which checkpoints are chosen:
    that of training, or between it and those of the test. tests: The games of the test: first that of training, then,
    in tasks of generalisation, games outside of it. styles: Opponents without training. mates: Whether agents have
    team-mates.
    """

    name: str
    about: str
    scenario: Scenario
    validation: TaskGame
    tests: tuple[TaskGame, ...]
    styles: tuple[str, ...]
    mates: bool

    @property
    def games(self) -> dict[str, TaskGame]:
        """All games, of the tests and of the validation, by name."""
        return {game.name: game for game in (*self.tests, self.validation)}


def task_of(name: str) -> Task:
    """Return the task of that name. Raises a TrainingError that lists all tasks."""
    if name not in tasks():
        hint = did_you_mean(name, tasks(), after=" ")
        raise TrainingError(f"unknown task '{name}'; {hint}known: {', '.join(tasks())}")
    return tasks()[name]


def track_of(budget: int, games: int = GAMES) -> str:
    """Return the track of a budget of agent-steps and tests of `games` games; empty if it belongs to no track."""
    return next((name for name, steps in BUDGETS.items() if (budget, games) == (steps, GAMES)), "")


def check_training_seed(seed: int) -> None:
    """Raise TrainingError for a seed of the tests: worlds are keyed by (seed, world), so others never meet them."""
    if seed >= TEST_SEEDS.start:
        reserved = "seeds from 2**62 on are reserved for the worlds of tests, which training must not use"
        raise TrainingError(f"seed {seed}: {reserved}; take a smaller one")


Game = Scenario | tuple[Scenario, Mapping[str, tuple[int, ...]]]  # with numbers that worlds are given


def _task(
    name: str,
    about: str,
    trained: Scenario,
    outside: Mapping[str, Game] | None = None,
    validation: Game | None = None,
    styles: tuple[str, ...] = STYLES,
) -> Task:
    """Return a task of this version. outside: Games of the test outside of training, by name."""
    games = {TRAINED: trained, **(outside or {})}
    tests = tuple(_game(*entry, seed) for seed, entry in zip(TEST_SEEDS, games.items(), strict=False))
    agents = trained.numbers()["agents_count"]
    mates = agents > trained.numbers().get("teams_count", agents)
    chosen_by = _game("validation", validation or trained, VALIDATION_SEED)
    return Task(f"{name}-v2", about, trained, chosen_by, tests, styles, mates)


def _game(name: str, game: Game, seed: int) -> TaskGame:
    scenario, given = game if isinstance(game, tuple) else (game, {})
    measured = scenario.with_(Behaviour()).titled_as(scenario) if "safe_zone" in scenario else scenario
    return TaskGame(name, measured, tuple(given.items()), seed)


def _generalisation() -> Iterator[Task]:
    """Yield tasks whose tests are also outside of the games of training."""
    duel = variant("ffa_2+health_cap+bounty+steering")
    trained = {"melee_damage": integers(5, 15), "safe_zone_damage": integers(1, 3), "steering_speed": uniform(4.0, 6.0)}
    between = {
        "melee_damage": integers(16, 24),
        "safe_zone_damage": integers(4, 5),
        "steering_speed": uniform(3.0, 4.0),
    }
    outside: dict[str, Game] = {
        "strong blows": duel.vary(**(trained | {"melee_damage": integers(25, 40)})),
        "harsh zone": duel.vary(**(trained | {"safe_zone_damage": integers(6, 10)})),
        "slow agents": duel.vary(**(trained | {"steering_speed": uniform(2.0, 3.0)})),
    }
    about = "numbers that vary, tested beyond their ranges"
    yield _task("numbers", about, duel.vary(**trained), outside, duel.vary(**between))
    # Policies change sides from world to world, so each number of boxes occurs twice: each side plays both.
    items = variant("ffa_3")
    many = items.vary(n_heals=integers(8, 15), n_boxes=integers(4, 8))
    every = items.vary(n_heals=integers(1, 15), n_boxes=integers(1, 8))
    few: Game = (every, {"heals_count": (1, 2, 3), "boxes_count": (1, 1, 2, 2)})
    some: Game = (every, {"heals_count": (4, 5, 6), "boxes_count": (3,)})
    yield _task("counts", "many heals and boxes, tested with few", many, {"few items": few}, some)
    crowd = variant("ffa_2").replace(n_agents=6)
    agents, fewer = crowd.vary(n_agents=integers(4, 6)), crowd.vary(n_agents=integers(2, 6))
    two, three = ((fewer, {"agents_count": (count,)}) for count in (2, 3))
    yield _task("agents", "crowds of four to six, tested with two", agents, {"two agents": two}, three)
    open_floor = variant("ffa_2").with_(Lidar(rays=16, depth=10.0))
    small, large = integers(2, 4), integers(6, 8)
    mazes = open_floor.with_(Maze(blocks=64)).vary(maze_columns=small, maze_rows=small)
    outside = {
        "large mazes": open_floor.with_(Maze(blocks=160)).vary(maze_columns=large, maze_rows=large),
        "rooms": open_floor.with_(Rooms(columns=3, rows=3)),
        "pillars": open_floor.with_(Pillars(count=12)),
    }
    about = "small mazes, tested in larger ones, in rooms and among pillars"
    yield _task("layouts", about, mazes, outside, open_floor.with_(Maze(blocks=100, columns=5, rows=5)))


@functools.cache
def tasks() -> dict[str, Task]:
    """Return all tasks, by name."""
    found = [_task(name, variant(name).about, variant(name)) for name in ("ffa_2", "ffa_3", "teams_2", "teams_3")]
    mended = variant("teams_3+health_cap+team_share+bounty+steering")
    found.append(_task("teams_3-mended", "teams_3 without the flaws of the paper's game", mended))
    found.append(_task("hide_small", HIDE_SMALL.about, HIDE_SMALL, styles=("random", "scripted")))
    return {task.name: task for task in (*found, *_generalisation())}
