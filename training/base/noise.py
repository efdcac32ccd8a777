"""The random numbers by which actions are sampled."""

from typing import Any

import numpy as np

from outlast.ecs import Clock
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import GOLDEN, hashed, mix64

Array = np.ndarray[Any, Any]
STREAM = 2  # separates them from other random numbers of the same seed


class ActionNoise:
    """Uniform numbers for every action of every agent: a function of (seed, step, world, agent, action).

    A world is therefore played the same way in every batch, and a resumed run needs no saved state. Each agent has its
    own SplitMix64 generator (Steele, Lea and Flood, OOPSLA 2014).
    """

    def __init__(self, seed: int, worlds: Array, agents: int, actions: int) -> None:
        """Derive the key of each agent's numbers.

        seed: Seed of the run. worlds: Numbers of the worlds, int (worlds,). agents: Number of agents of a world.
        actions: Number of actions of an agent.
        """
        (key,) = np.random.SeedSequence([seed, STREAM]).generate_state(1, np.uint64)
        world = mix64(key + worlds.astype(np.uint64))[:, None]
        self._start = mix64(world + np.arange(agents, dtype=np.uint64)).reshape(-1, 1)
        self._actions = actions

    def __call__(self, step: int) -> Array:
        """Return the numbers of a step, float32 (agents of all worlds, actions), from 0 to below 1."""
        place = np.arange(step * self._actions, (step + 1) * self._actions, dtype=np.uint64)
        return _uniform(mix64(self._start + place * GOLDEN))


class EpisodeNoise:
    """Uniform numbers for every action of some agents: a function of (seed, world, episode, tick, agent, action).

    An episode that is repeated, or continued from a saved state, is therefore played the same way.
    """

    def __init__(self, env: SurvivalVectorEnv, agents: Any) -> None:
        """Keep `env`, whose worlds are read at every call. agents: Indices of the agents, integers (agents,)."""
        self._clock, self._agents = env.worlds[Clock], np.asarray(agents, np.uint64)[None]
        self._actions = GOLDEN * np.arange(1, len(env.action_sizes) + 1, dtype=np.uint64)

    def __call__(self) -> Array:
        """Return the numbers of the next step, float32 (agents of all worlds, actions), from 0 to below 1."""
        clock = self._clock
        words = hashed(np.uint64(STREAM), clock.seed, clock.world, clock.episode, clock.tick, self._agents)
        return _uniform(mix64(words.reshape(-1, 1) + self._actions))


def _uniform(words: Array) -> Array:
    """Turn uniform uint64 numbers into float32 of the same shape, from 0 to below 1."""
    return (words >> np.uint64(40)).astype(np.float32) * np.float32(2**-24)
