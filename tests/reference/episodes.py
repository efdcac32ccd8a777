"""A slow reference that plays whole episodes with the naive forms, numpy's random numbers and pybox2d.

It starts from the worlds after a reset and does not read the engine's state again. Where a decision is ambiguous within
the tolerance of floats, it records that and continues with its own answer.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from outlast import Scenario, make_vec
from outlast.components.score import End, Reward
from outlast.envs.core.vector_env import SurvivalVectorEnv
from tests.digests import numbered_actions
from tests.helpers import naive_mechanics, naive_observations
from tests.helpers.ambiguity import collecting
from tests.helpers.naive_world import TOLERANCE, World, differences, read
from tests.reference.physics import move
from tests.reference.random_numbers import scattered

KEYS = ("ahead", "left", "turn", "attack", "use", "give")
FACTS = {  # columns of each kind of entity that are compared exactly
    "agent": ("here", "health", "damage_type", "source", "side", "wait", "bag"), "box": ("here", "broken", "owner"),
    "box_item": ("here", "holder"), "heal": ("here", "holder"),
}  # fmt: skip
MOTION = ("x", "y", "angle", "vx", "vy", "omega")


@dataclass
class Outcome:
    """The result of a tick. end: (terminated, truncated). ambiguous: decisions within the tolerance of floats."""

    world: World
    observation: dict[str, np.ndarray[Any, Any]]
    reward: list[float]
    end: tuple[bool, bool]
    ambiguous: list[str] = field(default_factory=list)


def play(world: World, actions: Iterable[naive_mechanics.Actions]) -> list[Outcome]:
    """The ticks of an episode that starts with `world`, until it ends or there are no more actions."""
    outcomes: list[Outcome] = []
    for action in actions:
        outcomes.append(step(world, action))
        world = outcomes[-1].world
        if any(outcomes[-1].end):
            break
    return outcomes


def step(world: World, actions: naive_mechanics.Actions, physics: naive_mechanics.Move = move) -> Outcome:
    """One tick."""
    with collecting() as ambiguous:
        after = naive_mechanics.tick(world, actions, physics, scattered, naive_observations.see)
    after.statistics = naive_observations.statistics(after, world.statistics)
    agents = range(len(after.of("agent")))
    rows = [naive_observations.observe(after, i) for i in agents]
    observation = {key: np.array([row[key] for row in rows], float) for key in rows[0]}
    return Outcome(
        after,
        observation,
        [naive_observations.reward(after, i) for i in agents],
        naive_observations.end(after),
        ambiguous,
    )


def held(env: SurvivalVectorEnv, seed: int) -> Any:
    """A policy that holds random directions for some ticks, so that agents get everywhere."""
    ticks = iter(range(10_000 * seed, 10_000 * seed + 10_000))
    return lambda observations: numbered_actions(env, next(ticks))


@dataclass
class Episode:
    """One episode of the engine: its first world, the actions, and the outcome of each tick."""

    start: World
    actions: list[naive_mechanics.Actions] = field(default_factory=list)
    ticks: list[Outcome] = field(default_factory=list)


def record(
    scenario: Scenario, worlds: int, seed: int, policy: Callable[[SurvivalVectorEnv, int], Any]
) -> list[Episode]:
    """The whole first episode of each world."""
    env = make_vec(scenario, worlds, seed=seed)
    act, (observations, _) = policy(env, seed), env.reset()
    episodes = [Episode(read(env, w)) for w in range(worlds)]
    playing = list(range(worlds))
    while playing:
        actions = act(observations)
        observations, *_ = env.step(actions)
        for w in playing:
            low = [1, 1, 1, 0, 0, 0]
            episodes[w].actions.append([dict(zip(KEYS, row, strict=True)) for row in (actions[w] - low).tolist()])
            episodes[w].ticks.append(read_outcome(env, w, observations))
        playing = [w for w in playing if not any(episodes[w].ticks[-1].end)]
    env.close()
    return episodes


def read_outcome(env: SurvivalVectorEnv, w: int, observations: dict[str, np.ndarray[Any, Any]]) -> Outcome:
    """The outcome of the engine's last tick in world `w`."""
    end = env.worlds[End]
    observation = {key: array[w].astype(float) for key, array in observations.items()}
    done = bool(end.terminated[w, 0]), bool(end.truncated[w, 0])
    return Outcome(read(env, w), observation, env.worlds[Reward].reward[w].tolist(), done)


def facts(got: Outcome, want: Outcome) -> list[str]:
    """Differences in what is exact, as text: columns of FACTS, deaths, rewards, the end and the statistics."""
    found = [line for kind, columns in FACTS.items() for line in differences(got.world, want.world, (kind,), *columns)]
    for name, one, other in (
        ("deaths", got.world.deaths, want.world.deaths),
        ("reward", got.reward, want.reward),
        ("end", got.end, want.end),
        ("tick", got.world.tick, want.world.tick),
    ):
        found += [f"{name}: {one}, the reference's {other}"] if one != other else []
    for key, value in want.world.statistics.items():
        if not np.allclose(got.world.statistics[key], value, rtol=1e-5):
            found.append(f"{key}: {got.world.statistics[key]}, the reference's {value}")
    return found


def drift_between(got: Outcome, want: Outcome) -> float:
    """The largest difference of any column of MOTION between agents and boxes."""
    pairs = zip(got.world.of("agent", "box"), want.world.of("agent", "box"), strict=True)
    return max((abs(getattr(a, c) - getattr(b, c)) for a, b in pairs if b.here for c in MOTION), default=0.0)


@dataclass
class Comparison:
    """A compared episode. diverged: the tick from which exact columns differ because floats drifted; else 0."""

    ticks: int
    drift: float  # the largest before that tick
    diverged: int = 0
    compared: int = 0  # ticks whose observations were compared


def compare(episode: Episode) -> Comparison:
    """AssertionError where both differ though nothing is ambiguous and the drift is within the tolerance."""
    want = play(episode.start, episode.actions)
    result = Comparison(len(episode.ticks), 0.0)
    for k, (got, own) in enumerate(zip(episode.ticks, want, strict=False), 1):
        may_differ = own.ambiguous or result.drift > TOLERANCE
        if found := facts(got, own):
            assert may_differ, f"tick {k}: {'; '.join(found[:5])}"
            result.diverged = k
            return result
        result.drift = max(result.drift, drift_between(got, own))
        if not own.ambiguous and result.drift <= TOLERANCE:
            result.compared += 1
            for key, value in own.observation.items():
                np.testing.assert_allclose(got.observation[key], value, atol=2 * TOLERANCE, err_msg=f"{key}, tick {k}")
    assert len(want) == len(episode.ticks)
    return result
