"""PPO of Stable-Baselines3 for all agents of many worlds, which share one policy."""

import warnings
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import explained_variance, get_device

import outlast
from outlast.envs.scenarios.scenario import Scenario

from .collector import Collector
from .errors import TrainingError
from .hyperparameters import PAPER, ROLLOUT, check_ranges
from .observation_layout import field_table, layout_of, scales
from .policy import ActorCritic
from .presets import DEAD, Preset
from .rollout_buffer import AgentRolloutBuffer


class SharedPPO(PPO):  # type: ignore[misc]  # mypy does not follow it
    """One policy for every agent of `worlds` worlds of a scenario. num_timesteps counts agent-steps.

    A rollout has `steps` environment steps, steps / worlds of each world. dead: see Collector. hyperparameters: of PPO,
    other than the paper's. Raises ScenarioError, TrainingError.
    """

    def __init__(
        self,
        scenario: Scenario,
        preset: Preset,
        *,
        worlds: int = 64,
        steps: int = ROLLOUT,
        seed: int = 0,
        dead: str = "keep",
        device: str = "cpu",
        threads: int = 1,
        **hyperparameters: Any,
    ) -> None:
        if dead not in DEAD:
            raise TrainingError(f"dead = {dead!r}: allowed are {', '.join(map(repr, DEAD))}")
        if get_device(device).type != torch.device(device).type:
            raise TrainingError(f"there is no {device} here; take cpu")
        if steps % worlds:
            raise TrainingError(f"a rollout of {steps} steps cannot be shared evenly by {worlds} worlds")
        check_ranges(hyperparameters)
        env = outlast.make_sb3(preset.scenario(scenario), worlds, seed=seed, threads=threads, check_actions=False)
        self.base_env, self.preset = env.base_env, preset
        layout = layout_of(self.base_env)
        self.generator = torch.Generator(get_device(device)).manual_seed(seed)  # of actions
        self.shuffler = torch.Generator().manual_seed(seed)  # of minibatches
        with warnings.catch_warnings():  # of a last minibatch that is smaller, which AgentRolloutBuffer does not make
            warnings.filterwarnings("ignore", "You have specified a mini-batch size")
            super().__init__(
                _make_policy,
                env,
                n_steps=steps // worlds,
                seed=seed,
                device=device,
                policy_kwargs={
                    "layout": layout,
                    "preset": preset,
                    "scales": scales(layout, field_table(self.base_env.fields)),
                },
                rollout_buffer_class=AgentRolloutBuffer,
                rollout_buffer_kwargs={"layout": layout, "dead": dead, "generator": self.shuffler},
                **(PAPER | hyperparameters),
            )
        self.collector = Collector(self.base_env, dead)

    def collect_rollouts(
        self, env: Any, callback: BaseCallback, rollout_buffer: AgentRolloutBuffer, n_rollout_steps: int
    ) -> bool:
        """Collect a rollout as Stable-Baselines3 calls for it; the callback sees rollouts, not steps."""
        callback.on_rollout_start()
        self.collect()
        callback.on_rollout_end()
        return bool(callback.on_step())

    def start(self) -> None:
        """Start the worlds with the seed's first episodes."""
        self._last_obs: Any = self.base_env.reset(seed=self.seed)[0]

    def collect(self) -> None:
        """Fill the rollout buffer. The first call starts the worlds."""
        if self._last_obs is None:
            self.start()
        self.collector.fill(self.rollout_buffer, self.policy, self.generator)
        self.num_timesteps += self.rollout_buffer.alive.size

    def train(self) -> None:
        """Update the policy from the rollout; also log how many epochs that took, the last one in part."""
        before = self._optimiser_steps()
        self.policy.entropy_gradients = self.ent_coef != 0
        super().train()
        buffer, kept = self.rollout_buffer, self.rollout_buffer.trained_on
        batches = max(1, round(int(kept.sum()) / self.batch_size))
        self.logger.record("train/epochs", (self._optimiser_steps() - before) / batches)
        self.logger.record("train/explained_variance", explained_variance(buffer.values[kept], buffer.returns[kept]))

    def _optimiser_steps(self) -> int:
        states = self.policy.optimizer.state
        return max((int(state["step"]) for state in states.values()), default=0)


def _make_policy(observation_space: Any, action_space: Any, lr_schedule: Any, use_sde: Any, **more: Any) -> ActorCritic:
    """The policy, from the arguments with which Stable-Baselines3 makes one."""
    return ActorCritic([int(size) for size in action_space.nvec], lr_schedule, **more)
