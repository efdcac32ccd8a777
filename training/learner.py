"""A learner: a policy, its optimiser, and updates from rollouts."""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn

from .crew import Crew
from .hyperparameters import Hyperparameters
from .loss import Loss, imitation_loss, normalised, ppo_loss
from .policy import ActorCritic
from .rollout import Rollout
from .rows import moved

Array = np.ndarray[Any, Any]
KL_STOP = 1.5  # times target_kl, as in Stable-Baselines3
DIVERGENCE = Loss.TAGS.index("train/approx_kl")


class Learner:
    """Trains a policy with PPO.

    Attributes:
        optimizer: Adam.
        epochs: Begun so far, in all updates.
    """

    def __init__(
        self,
        policy: ActorCritic,
        numbers: Hyperparameters,
        generator: torch.Generator,
        number: int = 0,
        crew: Crew | None = None,
    ) -> None:
        """Make an optimiser for a policy.

        Args:
            policy: On the device where it is to be trained.
            numbers: Of PPO.
            generator: Shuffles samples; on the CPU.
            number: Which samples are this learner's, see Rollout.learner.
            crew: Processes that train together. All have equal policies and generators, and make the same minibatches;
                each computes gradients of the samples that are its own.
        """
        self.crew = crew or Crew()
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
        chosen = torch.from_numpy(np.flatnonzero(rollout.learner == self.number))
        if len(chosen) < 2:
            return {}
        rate = self.numbers.learning_rate * (left if self.numbers.anneal else 1)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        wanted = max(1, round(len(chosen) / self.numbers.batch_size))
        samples, batches = Samples(rollout, self.device), min(wanted, len(chosen) // 2)  # one has no spread
        figures, steps, going = list[Tensor](), 0, True
        for epoch in range(1, self.numbers.n_epochs + 1):
            on_epoch(epoch)
            self.epochs += 1
            shuffled = chosen[torch.randperm(len(chosen), generator=self.generator)]
            for part in shuffled.tensor_split(batches):
                figures.append(self._differentiate(samples, part))
                going = not self._diverged(figures[-1])
                if not going:
                    break
                nn.utils.clip_grad_norm_(self.parameters, self.numbers.max_grad_norm)
                self.optimizer.step()
                steps += 1
            if not going:
                break
        means = dict(zip(Loss.TAGS, torch.stack(figures).mean(0).tolist(), strict=True))
        return means | {
            "train/epochs": steps / batches,
            "train/learning_rate": rate,
            "train/explained_variance": explained_variance(rollout, chosen.numpy()),
        }

    def _differentiate(self, samples: "Samples", part: Tensor) -> Tensor:
        """The figures of the loss of a minibatch, samples `part`; its gradients are left in the parameters."""
        self.optimizer.zero_grad()
        where, own = samples.rollout.here(part)
        if len(own):
            loss = self._loss(samples, part, where, own)
            torch.autograd.backward(loss.total)
            figures = loss.figures()
        else:  # all are other processes'
            figures = torch.zeros(len(Loss.TAGS), device=self.device)
            for parameter in self.parameters:
                parameter.grad = torch.zeros_like(parameter)
        self.crew.sum([figures, *(cast(Tensor, parameter.grad) for parameter in self.parameters)])
        return figures

    def _loss(self, samples: "Samples", part: Tensor, where: Tensor | None, own: Tensor) -> Loss:
        """This process's share of the loss of a minibatch.

        Args:
            samples: Of the rollout.
            part: Numbers of the minibatch's samples among those of all processes.
            where: Which of these are this process's; None: all.
            own: Their numbers among its own.
        """
        choices, numbers = self.policy.choices, self.numbers
        gained, weights = samples.of_all(part)
        gained = normalised(gained, weights)
        if where is not None:
            index = moved(where, self.device)
            gained, weights = gained.index_select(0, index), weights.index_select(0, index)
        actions, log_probs, returns = samples.select(own)
        logs, values, _ = self.policy(samples.seen.select(own))
        with torch.set_grad_enabled(numbers.ent_coef != 0):  # gradients that nothing needs cost time
            entropy = choices.entropy(logs)
        return ppo_loss(
            choices.of(actions, logs),
            values,
            entropy,
            old_log_probs=log_probs,
            advantages=gained,
            returns=returns,
            weights=weights,
            numbers=numbers,
        )

    def _diverged(self, figures: Tensor) -> bool:
        limit = self.numbers.target_kl  # without one, nobody waits for a GPU here
        return bool(limit and figures[DIVERGENCE] > KL_STOP * limit)


class Imitator(Learner):
    """Trains a policy to take the actions of a rollout, which are a teacher's, and its critic as PPO does."""

    def _loss(self, samples: "Samples", part: Tensor, where: Tensor | None, own: Tensor) -> Loss:
        choices = self.policy.choices
        actions, _, returns = samples.select(own)
        logs, values, _ = self.policy(samples.seen.select(own))
        weights = torch.full_like(returns, 1 / len(part))
        with torch.no_grad():
            entropy, differs = choices.entropy(logs), (choices.likeliest(logs) != actions).float().mean(1)
        chosen = choices.of(actions, logs)
        given = {"returns": returns, "weights": weights}
        return imitation_loss(chosen, values, entropy, differs, numbers=self.numbers, **given)


class Samples:
    """The samples of a rollout as flat tensors on a device; on the CPU, views of its arrays."""

    def __init__(self, rollout: Rollout, device: torch.device) -> None:
        self.rollout, self.device, self.seen = rollout, device, rollout.seen.to(device)
        returns = rollout.returns[:, rollout.first : rollout.first + rollout.actions.shape[1]]
        self.advantages, *self.own = (
            moved(torch.from_numpy(each.reshape(-1, *each.shape[2:])), device)
            for each in (rollout.advantages, rollout.actions, rollout.log_probs, returns)
        )

    def of_all(self, part: Tensor) -> tuple[Tensor, Tensor]:
        """Advantages of some samples of all processes, numbers on the CPU, and weights: one over how many these are."""
        found = self.advantages.index_select(0, moved(part, self.device))
        return found, torch.full_like(found, 1 / len(part))

    def select(self, part: Tensor) -> list[Tensor]:
        """Actions, their old log probabilities and returns of some samples of this process, numbers on the CPU."""
        index = moved(part, self.device)
        return [each.index_select(0, index) for each in self.own]


def explained_variance(rollout: Rollout, chosen: Array) -> float:
    """The share of the variance of returns that values explain: 1 is all; NaN where returns do not vary."""
    returns = rollout.returns.ravel()[chosen]
    variance = returns.var()
    return float(1 - rollout.advantages.ravel()[chosen].var() / variance) if variance else float("nan")
