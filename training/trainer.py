"""Training of one policy for all agents of many worlds: collect, update, again."""

from collections.abc import Callable
from typing import Any

import torch

import outlast

from .collector import Collector
from .config import TrainingConfig
from .errors import TrainingError
from .learner import Learner
from .observation_layout import field_table, layout_of, scales
from .policy import ActorCritic
from .presets import preset
from .rollout import Rollout
from .rows import Packer


class Trainer:
    """One policy for every agent of the worlds of a scenario.

    Attributes:
        env: The worlds.
        policy: What is trained.
        learner: What trains it.
        collector: What plays.
        steps: Agent-steps collected so far.
    """

    def __init__(self, config: TrainingConfig, threads: int = 1) -> None:
        """Make worlds and networks.

        Args:
            config: What to train, and how.
            threads: That share the worlds.

        Raises:
            ScenarioError: The scenario cannot be played.
            TrainingError: There is no such device.
        """
        self.config, self.device, self.preset = config, _device(config.device), preset(config.preset)
        (worlds, rollout), seed, numbers = config.size, config.seed, config.numbers
        self.env = outlast.make_vec(
            self.preset.scenario(config.scenario),
            worlds,
            seed=seed,
            threads=threads,
            autoreset_mode="Disabled",
            copy=False,
            check_actions=False,
        )
        self.env.reset(seed=seed)
        self.layout, self.rollout_steps = layout_of(self.env), rollout // worlds
        torch.manual_seed(seed)  # of initial weights
        self.policy = ActorCritic(
            [int(size) for size in self.env.action_sizes],
            layout=self.layout,
            preset=self.preset,
            scales=scales(self.layout, field_table(self.env.fields)),
        ).to(self.device)
        self.generator = torch.Generator(self.device).manual_seed(seed)  # of actions
        self.learner = Learner(self.policy, numbers, torch.Generator().manual_seed(seed))
        packer = Packer(self.layout, leaky=self.preset.leaky)
        self.collector = Collector(self.env, packer, numbers, config.dead, self.device)
        self.steps = 0

    def collect(self) -> Rollout:
        """Play on and keep the samples."""
        rollout = self.collector.collect(self.policy, self.rollout_steps, self.generator)
        self.steps += rollout.alive.size
        return rollout

    def update(
        self, rollout: Rollout, left: float = 1.0, on_epoch: Callable[[int], None] = lambda epoch: None
    ) -> dict[str, float]:
        """Train on a rollout; what is logged. See Learner.update."""
        return self.learner.update(rollout, left, on_epoch)

    def report(self, rollout: Rollout) -> dict[str, float]:
        """What is logged of a rollout, by tag: episodes that ended in it, and what agents did."""
        return self.collector.episodes.report() | self.collector.behaviour.report(rollout, self.layout)


def _device(name: Any) -> torch.device:
    """Raises TrainingError where there is no such device."""
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        raise TrainingError(f"there is no {name} here; take cpu") from error
    return device
