"""Collecting a rollout from the worlds, without a loop over agents or worlds."""

from typing import Any

import numpy as np
import torch

from outlast.envs.core.agents import alive
from outlast.envs.core.vector_env import SurvivalVectorEnv

from .hyperparameters import Hyperparameters
from .loss import advantages
from .metrics import BehaviourMetrics, EpisodeMetrics
from .policy import ActorCritic
from .rollout import RewardScale, Rollout
from .rows import Packer, concatenated

Array = np.ndarray[Any, Any]


class Collector:
    """Plays a policy in all worlds and keeps the samples.

    base_env: worlds with autoreset DISABLED, which the collector resets. dead = "keep": an agent's samples go on until
    its world ends. "drop": they end with its death.
    """

    def __init__(
        self, base_env: SurvivalVectorEnv, packer: Packer, numbers: Hyperparameters, dead: str, device: torch.device
    ) -> None:
        self.base_env, self.packer, self.numbers, self.dead, self.device = base_env, packer, numbers, dead, device
        self.agents = base_env.num_worlds * base_env.num_agents
        self.scale = RewardScale(self.agents, numbers.gamma)
        self.episodes, self.behaviour = EpisodeMetrics(base_env), BehaviourMetrics(base_env)

    @torch.inference_mode()
    def collect(self, policy: ActorCritic, steps: int, generator: torch.Generator) -> Rollout:
        """Play on from where the worlds are, and keep what happens.

        Args:
            policy: Of all agents.
            steps: Of each world.
            generator: Of sampled actions, on the device.
        """
        env, shape = self.base_env, (steps, self.agents)
        actions = np.empty((*shape, len(env.action_sizes)), np.int64)
        log_probs, values, rewards = (np.empty(shape, np.float32) for _ in range(3))
        cut_off, ends, living = np.zeros(shape, np.float32), np.empty(shape, bool), np.empty(shape, bool)
        seen = []
        for t in range(steps):
            seen.append(self.packer(env.observe()))
            living[t] = alive(env.worlds).ravel()
            logs, now = policy(seen[t].to(self.device))
            chosen = policy.choices.draw(logs, generator)
            actions[t], values[t] = chosen.cpu(), now.cpu()
            log_probs[t] = policy.choices.of(chosen, logs).cpu()
            joint = actions[t].reshape(env.num_worlds, env.num_agents, -1)
            _, reward, terminated, truncated, info = env.step(joint)
            rewards[t], ends[t] = reward.ravel(), np.repeat(terminated | truncated, env.num_agents)
            self.behaviour.after_step()
            if self.dead == "drop":
                ends[t] |= ~info["alive"].ravel()
            if (done := terminated | truncated).any():
                goes_on = np.repeat(truncated, env.num_agents) & (info["alive"].ravel() | (self.dead == "keep"))
                cut_off[t, goes_on] = self._values(policy)[goes_on] if goes_on.any() else 0
                self.episodes.add(info["statistics"], int(done.sum()))
                env.reset(options={"reset_mask": done})
        spread = self.scale.update(rewards, ends) if self.numbers.scale_rewards else 1.0
        rewards = rewards / np.float32(spread) + np.float32(self.numbers.gamma) * cut_off
        found = advantages(rewards, values, ends, self._values(policy), self.numbers.gamma, self.numbers.gae_lambda)
        learner = np.where(living | (self.dead == "keep"), 0, -1).astype(np.int8)
        return Rollout(concatenated(seen), actions, log_probs, values, found, learner, living)

    def _values(self, policy: ActorCritic) -> Array:
        """Of the worlds as they are, float32 (agents,)."""
        values: Array = policy.values(self.packer(self.base_env.observe()).to(self.device)).cpu().numpy()
        return values
