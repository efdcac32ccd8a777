"""Detection of diverged learning: numbers that are NaN or infinite, and their source."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..base.errors import TrainingError
from ..policies.checkpoint import HEAVIEST, wrong_weight
from ..policies.rows import PaddedRows
from .trainer import Trainer
from .world_slice import Lane

Array = np.ndarray[Any, Any]
LARGEST = 1e18  # the largest observation: float32 still holds its square
LOSSES = ("train/value_loss", "train/policy_loss", "train/loss", "imitation/value_loss", "imitation/cross_entropy")


def check_learned(trainer: Trainer, tags: Mapping[str, float], what: str, cure: str) -> None:
    """Stop a run that has diverged: its next checkpoint could not be loaded, or it no longer learns.

    Only then are observations searched for the cause, in this process's share of the newest rollout.

    tags: Measurements of the update. what, cure: For the message: what was done and for how long, and settings for a
    new start, unless observations are the cause. Raises TrainingError if weights or a loss are not finite.
    """
    weights = (wrong_weight(policy.state_dict()) for policy in trainer.policies)
    wrong = [f"{name} has numbers that are NaN or beyond {HEAVIEST}" for name in weights if name]
    wrong += [f"{tag} is {tags[tag]}" for tag in LOSSES if not math.isfinite(tags.get(tag, 0.0))]
    if not wrong:
        return
    for name in strange_observations(trainer.lane):
        raise TrainingError(
            f"observations have numbers that are not finite, or beyond {LARGEST:g}: {name}. A mechanic "
            "computes them, as by 0 / 0 or the root of a negative number; outlast check looks for them"
        )
    raise TrainingError(f"{what} {wrong[0]}; begin again {cure}")


def strange_observations(lane: Lane) -> Iterator[str]:
    """Yield keys, with fields where known, of observations that networks cannot use; an agent's own come first."""
    layout, samples, now = lane.packer.layout, lane.samples, lane.env.observe()
    views = [layout.own_views(samples.own), layout.own_views(lane.packer.own(now))]
    last = {form: packer(now) for form, packer in lane.packers.items()}  # what gives the values after the last step
    for seen in (each for step in (*lane.seen, last) for each in step.values()):
        if isinstance(seen, PaddedRows):
            views.append(layout.views(seen.packed.numpy()))
        else:
            ends = np.cumsum([kind.features for kind in layout.kinds])
            parts = np.split(seen.entities.numpy(), ends, 1)  # the last part marks the kind of each entity
            views.append({kind.key: part for kind, part in zip(layout.kinds, parts, strict=False)})
    for each in views:
        for key, values in each.items():
            columns = ~(np.abs(values) <= LARGEST).reshape(-1, values.shape[-1]).all(0)
            names = [name for name, (size, _) in layout.fields.get(key, {}).items() for _ in range(int(size))]
            for column in np.flatnonzero(columns):
                yield f"{key}.{names[column % len(names)]}" if names else key
    states = (each.state for step in lane.seen for each in step.values())
    if any(state is not None and not state.isfinite().all() for state in states):
        yield "the state of the worlds, which critics see"
    if not np.isfinite(samples.later).all():
        yield "those where an episode was cut off"
