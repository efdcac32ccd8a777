"""Filling a rollout from the worlds, without a loop over agents or worlds."""

from typing import Any

import numpy as np
import torch

from outlast.ecs import Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv

from .behaviour import Behaviour
from .buffer import Rollout
from .episodes import Episodes
from .policy import Policy

Array = np.ndarray[Any, Any]


class Collector:
    """Plays a policy in all worlds and writes what happens into a rollout.

    core: worlds with autoreset DISABLED, as they are reset here. dead = "keep": an agent's samples go on until its
    world ends. "drop": they end with its death.
    """

    def __init__(self, core: SurvivalVectorEnv, dead: str) -> None:
        self.core, self.dead = core, dead
        self.agents = core.worlds.span("agent")
        self.episodes, self.behaviour = Episodes(core), Behaviour(core)

    def fill(self, rollout: Rollout, policy: Policy, generator: torch.Generator) -> None:
        """Fill a rollout that was reset, with advantages and returns."""
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

    def _step(self, rollout: Rollout, t: int, policy: Policy, generator: torch.Generator) -> Array:
        """One step of all worlds, written into row `t`; returns 1 for each agent whose samples start anew after it."""
        rollout.alive[t] = self._alive()
        actions, values, logs = policy(self._packed(rollout, t), generator)
        rollout.actions[t], rollout.values[t], rollout.log_probs[t] = actions.cpu(), values.cpu(), logs.cpu()
        joint = rollout.actions[t].reshape(self.core.num_worlds, self.core.num_agents, -1)
        self.behaviour.before()
        _, rewards, terminated, truncated, info = self.core.step(joint)
        rollout.rewards[t] = rewards.ravel()
        over = terminated | truncated
        ended = np.repeat(over, self.core.num_agents)
        if self.dead == "drop":
            ended |= ~self._alive()
        self.behaviour.after()
        if over.any():
            self._finish(rollout, t, policy, truncated)
            self.episodes.add(info["statistics"], int(over.sum()))
            self.core.reset(options={"reset_mask": over})
        self._observe(rollout, t + 1)
        return ended.astype(np.float32)

    def _finish(self, rollout: Rollout, t: int, policy: Policy, cut: Array) -> None:
        """Where an episode was cut off, the reward of its last step gets the value of what would have come."""
        if not cut.any():
            return
        self._observe(rollout, t + 1)
        rows = np.repeat(cut, self.core.num_agents)
        if self.dead == "drop":
            rows &= self._alive()
        values = policy.predict_values(self._packed(rollout, t + 1)).cpu().numpy()
        rollout.rewards[t, rows] += np.float32(rollout.gamma) * values[rows]

    def _observe(self, rollout: Rollout, t: int) -> None:
        packed = rollout.observations[t].reshape(self.core.num_worlds, self.core.num_agents, -1)
        self.core.observe(out=rollout.layout.views(packed))

    def _alive(self) -> Array:
        alive: Array = self.core.worlds[Entity].alive[:, self.agents].ravel() != 0
        return alive

    @staticmethod
    def _packed(rollout: Rollout, t: int) -> torch.Tensor:
        return torch.from_numpy(rollout.observations[t]).to(rollout.device)
