"""Collecting a rollout from all lanes."""

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
from .world_slice import Lane

Array = np.ndarray[Any, Any]
BATCH = 4096  # samples of a rollout that are valued at once


class Collector:
    """Plays in all lanes and joins their samples.

    With one lane, networks and worlds take turns. With two, the worlds of one are stepped in the background while the
    networks are busy with the other. Networks run on one thread: others would compete with those of the worlds, and
    wait for each other in every small product.

    lanes: The lanes of this process, in order of their worlds. scale: The scale of rewards, computed from those of all
    processes.
    """

    def __init__(self, lanes: Sequence[Lane], numbers: Hyperparameters, crew: Crew) -> None:
        self.lanes, self.numbers, self.crew = lanes, numbers, crew
        own = sum(lane.agents for lane in lanes)
        each = crew.gather_values(own)
        self.first, self.scale = sum(each[: crew.rank]), RewardScale(sum(each), numbers.gamma)

    def restart(self) -> None:
        """Restart the episodes of all worlds, in the levels that were chosen."""
        for lane in self.lanes:
            lane.restart()
        self.scale.sums[:] = 0

    @torch.inference_mode()
    def collect(self, policies: Sequence[Networks], steps: int, begun: int) -> Rollout:
        """Play on from where the worlds are, and keep what happens.

        policies: The policies of the learners. steps: How many steps to play in each world. begun: How many steps each
        world has played before.
        """
        for lane in self.lanes:
            lane.open(steps, policies)
        if len(self.lanes) == 1:
            (lane,) = self.lanes
            for t in range(steps):
                lane.take(t, lane.env.step(lane.act(t, begun + t, policies)), policies)
        else:
            for t in range(steps + 1):
                for lane in self.lanes:
                    if t:
                        lane.take(t - 1, lane.env.recv(), policies)
                    if t < steps:
                        lane.env.send(lane.act(t, begun + t, policies))
        return self._joined([lane.close(policies) for lane in self.lanes], policies)

    def _joined(self, parts: Sequence[Any], policies: Sequence[Networks]) -> Rollout:
        def joined(name: str, axis: int = 1) -> Array:
            each = [np.asarray(getattr(part, name)) for part in parts]
            return each[0] if len(each) == 1 else np.concatenate(each, axis)

        def everyones(name: str, axis: int = 1) -> Array:
            return self.crew.gather(joined(name, axis), axis)

        numbers, rewards, ends = self.numbers, everyones("rewards"), everyones("ends")
        if not np.isfinite(rewards).all():
            raise TrainingError(
                "rewards are no finite numbers (NaN or infinity): a mechanic computes them, as by 0 / 0 or the root of "
                "a negative number; outlast rollout with --interpret shows where"
            )
        spread = self.scale.update(rewards, ends) if numbers.scale_rewards else 1.0
        if self.scale.wrong() or (np.abs(rewards) > DEAREST).any():
            raise TrainingError(
                f"rewards, or their discounted sums, are beyond {DEAREST:g}, and no run goes on with those: pay less"
            )
        rewards = rewards / np.float32(spread) + np.float32(numbers.gamma) * everyones("later")
        seen = concatenated([each for step in zip(*(part.seen for part in parts), strict=True) for each in step])
        values, learner = joined("values"), joined("learner")
        for number, policy in enumerate(policies):
            if policy.apart:
                own = np.flatnonzero(learner == number)
                for start in range(0, len(own), BATCH):  # a step of few agents costs about as much as a large batch
                    some = own[start : start + BATCH]
                    values.reshape(-1)[some] = policy.values(seen.select(torch.from_numpy(some))).numpy()
        values, learner = self.crew.gather(values, 1), self.crew.gather(learner, 1)
        found = advantages(rewards, values, ends, everyones("last", 0), numbers.gamma, numbers.gae_lambda)
        kept = {name: joined(name) for name in ("actions", "log_probs", "alive", "begins", "memory")}
        idle = None if parts[0].idle is None else joined("idle")
        return Rollout(seen=seen, values=values, advantages=found, learner=learner, idle=idle, first=self.first, **kept)
