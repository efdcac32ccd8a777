"""Collecting a rollout."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ..base.errors import TrainingError
from ..base.hyperparameters import Hyperparameters
from ..policies.policy import Networks
from .crew import Crew
from .loss import advantages
from .rollout import DEAREST, RewardScale, Rollout
from .world_slice import Lane

BATCH = 4096  # samples of a rollout that are valued at once


class Collector:
    """A collector that plays in the lane of this process and adds the results of other processes.

    Networks and worlds take turns. Two alternatives were tried and are slower: halves of the worlds on two threads, and
    stepping worlds while networks compute for others. Half of a step's time is Python's, which threads cannot share.

    lane: The worlds of this process. scale: The scale of rewards, computed from those of all processes.
    """

    def __init__(self, lane: Lane, numbers: Hyperparameters, crew: Crew) -> None:
        self.lane, self.numbers, self.crew = lane, numbers, crew
        each = crew.gather_values(lane.agents)
        self.first, self.scale = sum(each[: crew.rank]), RewardScale(sum(each), numbers.gamma)

    def restart(self) -> None:
        """Restart the episodes of all worlds, in the levels that were chosen."""
        self.lane.restart()
        self.scale.sums[:] = 0

    @torch.inference_mode()
    def collect(self, policies: Sequence[Networks], steps: int, begun: int) -> Rollout:
        """Continue to play in the worlds, and return the samples.

        policies: The policies of the learners. steps: Number of steps to play in each world. begun: Number of steps
        played in each world before.
        """
        lane = self.lane
        lane.open(steps, policies)
        for t in range(steps):
            lane.take(t, lane.env.step(lane.act(t, begun + t, policies)), policies)
        return self._completed(lane.close(policies), policies)

    def _completed(self, rollout: Rollout, policies: Sequence[Networks]) -> Rollout:
        """Return the samples with the advantages, and with what is of all processes."""
        numbers, gather = self.numbers, self.crew.gather
        rewards, ends = gather(rollout.rewards, 1), gather(rollout.ends, 1)
        if not np.isfinite(rewards).all():
            raise TrainingError(
                "rewards are not finite (NaN or infinity): a mechanic computes them, as by 0 / 0 or the root of "
                "a negative number; outlast rollout with --interpret shows where"
            )
        spread = self.scale.update(rewards, ends) if numbers.scale_rewards else 1.0
        if self.scale.wrong() or (np.abs(rewards) > DEAREST).any():
            raise TrainingError(
                f"rewards, or their discounted sums, are beyond {DEAREST:g}, which training cannot use: pay less"
            )
        rewards = rewards / np.float32(spread) + np.float32(numbers.gamma) * gather(rollout.later, 1)
        for number, policy in enumerate(policies):
            if policy.apart:
                its, form = np.flatnonzero(rollout.learner == number), policy.preset.form
                for start in range(0, len(its), BATCH):  # a step of few agents costs about as much as a large batch
                    some = its[start : start + BATCH]
                    found = policy.values(rollout.seen[form].select(torch.from_numpy(some)))
                    rollout.values.reshape(-1)[some] = found.numpy()
        values, last = gather(rollout.values, 1), gather(rollout.last, 0)
        return replace(
            rollout,
            values=values,
            learner=gather(rollout.learner, 1),
            advantages=advantages(rewards, values, ends, last, numbers.gamma, numbers.gae_lambda),
            first=self.first,
        )
