"""Rollouts on this machine: run a policy in many worlds and sum up their episodes."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.vector_env import SurvivalVectorEnv
from ..errors import EndlessError
from ..scenarios.scenario import Scenario
from .policies import Policy
from .summary import Summary

Array = np.ndarray[Any, Any]

BLOCK = 256  # worlds in a block, at most: little to do again when a worker is lost
LONGEST = 100_000  # steps that a whole episode without a limit is waited for


def rollout(
    env: SurvivalVectorEnv,
    policy: Policy,
    steps: int = 0,
    progress: Callable[[Summary], None] = lambda summary: None,
    *,
    episodes: int = 1,
) -> Summary:
    """Reset everything, play whole episodes, of every world as many, and sum them up.

    Worlds that are done go on until all are; what they play then is not counted.

    Args:
        env: Worlds that restart by themselves.
        policy: Acts in all of them.
        steps: Take so many steps of every world instead, and count all episodes that end in them.
        progress: Called after every step with the summary so far.
        episodes: How many of each world.

    Returns:
        The summary of the episodes.

    Raises:
        EndlessError: A world without a limit was in one episode for 100,000 steps. Not with `steps`.
        KeyboardInterrupt: After Ctrl-C, with the summary so far as its argument.
    """
    summary = Summary(each=0 if steps else episodes)
    left = np.full(env.num_worlds, np.iinfo(np.int64).max if steps else episodes)  # that are to be counted
    begun = np.zeros(env.num_worlds, np.int64)  # the step after which the episode of each world began
    endless = not steps and not env.scenario.numbers().get("ending_limit")
    observations, _ = env.reset()
    try:
        for step in range(1, steps + 1) if steps else itertools.count(1):
            observations, _, _, _, info = env.step(policy(observations))
            summary.world_steps += env.num_worlds
            if "statistics" in info:
                counted = info["_statistics"] & (left > 0)
                summary.add(info["statistics"], counted)
                left -= counted
                begun[info["_statistics"]] = step
            progress(summary)
            if not left.any():
                break
            if endless and (late := (left > 0) & (step - begun >= LONGEST)).any():
                raise EndlessError(
                    f"world {env.first_world + late.argmax()} has been in one episode for {LONGEST:,} steps, which may "
                    "never end: set ending_limit, or roll out a fixed number of steps"
                )
    except KeyboardInterrupt:
        summary.each = 0
        raise KeyboardInterrupt(summary) from None
    return summary


def ticks(env: SurvivalVectorEnv, policy: Policy, steps: int) -> Iterator[int]:
    """Reset everything, then take `steps` steps, one whenever the next item is asked for: the number of steps done.

    The first item is 0: the worlds are just reset. Between items the worlds can be looked at.
    """
    observations, _ = env.reset()
    yield 0
    for step in range(1, steps + 1):
        observations, *_ = env.step(policy(observations))
        yield step


@dataclass(frozen=True)
class Task:
    """A rollout as data. policy: makes one for an environment and a seed, see POLICIES. The rest: see `rollout`."""

    scenario: Scenario
    policy: Callable[[SurvivalVectorEnv, int], Policy]
    steps: int
    seed: int
    episodes: int = 1


def play(task: Task, first: int, count: int) -> Summary:
    """The summary of `count` worlds from `first` on: the same as theirs in a rollout of all."""
    env = SurvivalVectorEnv(task.scenario, count, seed=task.seed, first_world=first, copy=False, check_actions=False)
    try:
        return rollout(env, task.policy(env, task.seed), task.steps, episodes=task.episodes)
    finally:
        env.close()


def blocks(worlds: int, workers: int) -> list[tuple[int, int]]:
    """(first world, number of worlds) of each block: something for every worker, nothing larger than BLOCK."""
    size = min(BLOCK, -(-worlds // workers))
    return [(first, min(size, worlds - first)) for first in range(0, worlds, size)]
