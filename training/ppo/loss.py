"""PPO as functions of tensors: advantages, and the loss of a minibatch (Schulman et al., arXiv:1707.06347)."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from ..base.hyperparameters import Hyperparameters

Array = np.ndarray[Any, Any]
TINY = 1e-8  # is added to the spread of advantages, which may be 0


def advantages(rewards: Array, values: Array, ends: Array, last: Array, gamma: float, gae_lambda: float) -> Array:
    """Generalized advantage estimates (Schulman et al., arXiv:1506.02438), float32 (steps, agents).

    Args:
        rewards: float32 (steps, agents); where an episode was cut off, they include the value of what would have come.
        values: float32 (steps, agents), of what was observed before each step.
        ends: bool (steps, agents), whether nothing of the agent's next step counts for this one.
        last: float32 (agents,), values of what was observed after the last step.
        gamma: Discount of a step.
        gae_lambda: How far estimates look ahead: from 0 (one step) to 1 (to the end).
    """
    found, later = np.empty_like(rewards), np.zeros_like(last)
    for t in reversed(range(len(rewards))):
        goes_on = np.float32(gamma) * ~ends[t]
        following = values[t + 1] if t + 1 < len(rewards) else last
        later = rewards[t] + goes_on * following - values[t] + goes_on * np.float32(gae_lambda) * later
        found[t] = later
    return found


@dataclass(frozen=True)
class Loss:
    """The loss of a minibatch, and what it consists of: tensors without axes."""

    total: Tensor
    policy: Tensor
    value: Tensor
    entropy: Tensor
    divergence: Tensor  # of the old policy from the new one: http://joschu.net/blog/kl-approx.html
    clipped: Tensor  # share of samples whose ratio is clipped

    TAGS: ClassVar = (
        "train/loss",
        *(f"train/{name}" for name in ("policy_loss", "value_loss", "entropy", "approx_kl", "clip_fraction")),
    )

    def figures(self) -> Tensor:
        """All figures, (6,), without gradients, in the order of TAGS."""
        parts = (self.total, self.policy, self.value, self.entropy, self.divergence, self.clipped)
        return torch.stack([part.detach() for part in parts])


def ppo_loss(
    log_probs: Tensor,
    values: Tensor,
    entropy: Tensor,
    *,
    old_log_probs: Tensor,
    advantages: Tensor,
    returns: Tensor,
    weights: Tensor,
    numbers: Hyperparameters,
) -> Loss:
    """The loss of a minibatch. All tensors are float32 (batch,).

    Args:
        log_probs: Log-probabilities of the joint actions under the present policy.
        values: The present critic's values of what was observed.
        entropy: Entropy of the present policy.
        old_log_probs: As log_probs, when the samples were collected.
        advantages: The advantages, already normalised.
        returns: What the values should become.
        weights: How much each sample counts: 0 if it is masked, 1 / number of samples that are not if it is not.
        numbers: The numbers of PPO.
    """
    difference = log_probs - old_log_probs
    ratio = difference.exp()
    clip = numbers.clip_range
    gains = torch.minimum(advantages * ratio, advantages * ratio.clamp(1 - clip, 1 + clip))
    policy, value = -(weights @ gains), weights @ (returns - values).square()
    mean_entropy = weights @ entropy
    with torch.no_grad():
        divergence = weights @ (ratio - 1 - difference)
        clipped = weights @ ((ratio - 1).abs() > clip).to(weights.dtype)
    total = policy + numbers.vf_coef * value - numbers.ent_coef * mean_entropy
    return Loss(total, policy, value, mean_entropy, divergence, clipped)


def imitation_loss(
    log_probs: Tensor,
    values: Tensor,
    entropy: Tensor,
    differs: Tensor,
    *,
    returns: Tensor,
    weights: Tensor,
    numbers: Hyperparameters,
) -> Loss:
    """The loss of a minibatch where a policy learns to imitate a teacher: cross-entropy, and the loss of its values.

    All tensors are float32 (batch,). The divergence is that of the policy from the teacher.

    Args:
        log_probs: Log-probabilities of the teacher's joint actions under the present policy.
        values: The present critic's values of what was observed.
        entropy: Entropy of the present policy.
        differs: Share of the actions in a joint action for which the policy finds another value likeliest; it takes the
            place of clipped.
        returns: What the values should become.
        weights: How much each sample counts, see ppo_loss.
        numbers: The numbers of PPO; only vf_coef matters.
    """
    policy, value = -(weights @ log_probs), weights @ (returns - values).square()
    return Loss(policy + numbers.vf_coef * value, policy, value, weights @ entropy, policy, weights @ differs)


def normalised(advantages: Tensor, weights: Tensor) -> Tensor:
    """Bring advantages (batch,) to mean 0 and spread 1 over the samples that count; weights: see ppo_loss."""
    count = 1 / weights.max()
    centred = advantages - weights @ advantages
    spread = (weights @ centred.square() * count / (count - 1)).sqrt()
    return centred / (spread + TINY)
