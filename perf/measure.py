"""Timing a batch of worlds: microseconds a world-step of the whole step, with random actions."""

import time
from collections.abc import Callable

import numpy as np

from outlast import Scenario, make_vec
from outlast.components import End, Phase
from outlast.ecs import RESET, STEP, Action, Worlds
from outlast.envs.policies import random_policy
from outlast.envs.spaces import published

WARM = 100  # steps ahead of the clock: worlds are out of step with each other by then


def step_time(scenario: Scenario, worlds: int, steps: int = 0, threads: int = 1, repeats: int = 3) -> float:
    """Best of `repeats`: microseconds that env.step takes for each world, autoreset and statistics included.

    The actions are drawn before the clock starts. Episodes go on from one repeat to the next.
    """
    env = make_vec(scenario, worlds, seed=0, threads=threads)
    policy = random_policy(env)
    observations, _ = env.reset()
    actions = [policy(observations) for _ in range(50)]
    best = _best(lambda k: env.step(actions[k % len(actions)]), worlds, steps, repeats)
    env.close()
    return best


def simulation_time(scenario: Scenario, worlds: int, steps: int = 0, threads: int = 1, repeats: int = 3) -> float:
    """The same of the simulation alone: no observations, no checks; rewards, statistics and autoreset are in it."""
    batch = Worlds(scenario.modules, worlds, threads, without=(Phase.OBSERVE,))
    batch.seed(0, np.arange(worlds))
    generator = np.random.default_rng(0)
    columns = [(getattr(batch[c], name), column) for _, c, name, column in published(batch, Action)]
    draws = [[generator.integers(int(c.low), int(c.high) + 1, a.shape, a.dtype) for a, c in columns] for _ in range(50)]
    mode, end = np.full(worlds, RESET, np.int8), batch[End]

    def step(k: int) -> None:
        for (array, _), drawn in zip(columns, draws[k % len(draws)], strict=True):
            array[:] = drawn
        batch.run(mode)
        mode[:] = np.where(end.terminated[:, 0] | end.truncated[:, 0], RESET, STEP)

    best = _best(step, worlds, steps, repeats)
    batch.close()
    return best


def _best(call: Callable[[int], object], worlds: int, steps: int, repeats: int) -> float:
    steps = steps or max(20, min(2000, 200_000 // worlds))
    for k in range(WARM):
        call(k)
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        for k in range(steps):
            call(k)
        best = min(best, (time.perf_counter() - start) / steps / worlds * 1e6)
    return float(best)
