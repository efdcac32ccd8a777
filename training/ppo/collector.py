"""Collecting a rollout."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from ..base.errors import TrainingError
from ..base.hyperparameters import Hyperparameters
from ..policies.policy import Networks
from ..policies.rows import concatenated
from .crew import Crew
from .loss import advantages
from .rollout import DEAREST, RewardScale, Rollout
from .world_slice import CollectedSamples, Lane

Array = np.ndarray[Any, Any]
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

    def _completed(self, samples: CollectedSamples, policies: Sequence[Networks]) -> Rollout:
        def own(name: str) -> Array:
            return np.asarray(getattr(samples, name))

        def everyones(name: str, axis: int = 1) -> Array:
            return self.crew.gather(own(name), axis)

        numbers, rewards, ends = self.numbers, everyones("rewards"), everyones("ends")
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
        rewards = rewards / np.float32(spread) + np.float32(numbers.gamma) * everyones("later")
        seen = {form: concatenated([each[form] for each in samples.seen]) for form in samples.seen[0]}
        values, learner = own("values"), own("learner")
        for number, policy in enumerate(policies):
            if policy.apart:
                its, form = np.flatnonzero(learner == number), policy.preset.form
                for start in range(0, len(its), BATCH):  # a step of few agents costs about as much as a large batch
                    some = its[start : start + BATCH]
                    values.reshape(-1)[some] = policy.values(seen[form].select(torch.from_numpy(some))).numpy()
        values, learner = self.crew.gather(values, 1), self.crew.gather(learner, 1)
        found = advantages(rewards, values, ends, everyones("last", 0), numbers.gamma, numbers.gae_lambda)
        more: dict[str, Any] = {name: own(name) for name in ("actions", "log_probs", "alive", "begins", "memory")}
        more |= {"advantages": found, "learner": learner, "idle": samples.idle, "first": self.first}
        return Rollout(seen=seen, values=values, **more)
