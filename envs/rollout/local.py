"""Rollouts on this machine: run a policy in many worlds and summarise their episodes."""

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.validation import Array
from ..core.vector_env import SurvivalVectorEnv
from ..errors import EndlessError
from ..scenarios.scenario import Scenario
from .memory import told
from .policies import Policy
from .summary import Summary

MAX_BATCH = 256  # worlds that a worker plays at a time; few, as they are played again if the worker is lost
MAX_STEPS = 100_000  # of an episode in a game without a time limit


def rollout(
    env: SurvivalVectorEnv,
    policy: Policy,
    steps: int = 0,
    progress: Callable[[Summary], None] = lambda summary: None,
    *,
    episodes: int = 1,
    watch: Callable[[Array], None] | None = None,
    ended: Callable[[Mapping[str, Any], Array], None] | None = None,
) -> Summary:
    """Reset everything, and play and summarise as outlast.rollout does, which describes the arguments.

    env: Worlds that restart by themselves. policy: See memory.told. ended: Called when episodes end, with info and the
    worlds in which an ended episode counts, bool (worlds,).
    """
    summary = Summary(episodes_per_world=0 if steps else episodes)
    most = np.iinfo(np.int64).max if steps else episodes
    remaining = np.full(env.num_worlds, most)  # episodes still to be counted in each world
    began = np.zeros(env.num_worlds, np.int64)  # the step after which the episode of each world began
    act = told(policy, env)
    observations, _ = env.reset()
    try:
        if watch:
            watch(remaining > 0)
        for step in range(1, steps + 1) if steps else itertools.count(1):
            start = time.perf_counter()
            actions = act(observations)
            chosen = time.perf_counter()
            observations, _, _, _, info = env.step(actions)
            summary.seconds["policy"] += chosen - start
            summary.seconds["worlds"] += time.perf_counter() - chosen
            summary.world_steps += env.num_worlds
            if watch:
                watch(remaining > 0)
            if "statistics" in info:
                counted = info["_statistics"] & (remaining > 0)
                summary.add(info["statistics"], counted, info.get("statistics_present"))
                if ended:
                    ended(info, counted)
                remaining -= counted
                began[info["_statistics"]] = step
            progress(summary)
            if not remaining.any():
                break
            if steps or step < MAX_STEPS or not (long := (remaining > 0) & (step - began >= MAX_STEPS)).any():
                continue
            if (late := long & (np.asarray(env.numbers().get("ending_limit", 0)) == 0)).any():
                raise EndlessError(
                    f"world {env.first_world + late.argmax()} has been in one episode for {MAX_STEPS:,} steps, which "
                    "may never end: set ending_limit, or roll out a fixed number of steps"
                )
    except BaseException as error:
        summary.episodes_per_world = 0
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(summary) from None
        raise
    return summary


def ticks(env: SurvivalVectorEnv, policy: Policy, steps: int) -> Iterator[int]:
    """Reset everything, then take a step for each further item, so that a loop can look at the worlds after each step.

    env: Worlds that restart by themselves. policy: See memory.told. steps: How many steps to take. Yields the number of
    steps done, from 0 (right after the reset) to `steps`.
    """
    act = told(policy, env)
    observations, _ = env.reset()
    yield 0
    for step in range(1, steps + 1):
        observations, *_ = env.step(act(observations))
        yield step


@dataclass(frozen=True)
class RolloutTask:
    """A rollout as data. policy: makes one for an environment and a seed (see POLICIES). For the rest see `rollout`."""

    scenario: Scenario
    policy: Callable[[SurvivalVectorEnv, int], Policy]
    steps: int
    seed: int
    episodes: int = 1


def run_task(task: RolloutTask, first: int, count: int) -> Summary:
    """Return the summary of `count` worlds from number `first` on. They play as they do in a rollout of all worlds."""
    env = SurvivalVectorEnv(task.scenario, count, seed=task.seed, first_world=first, copy=False, check_actions=False)
    try:
        return rollout(env, task.policy(env, task.seed), task.steps, episodes=task.episodes)
    finally:
        env.close()


def split_worlds(worlds: int, workers: int) -> list[tuple[int, int]]:
    """Return (first world, number of worlds) of batches of at most MAX_BATCH worlds, with some work for each worker."""
    size = min(MAX_BATCH, -(-worlds // workers))
    return [(first, min(size, worlds - first)) for first in range(0, worlds, size)]
