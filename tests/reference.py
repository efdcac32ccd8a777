"""A slow reference: it plays whole episodes by itself, with the naive forms, numpy's random numbers and pybox2d.

It begins with what a reset made and never looks at the engine again. Where rounding may have decided, it notes so and
goes on with its own answer.

    python -m tests.reference [VARIANT ...] [--policy NAME] [--episodes N] [--seed N]

compares whole episodes of the engine, tick by tick, and says where the two part, if they do.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from outlast import Scenario, make_vec, variant
from outlast.components.score import End, Reward
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import POLICIES
from tests import naive_mechanics, naive_observations
from tests.ambiguity import collecting
from tests.digests import numbered_actions
from tests.naive_world import TOLERANCE, World, differences, read
from tests.reference_physics import move
from tests.reference_random import scattered

KEYS = ("ahead", "left", "turn", "attack", "use", "give")
FACTS = {  # whole numbers of each kind of thing
    "agent": ("here", "health", "cause", "source", "side", "wait", "bag"), "box": ("here", "broken", "owner"),
    "box_item": ("here", "holder"), "heal": ("here", "holder"),
}  # fmt: skip
MOTION = ("x", "y", "angle", "vx", "vy", "omega")


@dataclass
class Outcome:
    """What comes out of a tick: the world, what each agent observes and is paid, the end; and what was a close call."""

    world: World
    observation: dict[str, np.ndarray[Any, Any]]
    reward: list[float]
    end: tuple[bool, bool]
    ambiguities: list[str] = field(default_factory=list)


def play(world: World, actions: Iterable[naive_mechanics.Actions]) -> list[Outcome]:
    """The ticks of an episode that begins with `world`, until it is over or there are no more actions."""
    outcomes: list[Outcome] = []
    for wishes in actions:
        outcomes.append(step(world, wishes))
        world = outcomes[-1].world
        if any(outcomes[-1].end):
            break
    return outcomes


def step(world: World, actions: naive_mechanics.Actions, physics: naive_mechanics.Move = move) -> Outcome:
    """One tick."""
    with collecting() as ambiguities:
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
        ambiguities,
    )


def held(env: SurvivalVectorEnv, seed: int) -> Any:
    """A policy that keeps to random directions for a while, and so gets everywhere."""
    ticks = iter(range(10_000 * seed, 10_000 * seed + 10_000))
    return lambda observations: numbered_actions(env, next(ticks))


@dataclass
class Episode:
    """What the engine made of one episode: how it began, what agents did, and what came out of each tick."""

    start: World
    actions: list[naive_mechanics.Actions] = field(default_factory=list)
    ticks: list[Outcome] = field(default_factory=list)


def record(
    scenario: Scenario, worlds: int, seed: int, policy: Callable[[SurvivalVectorEnv, int], Any]
) -> list[Episode]:
    """The first episode of each world, whole."""
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
            episodes[w].ticks.append(seen(env, w, observations))
        playing = [w for w in playing if not any(episodes[w].ticks[-1].end)]
    env.close()
    return episodes


def seen(env: SurvivalVectorEnv, w: int, observations: dict[str, np.ndarray[Any, Any]]) -> Outcome:
    """What came out of the engine's last tick in world `w`."""
    end = env.worlds[End]
    observed = {key: array[w].astype(float) for key, array in observations.items()}
    over = bool(end.terminated[w, 0]), bool(end.truncated[w, 0])
    return Outcome(read(env, w), observed, env.worlds[Reward].reward[w].tolist(), over)


def facts(got: Outcome, want: Outcome) -> list[str]:
    """Where whole numbers differ, in words: of things, deaths, rewards, the end and the statistics."""
    found = [
        words for kind, columns in FACTS.items() for words in differences(got.world, want.world, (kind,), *columns)
    ]
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


def distance(got: Outcome, want: Outcome) -> float:
    """How far agents and boxes have drifted apart: the largest difference of any number in MOTION."""
    pairs = zip(got.world.of("agent", "box"), want.world.of("agent", "box"), strict=True)
    return max((abs(getattr(a, c) - getattr(b, c)) for a, b in pairs if b.here for c in MOTION), default=0.0)


@dataclass
class Comparison:
    """One episode, by both. parted: the tick from which whole numbers differ, as floats had drifted apart; else 0."""

    ticks: int
    drift: float  # the largest, before that
    parted: int = 0
    compared: int = 0  # ticks in which all observations were compared


def compare(episode: Episode) -> Comparison:
    """AssertionError where both differ though nothing was a close call and the drift is less than the tolerance."""
    want = play(episode.start, episode.actions)
    result = Comparison(len(episode.ticks), 0.0)
    for k, (got, own) in enumerate(zip(episode.ticks, want, strict=False), 1):
        close = own.ambiguities or result.drift > TOLERANCE
        if found := facts(got, own):
            assert close, f"tick {k}: {'; '.join(found[:5])}"
            result.parted = k
            return result
        result.drift = max(result.drift, distance(got, own))
        if not own.ambiguities and result.drift <= TOLERANCE:
            result.compared += 1
            for key, value in own.observation.items():
                np.testing.assert_allclose(got.observation[key], value, atol=2 * TOLERANCE, err_msg=f"{key}, tick {k}")
    assert len(want) == len(episode.ticks)
    return result


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser("python -m tests.reference", description=__doc__)
    parser.add_argument("variants", nargs="*", metavar="VARIANT", default=["ffa_4", "teams_4"])
    parser.add_argument("--policy", default="held", choices=["held", *POLICIES])
    parser.add_argument("--episodes", type=int, default=20, help="of each variant (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    for name in asked.variants:
        policy = {"held": held, **POLICIES}[asked.policy]
        for episode in record(variant(name), asked.episodes, asked.seed, policy):
            print(name, compare(episode), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
