"""The random numbers that sampled actions are made of."""

from typing import Any

import numpy as np

from outlast.envs.rollout.policies import GOLDEN, mix64

Array = np.ndarray[Any, Any]
STREAM = 2  # sets them apart from other random numbers of the seed


class ActionNoise:
    """Uniform numbers for every action of every agent: a function of (seed, step, world, agent, action).

    So a world is played the same in every batch, whoever else plays, and a run that goes on needs no state for it.
    Each agent has a SplitMix64 generator of its own (Steele, Lea and Flood, OOPSLA 2014).
    """

    def __init__(self, seed: int, worlds: Array, agents: int, actions: int) -> None:
        """Key the numbers.

        Args:
            seed: Of the run.
            worlds: Numbers of the worlds, int (worlds,).
            agents: Of a world.
            actions: Of an agent.
        """
        (key,) = np.random.SeedSequence([seed, STREAM]).generate_state(1, np.uint64)
        world = mix64(key + worlds.astype(np.uint64))[:, None]
        self._start = mix64(world + np.arange(agents, dtype=np.uint64)).reshape(-1, 1)
        self._actions = actions

    def __call__(self, step: int) -> Array:
        """The numbers of a step, float32 (agents of all worlds, actions), from 0 to below 1."""
        place = np.arange(step * self._actions, (step + 1) * self._actions, dtype=np.uint64)
        words = mix64(self._start + place * GOLDEN)
        numbers: Array = (words >> np.uint64(40)).astype(np.float32) * np.float32(2**-24)
        return numbers
