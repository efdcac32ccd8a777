"""RLlib: one world as a MultiAgentEnv, for the learners of Ray."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from outlast.ecs import Clock

from ..core.validation import Array
from ..errors import needed
from ..snapshots.state import State
from .base import OneWorldAdapter
from .pettingzoo import Infos, Observations, Outcome, SurvivalParallelEnv, parallel_env

with needed("ray", "SurvivalMultiAgentEnv needs RLlib"):
    from ray.rllib.env.env_context import EnvContext
    from ray.rllib.env.multi_agent_env import MultiAgentEnv

# RLlib's check_multiagent_environments resets with this seed and these options; runs themselves pass no options.
CHECK: tuple[int, dict[str, Any]] = (42, {})


class SurvivalMultiAgentEnv(OneWorldAdapter, MultiAgentEnv):  # type: ignore[misc]  # untyped, see pyproject.toml
    """One world for RLlib; its agents are agent_0, agent_1 ...

    >>> PPOConfig().environment(SurvivalMultiAgentEnv, env_config={"scenario": "ffa_3", "dead": "keep"})

    Observations, actions, rewards, terminated and infos are those of `adapters.parallel_env`. In addition, "__all__" is
    terminated when the world has ended by its rule, and truncated at the time limit, even if agents died in that tick.
    truncated has no other entries: if every agent were truncated by name, RLlib would treat the episode as terminated,
    and would not bootstrap values.

    With config["action_masks"] = True, an agent observes {"observations": as before, "action_mask": float32 (entries,),
    1 for actions that can do something}, where RLlib's ActionMaskingTorchRLModule looks for them; this module needs
    actions="joint" and observations="flat". ("observation" is the form of `parallel_env`, which RLlib does not know.)

    reset(seed=s) starts world 0 of a batch with that seed. In a training run, where each copy plays a world of its own,
    the world is a function of s, config["seed"], worker and copy. Without any seed, worlds are unpredictable. The
    episode by which RLlib checks an environment before a run does not use up a seed.

    config: The arguments of `adapters.parallel_env`, whose errors it raises. base_env: The SurvivalVectorEnv below.
    """

    def __init__(self, config: Mapping[str, Any] | None = None) -> None:
        self._parallel: SurvivalParallelEnv = parallel_env(**(config or {}))
        self.possible_agents = self._parallel.possible_agents
        self.agents = self.possible_agents[:]
        if self._parallel._masked and self._parallel._mask_form is None:
            self._parallel._observe_masks("observations", np.float32)
        self.observation_spaces, self.action_spaces = self._parallel.observation_spaces, self._parallel.action_spaces
        self.metadata, self.render_mode = self._parallel.metadata, self._parallel.render_mode
        super().__init__()
        self._config, self.base_env, self._window = config, self._parallel.base_env, self._parallel._window
        self._seed: int | None = int(self.base_env.worlds[Clock].seed[0, 0])  # the seed in config, or a drawn one
        self._unchecked = isinstance(config, EnvContext)
        self.base_env.first_world = _world(config)
        self._cut = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start an episode: that of `seed`, or the next one. The first reset uses the configuration's seed."""
        checking, self._unchecked = self._unchecked and (seed, options) == CHECK, False
        if not checking:
            seed, self._seed = self._seed if seed is None else seed, None
        observations, infos = self._parallel.reset(seed=seed, options=options)
        self._cut = False
        self.agents = self._parallel.agents
        return observations, infos

    def step(self, action_dict: Mapping[str, Any]) -> Outcome:
        """Take a step as SurvivalParallelEnv does; terminated also has "__all__", and truncated has nothing else."""
        observations, rewards, terminated, truncated, infos = self._parallel.step(action_dict)
        self.agents = self._parallel.agents
        self._cut |= any(truncated.values())  # remains true if step is called again after the end
        terminated["__all__"] = not self.agents and not self._cut
        return observations, rewards, terminated, {"__all__": self._cut}, infos

    def render(self) -> Any:
        """Return the picture, depending on config["render_mode"]."""
        return self._parallel.render()

    def action_masks(self) -> dict[str, Array]:
        return self._parallel.action_masks()

    def set_state(self, state: State) -> Observations:
        observations = self._parallel.set_state(state)
        self.agents, self._cut = self._parallel.agents, bool(self.base_env._truncated[0])
        return observations

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._config,)


def _world(config: Any) -> int:
    """Return the number of the world of this copy of the environment; 0 outside of RLlib."""
    if not isinstance(config, EnvContext):
        return 0
    # copies have to differ, but to RLlib they are equal: those in a worker get the same context object, and when RLlib
    # checks environments, it gives all copies in all workers the same seed, from which they go on if the run has none
    config.copies = getattr(config, "copies", -1) + 1
    place = [config.get("seed") or 0, config.worker_index or 0, config.vector_index, config.copies]
    return int(np.random.SeedSequence(place).generate_state(1, np.uint64)[0] >> np.uint64(2))
