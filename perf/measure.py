"""Timing: what one step of a batch costs, and several things in turn so that their ratio can be trusted.

Actions are random and episodes are cut after 100 steps, so that all agents are alive and busy. Worlds are compiled for
their scenario alone (specialize=True), and observations are not copied. Worlds are spread over all steps of their
episodes.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from outlast import Scenario, make_vec
from outlast.components import End, Phase
from outlast.ecs import RESET, STEP, Action, Worlds
from outlast.envs.core.spaces import published
from outlast.envs.rollout.policies import random_policy

Call = Callable[[int], object]  # does step number k of something
Timer = Callable[[], float]  # seconds of a call, the mean of a fixed number of them
LIMIT = 100  # steps of an episode
DRAWS = 50  # different actions, drawn ahead of the clock


def stepper(scenario: Scenario, worlds: int, threads: int = 1) -> Call:
    """Calls of env.step with random actions: checks, autoreset and statistics included."""
    scenario = scenario.replace(ending_limit=LIMIT)
    env = make_vec(scenario, worlds, seed=0, threads=threads, copy=False, specialize=True)
    policy = random_policy(env)
    observations, _ = env.reset()
    actions = [policy(observations) for _ in range(DRAWS)]
    for k in range(LIMIT):
        env.step(actions[k % DRAWS])
        if (mask := np.arange(worlds) % LIMIT == k).any():
            env.reset(options={"reset_mask": mask})
    return lambda k: env.step(actions[k % DRAWS])


def simulator(scenario: Scenario, worlds: int, threads: int = 1) -> Call:
    """Calls of the simulation alone: no observations, no checks; rewards, statistics and autoreset are included."""
    modules = scenario.replace(ending_limit=LIMIT).modules
    return ticker(Worlds(modules, worlds, threads, without=(Phase.LOOK, Phase.OBSERVE), specialize=True))


def ticker(batch: Worlds) -> Call:
    """Calls that take a batch through a tick with random actions, autoreset included."""
    batch.seed(0, np.arange(batch.count))
    columns = [(getattr(batch[c], name), column) for _, c, name, column in published(batch, Action)]
    generator = np.random.default_rng(0)
    ranges = [(int(column.low), int(column.high) + 1, array.shape, array.dtype) for array, column in columns]
    draws = [[generator.integers(*each) for each in ranges] for _ in range(DRAWS)]
    mode, end = np.full(batch.count, RESET, np.int8), batch[End]

    def step(k: int) -> None:
        for (array, _), drawn in zip(columns, draws[k % DRAWS], strict=True):
            array[:] = drawn
        batch.run(mode)
        mode[:] = np.where(end.terminated[:, 0] | end.truncated[:, 0], RESET, STEP)

    for k in range(LIMIT):
        step(k)
        mode[np.arange(batch.count) % LIMIT == k] = RESET
    return step


def alternate(calls: Sequence[Call], rounds: int = 5, seconds: float = 0.2) -> np.ndarray:
    """Seconds a call, (rounds, calls): in every round each is called for `seconds`, one after the other."""
    return in_turn([timer(call, seconds) for call in calls], rounds)


def in_turn(timers: Sequence[Timer], rounds: int = 5) -> np.ndarray:
    """The results of the timers, (rounds, timers): one after the other in every round."""
    return np.array([[each() for each in timers] for _ in range(rounds)])


def timer(call: Call, seconds: float = 0.2, clock: Callable[[], float] = time.perf_counter) -> Timer:
    """Make a timer of as many calls as take about `seconds` by `clock`."""
    count = max(1, round(seconds / min(_time(call, 1, clock) for _ in range(3))))
    return lambda: _time(call, count, clock)


def micros(call: Call, worlds: int, rounds: int = 5, seconds: float = 0.2) -> float:
    """Best of `rounds`: microseconds a world-step."""
    return float(alternate([call], rounds, seconds).min() / worlds * 1e6)


def _time(call: Call, count: int, clock: Callable[[], float]) -> float:
    start = clock()
    for k in range(count):
        call(k)
    return (clock() - start) / count
