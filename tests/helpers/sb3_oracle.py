"""Updates by Stable-Baselines3's PPO.train from a rollout of ours, to compare ours with."""

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from stable_baselines3.common.utils import FloatSchedule

from outlast.training.policies.policy import ActorCritic
from outlast.training.ppo.learner import Learner
from outlast.training.ppo.rollout import Rollout


class PlainPolicy(torch.nn.Module):
    """A copy of a policy in Stable-Baselines3's form: a PyTorch distribution of each action's own logits."""

    def __init__(self, policy: ActorCritic, sizes: list[int], learning_rate: float) -> None:
        super().__init__()
        self.inner, self.sizes = copy.deepcopy(policy), sizes
        self.optimizer = torch.optim.Adam(self.inner.parameters(), learning_rate, eps=1e-5)

    def set_training_mode(self, mode: bool) -> None:
        self.train(mode)

    def evaluate_actions(self, seen: Any, actions: torch.Tensor) -> tuple[Any, Any, Any]:
        features = [extractor(seen) for extractor in self.inner.extractors]
        logits = self.inner.actor(features[0]).split(self.sizes, 1)
        each = [torch.distributions.Categorical(logits=part) for part in logits]
        free = (actions >= 0).T  # the others were not drawn, see SameMinibatches
        logs = sum(one.log_prob(actions[:, k].clamp(0)) * free[k] for k, one in enumerate(each))
        return self.inner.critic(features[-1]), logs, sum(one.entropy() * free[k] for k, one in enumerate(each))


class SameMinibatches(RolloutBuffer):  # type: ignore[misc]  # mypy does not follow it
    """The samples of a rollout, in the minibatches that the learner will make in its next update."""

    def __init__(self, rollout: Rollout, learner: Learner, sizes: list[int]) -> None:
        steps, agents = rollout.values.shape
        super().__init__(steps, spaces.Box(-1, 1, (1,)), spaces.MultiDiscrete(sizes), "cpu", n_envs=agents)
        (self.seen,), self.actions, self.log_probs = rollout.seen.values(), rollout.actions, rollout.log_probs
        if rollout.idle is not None:
            self.actions = np.where(rollout.idle, -1, self.actions)
        self.values, self.advantages, self.returns = rollout.values, rollout.advantages, rollout.returns
        self.chosen = torch.from_numpy(np.flatnonzero(rollout.learner == learner.number))
        self.shuffler = torch.Generator()
        self.shuffler.set_state(learner.generator.get_state())

    def get(self, batch_size: int | None = None) -> Iterator[RolloutBufferSamples]:
        assert batch_size
        shuffled = self.chosen[torch.randperm(len(self.chosen), generator=self.shuffler)]
        arrays = self.actions, self.values, self.log_probs, self.advantages, self.returns
        flat = [torch.from_numpy(array.reshape(-1, *array.shape[2:])) for array in arrays]
        for part in shuffled.tensor_split(round(len(shuffled) / batch_size)):
            yield RolloutBufferSamples(self.seen.select(part), *(array[part] for array in flat))


def update(learner: Learner, rollout: Rollout, sizes: list[int]) -> tuple[ActorCritic, dict[str, float]]:
    """The learner's policy after an update by Stable-Baselines3, and what that logs. The learner stays as it is."""
    numbers = learner.numbers
    model = PPO(
        ActorCriticPolicy,
        None,
        learning_rate=numbers.learning_rate,
        batch_size=numbers.batch_size,
        n_epochs=numbers.n_epochs,
        ent_coef=numbers.ent_coef,
        vf_coef=numbers.vf_coef,
        max_grad_norm=numbers.max_grad_norm,
        target_kl=numbers.target_kl or None,
        device="cpu",
        _init_setup_model=False,
    )
    model._setup_lr_schedule()
    model.clip_range = FloatSchedule(numbers.clip_range)
    model.action_space = spaces.MultiDiscrete(sizes)
    model.policy = PlainPolicy(learner.policy, sizes, numbers.learning_rate)
    model.rollout_buffer = SameMinibatches(rollout, learner, sizes)
    model.set_logger(Logger(None, []))
    model.train()
    return model.policy.inner, dict(model.logger.name_to_value)
