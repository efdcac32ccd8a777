"""The losses of PPO (Schulman et al., arXiv:1707.06347) and of imitation: functions of a batch."""

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..base.config import name_of
from ..base.errors import TrainingError
from .minibatches import Batch

Figures = Mapping[str, Tensor]
Loss = Callable[[Batch], "Tensor | tuple[Tensor, Figures]"]
ALWAYS = ("loss", "approx_kl")  # figures that are logged for every loss
RESERVED = (*ALWAYS, "epochs", "learning_rate", "explained_variance")


def ppo_loss(batch: Batch) -> tuple[Tensor, Figures]:
    """Return PPO's clipped loss of the policy, with the squared error of the values and the entropy."""
    numbers = batch.numbers
    with torch.set_grad_enabled(numbers.ent_coef != 0):  # unused gradients cost time
        entropy = batch.mean(batch.network.choices.entropy(batch.logs, batch.free))
    ratio, clip = batch.ratio, numbers.clip_range
    gains = torch.minimum(batch.advantages * ratio, batch.advantages * ratio.clamp(1 - clip, 1 + clip))
    policy, value = -batch.mean(gains), batch.mean((batch.returns - batch.values).square())
    with torch.no_grad():
        clipped = batch.mean(((ratio - 1).abs() > clip).to(ratio.dtype))
    total = policy + numbers.vf_coef * value - numbers.ent_coef * entropy
    return total, {"policy_loss": policy, "value_loss": value, "entropy": entropy, "clip_fraction": clipped}


def imitation_loss(batch: Batch) -> tuple[Tensor, Figures]:
    """Return the cross-entropy of a teacher's actions, with the squared error of the values."""
    policy, value = -batch.mean(batch.log_probs), batch.mean((batch.returns - batch.values).square())
    with torch.no_grad():
        choices = batch.network.choices
        entropy = batch.mean(choices.entropy(batch.logs, batch.free))
        differs = batch.mean((choices.likeliest(batch.logs) != batch.actions).float().mean(1))
    total = policy + batch.numbers.vf_coef * value
    return total, {"cross_entropy": policy, "value_loss": value, "entropy": entropy, "differs": differs}


def evaluated(loss: Loss, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
    """Return the loss of a batch, and the figures to log, ALWAYS first. Raises TrainingError for other results."""
    found: Any = loss(batch)
    total, own = found if isinstance(found, tuple) and len(found) == 2 else (found, {})
    if not (isinstance(total, Tensor) and total.ndim == 0 and total.requires_grad):
        raise TrainingError(
            f"loss {name_of(loss)} returns {found!r:.100}: it must return a tensor without axes, computed from the "
            "networks' outputs, or this and a dict of figures to log"
        )
    if not isinstance(own, Mapping) or not all(isinstance(name, str) and name.isidentifier() for name in own):
        raise TrainingError(f"loss {name_of(loss)} returns figures {own!r:.100}: they must be a dict by names")
    if taken := sorted(own.keys() & {*RESERVED}):
        raise TrainingError(f"loss {name_of(loss)} returns a figure '{taken[0]}', which is always logged: rename it")
    with torch.no_grad():
        divergence = batch.mean(batch.ratio - 1 - batch.log_ratio)  # http://joschu.net/blog/kl-approx.html
        figures = {"loss": total, "approx_kl": divergence, **own}
        like: dict[str, Any] = {"dtype": total.dtype, "device": total.device}
        kept = {name: torch.as_tensor(each, **like).detach() for name, each in figures.items()}
    if wide := [name for name, each in kept.items() if each.ndim]:
        raise TrainingError(f"loss {name_of(loss)}: its figure '{wide[0]}' must be one number, as of batch.mean(...)")
    return total, kept
