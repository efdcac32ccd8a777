"""A learner: a policy, its optimiser, and updates from rollouts."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .hyperparameters import Hyperparameters
from .loss import Loss, imitation_loss, normalised, ppo_loss
from .minibatches import Chunks, Samples
from .policy import ActorCritic
from .rollout import Rollout

Array = np.ndarray[Any, Any]
KL_STOP = 1.5  # times target_kl, as in Stable-Baselines3


class Learner:
    """Trains a policy with PPO.

    Attributes:
        optimizer: Adam.
        epochs: Begun so far, in all updates.
    """

    def __init__(
        self, policy: ActorCritic, numbers: Hyperparameters, generator: torch.Generator, number: int = 0
    ) -> None:
        """Make an optimiser for a policy.

        Args:
            policy: On the device where it is to be trained.
            numbers: Of PPO.
            generator: Shuffles samples; on the CPU.
            number: Which samples are this learner's, see Rollout.learner.
        """
        self.policy, self.numbers, self.generator, self.number = policy, numbers, generator, number
        self.parameters = list(policy.parameters())
        self.device = self.parameters[0].device
        self.optimizer = torch.optim.Adam(self.parameters, numbers.learning_rate, eps=1e-5, fused=True)
        self.epochs = 0

    def update(
        self, rollout: Rollout, left: float = 1.0, on_epoch: Callable[[int], None] = lambda epoch: None
    ) -> dict[str, float]:
        """Train on a rollout.

        Args:
            rollout: Some of whose samples are this learner's.
            left: Share of the run that is left, for a learning rate that is annealed.
            on_epoch: Called with the number of each epoch of this update as it begins.

        Returns:
            What is logged, by tag; nothing where fewer than two samples are this learner's.
        """
        chosen = np.flatnonzero(rollout.learner == self.number)
        if len(chosen) < 2:
            return {}
        rate = self.numbers.learning_rate * (left if self.numbers.anneal_lr else 1)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        samples = (Chunks if self.policy.memory else Samples)(rollout, self.number, self.device)
        units, wanted = samples.units, max(1, round(len(chosen) / self.numbers.batch_size))
        batches = max(1, min(wanted, len(units) // 2))  # one sample has no spread
        figures, steps, going = list[Tensor](), 0, True
        for epoch in range(1, self.numbers.n_epochs + 1):
            on_epoch(epoch)
            self.epochs += 1
            shuffled = units[torch.randperm(len(units), generator=self.generator)]
            for part in shuffled.tensor_split(batches):
                loss = self._loss(samples, part)
                figures.append(loss.figures())
                going = not self._diverged(loss)
                if not going:
                    break
                self._descend(loss.total)
                steps += 1
            if not going:
                break
        means = dict(zip(Loss.TAGS, torch.stack(figures).mean(0).tolist(), strict=True))
        return means | {
            "train/epochs": steps / batches,
            "train/learning_rate": rate,
            "train/explained_variance": explained_variance(rollout, chosen),
        }

    def _loss(self, samples: Samples, part: Tensor) -> Loss:
        """The loss of a minibatch, units `part` of the samples."""
        choices, numbers, batch = self.policy.choices, self.numbers, samples.select(part)
        logs, values, _ = self.policy(batch.seen, batch.memory, batch.begins)
        with torch.set_grad_enabled(numbers.ent_coef != 0):  # gradients that nothing needs cost time
            entropy = choices.entropy(logs)
        return ppo_loss(
            choices.of(batch.actions, logs),
            values,
            entropy,
            old_log_probs=batch.log_probs,
            advantages=normalised(batch.advantages, batch.weights),
            returns=batch.returns,
            weights=batch.weights,
            numbers=numbers,
        )

    def _diverged(self, loss: Loss) -> bool:
        limit = self.numbers.target_kl
        return bool(limit and loss.divergence > KL_STOP * limit)

    def _descend(self, total: Tensor) -> None:
        self.optimizer.zero_grad()
        torch.autograd.backward(total)
        nn.utils.clip_grad_norm_(self.parameters, self.numbers.max_grad_norm)
        self.optimizer.step()


class Imitator(Learner):
    """Trains a policy to take the actions of a rollout, which are a teacher's, and its critic as PPO does."""

    def _loss(self, samples: Samples, part: Tensor) -> Loss:
        choices, batch = self.policy.choices, samples.select(part)
        logs, values, _ = self.policy(batch.seen, batch.memory, batch.begins)
        with torch.no_grad():
            entropy, differs = choices.entropy(logs), (choices.likeliest(logs) != batch.actions).float().mean(1)
        chosen = choices.of(batch.actions, logs)
        return imitation_loss(
            chosen, values, entropy, differs, returns=batch.returns, weights=batch.weights, numbers=self.numbers
        )


def explained_variance(rollout: Rollout, chosen: Array) -> float:
    """The share of the variance of returns that values explain: 1 is all; NaN where returns do not vary."""
    returns = rollout.returns.ravel()[chosen]
    variance = returns.var()
    return float(1 - rollout.advantages.ravel()[chosen].var() / variance) if variance else float("nan")
