"""The rollout buffer: one contiguous array for each quantity, filled in place, of all agents of all worlds."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.type_aliases import RolloutBufferSamples

from .observation_layout import ObservationLayout

Array = np.ndarray[Any, Any]


class AgentRolloutBuffer(RolloutBuffer):  # type: ignore[misc]  # mypy does not follow it
    """Stable-Baselines3's rollout buffer, whose arrays (steps, agents of all worlds, ...) are allocated once.

    observations: packed, float32; one step more than the others, with which the next rollout starts. alive: bool;
    whether the agent lived when it observed. on_epoch: called with the number of each epoch as it begins.
    """

    def __init__(
        self, *args: Any, layout: ObservationLayout, dead: str, generator: torch.Generator, **options: Any
    ) -> None:
        self.layout, self.dead, self.generator = layout, dead, generator
        self.on_epoch: Callable[[int], None] = lambda epoch: None
        self._allocated = False
        super().__init__(*args, **options)

    @property
    def trained_on(self) -> Array:
        """Which samples updates are made from, bool: all, or with dead = "drop" those of living agents."""
        return self.alive if self.dead == "drop" else np.ones_like(self.alive)

    def reset(self) -> None:
        """Begin a new rollout where the last one ended."""
        if not self._allocated:
            self._allocate()
        self.pos, self.full, self.generator_ready, self.epochs = 0, False, False, 0

    def _allocate(self) -> None:
        shape = (self.buffer_size, self.n_envs)
        self.observations = np.zeros((self.buffer_size + 1, self.n_envs, self.layout.size), np.float32)
        self.actions = np.zeros((*shape, self.action_dim), np.int64)
        for name in ("rewards", "returns", "episode_starts", "values", "log_probs", "advantages"):
            setattr(self, name, np.zeros(shape, np.float32))
        self.alive = np.ones(shape, bool)
        self._allocated = True

    def get(self, batch_size: int) -> Iterator[RolloutBufferSamples]:
        """Minibatches of one epoch: every sample once, in random order, in parts of about equal size."""
        if not self.generator_ready:
            self._flatten()
        self.epochs += 1
        self.on_epoch(self.epochs)
        chosen = self._chosen[torch.randperm(len(self._chosen), generator=self.generator)].to(self.device)
        for part in chosen.tensor_split(max(1, round(len(chosen) / batch_size))):
            yield RolloutBufferSamples(*(flat.index_select(0, part) for flat in self._flat))

    def _flatten(self) -> None:
        """Once for a rollout: all samples as flat tensors, views of the arrays where the network runs on the CPU."""
        arrays = self.observations[:-1], self.actions, self.values, self.log_probs, self.advantages, self.returns
        count = self.buffer_size * self.n_envs
        self._flat = [torch.from_numpy(each.reshape(count, *each.shape[2:])).to(self.device) for each in arrays]
        self._chosen = torch.from_numpy(np.flatnonzero(self.trained_on))
        self.generator_ready = True
