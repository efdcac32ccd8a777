"""Filling a rollout from the worlds, without a loop over agents or worlds."""

from typing import Any

import numpy as np
import torch

from outlast.envs.core.agents import alive
from outlast.envs.core.vector_env import SurvivalVectorEnv

from .metrics import BehaviourMetrics, EpisodeMetrics
from .policy import ActorCritic
from .rollout_buffer import AgentRolloutBuffer

Array = np.ndarray[Any, Any]


class Collector:
    """Plays a policy in all worlds and writes the samples into a rollout.

    base_env: worlds with autoreset DISABLED, which the collector resets. dead = "keep": an agent's samples go on until
    its world ends. "drop": they end with its death.
    """

    def __init__(self, base_env: SurvivalVectorEnv, dead: str) -> None:
        self.base_env, self.dead = base_env, dead
        self.episodes, self.behaviour = EpisodeMetrics(base_env), BehaviourMetrics(base_env)

    def fill(self, rollout: AgentRolloutBuffer, policy: ActorCritic, generator: torch.Generator) -> None:
        """Fill a rollout, with advantages and returns. generator: of sampled actions."""
        rollout.reset()
        self._observe(rollout, 0)
        starts = np.zeros(rollout.n_envs, np.float32)
        with torch.inference_mode():
            for t in range(rollout.buffer_size):
                rollout.episode_starts[t] = starts
                starts = self._step(rollout, t, policy, generator)
            last = policy.predict_values(self._packed(rollout, rollout.buffer_size))
        rollout.pos, rollout.full = rollout.buffer_size, True
        rollout.compute_returns_and_advantage(last, starts)

    def _step(self, rollout: AgentRolloutBuffer, t: int, policy: ActorCritic, generator: torch.Generator) -> Array:
        """One step of all worlds, written into row `t`; returns 1 for each agent whose samples start anew after it."""
        rollout.alive[t] = alive(self.base_env.worlds).ravel()
        actions, values, logs = policy(self._packed(rollout, t), generator)
        rollout.actions[t], rollout.values[t], rollout.log_probs[t] = actions.cpu(), values.cpu(), logs.cpu()
        joint = rollout.actions[t].reshape(self.base_env.num_worlds, self.base_env.num_agents, -1)
        _, rewards, terminated, truncated, info = self.base_env.step(joint)
        rollout.rewards[t] = rewards.ravel()
        done = terminated | truncated
        ended = np.repeat(done, self.base_env.num_agents)
        if self.dead == "drop":
            ended |= ~alive(self.base_env.worlds).ravel()
        self.behaviour.after_step()
        if done.any():
            self._bootstrap(rollout, t, policy, truncated)
            self.episodes.add(info["statistics"], int(done.sum()))
            self.base_env.reset(options={"reset_mask": done})
        self._observe(rollout, t + 1)
        return ended.astype(np.float32)

    def _bootstrap(self, rollout: AgentRolloutBuffer, t: int, policy: ActorCritic, truncated: Array) -> None:
        """Add the value of what would have come to the last reward of truncated episodes."""
        if not truncated.any():
            return
        self._observe(rollout, t + 1)
        rows = np.repeat(truncated, self.base_env.num_agents)
        if self.dead == "drop":
            rows &= alive(self.base_env.worlds).ravel()
        values = policy.predict_values(self._packed(rollout, t + 1)).cpu().numpy()
        rollout.rewards[t, rows] += np.float32(rollout.gamma) * values[rows]

    def _observe(self, rollout: AgentRolloutBuffer, t: int) -> None:
        packed = rollout.observations[t].reshape(self.base_env.num_worlds, self.base_env.num_agents, -1)
        self.base_env.observe(out=rollout.layout.views(packed))

    @staticmethod
    def _packed(rollout: AgentRolloutBuffer, t: int) -> torch.Tensor:
        return torch.from_numpy(rollout.observations[t]).to(rollout.device)
