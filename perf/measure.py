"""Timing a batch of worlds: microseconds a world-step of the whole step, with random actions."""

import time

import numpy as np

from outlast import Scenario, make_vec
from outlast.envs.policies import random_policy

WARM = 100  # steps ahead of the clock: worlds are out of step with each other by then


def step_time(scenario: Scenario, worlds: int, steps: int = 0, threads: int = 1, repeats: int = 3) -> float:
    """Best of `repeats`: microseconds that env.step takes for each world, autoreset and statistics included.

    The actions are drawn before the clock starts. Episodes go on from one repeat to the next.
    """
    steps = steps or max(20, min(2000, 200_000 // worlds))
    env = make_vec(scenario, worlds, seed=0, threads=threads)
    policy = random_policy(env)
    observations, _ = env.reset()
    actions = [policy(observations) for _ in range(min(steps, 50))]
    for k in range(WARM):
        env.step(actions[k % len(actions)])
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        for k in range(steps):
            env.step(actions[k % len(actions)])
        best = min(best, (time.perf_counter() - start) / steps / worlds * 1e6)
    env.close()
    return best
