"""Stable-Baselines3: every agent of every world is a sub-environment of a VecEnv."""

from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np

from ..core.validation import Array, as_array, check_count, keys
from ..core.vector_env import Arrays, world_options
from ..errors import PendingError, needed
from ..rendering.rgb import Window, draw
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .base import Adapter, requested
from .gymnasium_agents import SurvivalAgentVectorEnv

with needed("sb3", "make_sb3 needs Stable-Baselines3"):
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import tile_images


@checks_keywords
def make_sb3(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    seed: int | None = None,
    threads: int = 1,
    max_episode_steps: int | None = None,
    check_actions: bool = True,
    render_mode: str | None = None,
    render_worlds: int = 1,
    actions: str = "multi",
    observations: str = "dict",
    scaled: bool = False,
    **numbers: Unpack[Numbers],
) -> "SurvivalVecEnv":
    """Make all agents of `num_worlds` worlds for Stable-Baselines3.

    >>> model = PPO("MultiInputPolicy", VecMonitor(outlast.adapters.make_sb3("ffa_1", 64, seed=0)))

    Arguments that are not listed, numbers and errors are those of `outlast.make_vec`.

    Args:
        max_episode_steps: Ticks after which a world is truncated; it sets the scenario's ending_limit.
        render_mode: None or "rgb_array"; render(mode="human") also needs "rgb_array".
        render_worlds: How many worlds, from the first on, render() shows.
    """
    check_count("render_worlds", render_worlds, 1)
    if render_mode not in (None, "rgb_array"):
        raise ValueError(f"render_mode = {render_mode!r}: None or 'rgb_array' is needed")
    asked = requested(make_sb3, scenario, numbers, max_episode_steps)
    agents = SurvivalAgentVectorEnv(asked, num_worlds, autoreset_mode="SameStep", **world_options(locals()))
    return SurvivalVecEnv(agents, seed=seed, render_worlds=render_worlds)


class SurvivalVecEnv(Adapter, VecEnv):  # type: ignore[misc]  # mypy does not follow it
    """All agents of all worlds: sub-environment w * num_agents + i is agent i of world w.

    Observations: dict of float32 (num_envs, ...), or a flat array; copies, because SB3's algorithms keep the last ones
    during a step. Actions: as in the action space; `action_masks` is what MaskablePPO of sb3-contrib calls. Rewards:
    float32 (num_envs,). Dones: bool (num_envs,).

    An agent is done when its world ends, and starts again in that very step. Until then a dead agent stays (dead="keep"
    of other adapters): it has the rewards and observations of the scenario, and its actions are ignored. Every info has
    "alive" (1 or 0) and "TimeLimit.truncated". If the world ended, it also has "terminal_observation"; "statistics" of
    the episode, where agents and sides have an entry each the agent's own; and each statistic by its name, such as
    "kills", where VecMonitor's info_keywords look for it. "alive" then refers to the terminal observation.

    If the number of agents varies, infos also have "present", 1 or 0. Agents that an episode lacks are done with their
    world, and have no "statistics". VecMonitor does not know of them, and counts a return of 0.

    base_env: The SurvivalVectorEnv below, whose autoreset mode is NEXT_STEP.
    """

    def __init__(self, agents: SurvivalAgentVectorEnv, *, seed: int | None, render_worlds: int) -> None:
        self._agents, self.base_env = agents, agents.base_env
        self.render_mode, self.render_worlds = agents.render_mode, render_worlds
        self.num_worlds, self.num_agents = agents.num_worlds, agents.num_agents
        super().__init__(agents.num_envs, agents.single_observation_space, agents.single_action_space)
        self.metadata = {key: agents.metadata[key] for key in ("name", "render_fps")} | {"render_modes": ["rgb_array"]}
        self._actions: Array | None = None
        self._window: Window | None = None
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> list[int]:
        """Seed world w by (seed, w) at the next reset; None: by an unpredictable seed. Returns it once for each agent.

        Stable-Baselines3's own environments get seed + their number instead. Here, seeds 0 and 1 would then have all
        worlds but one in common, and learners trained with each of them would see nearly the same sample.
        """
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        keys(seed, 1, 0)
        self._seeds = [int(seed)] * self.num_envs
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Do nothing, as worlds have no options: ValueError for anything but empty ones."""
        if any(options) if isinstance(options, list) else options:
            raise ValueError(f"options = {options!r}: worlds take none; change the scenario's numbers instead")

    def reset(self) -> Arrays:
        """Start new episodes in all worlds. A step that has begun is dropped."""
        self._actions = None
        observations, info = self._agents.reset(seed=self._seeds[0])
        self._reset_seeds()
        self.reset_infos = _infos(info)
        return observations

    def step_async(self, actions: Array) -> None:
        """Store the actions of a step, which `step_wait` checks and takes. Raises PendingError."""
        if self._actions is not None:
            raise PendingError("step_async() after step_async(): call step_wait(), or reset(), first")
        self._actions = as_array(actions).copy()

    def step_wait(self) -> tuple[Arrays, Array, Array, list[dict[str, Any]]]:
        """Advance every world by one tick, and begin new episodes where worlds ended. Refused calls change nothing."""
        if self._actions is None:
            raise PendingError("step_wait() without step_async()")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, info = self._agents.step(actions)
        infos = _infos(info)
        if (done := terminated | truncated).any():
            last, own = _infos(info["final_info"]), {key: each.tolist() for key, each in info["statistics"].items()}
            for i in np.flatnonzero(done).tolist():
                found = {key: values[i] for key, values in own.items()}
                self.reset_infos[i] = infos[i]
                infos[i] = found | last[i] | {"terminal_observation": info["final_obs"][i]}
                if info["_statistics"][i]:
                    infos[i]["statistics"] = found
        for each, cut in zip(infos, (truncated & ~terminated).tolist(), strict=True):
            each["TimeLimit.truncated"] = cut
        return observations, rewards, done, infos

    def close(self) -> None:
        """Close threads and window; a later reset or step raises ClosedError."""
        if self._window is not None:
            self._window.close()
        self._agents.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of this object, which all sub-environments share, once for each of them."""
        return [getattr(self, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of this object. As all sub-environments share it, ValueError unless all are given."""
        if len(set(self._chosen(indices))) < self.num_envs:
            raise ValueError(f"'{attr_name}' is shared by all sub-environments; leave out indices")
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Call a method of sub-environments: render(), a picture of their world, or action_masks(), bool (entries,)."""
        if method_name not in ("render", "action_masks") or args or kwargs:
            known = "the methods render() and action_masks() and no other"
            raise AttributeError(f"sub-environments have {known}; {method_name} was asked for")
        if method_name == "action_masks":
            return list(self.action_masks()[self._chosen(indices)])
        return self._pictures([i // self.num_agents for i in self._chosen(indices)])

    def action_masks(self) -> Array:
        """Return which actions can do something, bool (num_envs, entries); see SurvivalVectorEnv.action_masks."""
        return self._agents.action_masks()

    def set_state(self, state: State) -> Arrays:
        """Go on from `state`, as `make_agents` does. A step that has begun is dropped."""
        observations = self._agents.set_state(state)
        self._actions = None
        return observations

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return False: single environments, which could be wrapped, do not exist."""
        return [False] * len(self._chosen(indices))

    def get_images(self) -> list[Array]:
        """Return a picture, uint8 (size, size, 3), for each sub-environment; agents of one world share one array."""
        return self._pictures([i // self.num_agents for i in range(self.num_envs)])

    def render(self, mode: str | None = None) -> Array | None:
        """Draw the first `render_worlds` worlds side by side, uint8 (height, width, 3); mode "human": in a window."""
        if self.render_mode != "rgb_array" or mode not in (None, "rgb_array", "human"):
            # Stable-Baselines3 warns that there is nothing to draw, and returns None
            return super().render(mode)
        picture: Array = tile_images(self._pictures(range(min(self.render_worlds, self.num_worlds))))
        if mode != "human":
            return picture
        self._window = self._window or Window(self.metadata["render_fps"])
        self._window.show(picture)
        return None

    def _chosen(self, indices: Any) -> list[int]:
        return [range(self.num_envs)[i] for i in self._get_indices(indices)]

    def _pictures(self, worlds: Sequence[int]) -> list[Array]:
        if self.render_mode is None:
            raise ValueError("pictures need a render_mode: make_sb3(..., render_mode='rgb_array')")
        self.base_env._check_running("render")
        drawn = {w: draw(self.base_env.worlds, w) for w in set(worlds)}
        return [drawn[w] for w in worlds]


def _infos(info: dict[str, Any]) -> list[dict[str, Any]]:
    """Return a new dict for each sub-environment, with 1 or 0 for "alive" and, if counts vary, "present"."""
    keys = [key for key in ("alive", "present") if key in info]
    rows = zip(*(info[key].astype(int).tolist() for key in keys), strict=True)
    return [dict(zip(keys, row, strict=True)) for row in rows]
