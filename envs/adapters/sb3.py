"""The face for Stable-Baselines3: every agent of every world is one sub-environment of a VecEnv."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.components import Side
from outlast.ecs import Entity, Statistic

from ..core.make import make_vec
from ..core.spaces import published
from ..core.validation import check_count, keys
from ..core.vector_env import Arrays, SurvivalVectorEnv
from ..errors import ActionError, PendingError
from ..rendering.window import Window
from ..scenarios.scenario import Scenario
from .agent_spaces import agent_spaces

try:
    from stable_baselines3.common.vec_env import VecEnv
    from stable_baselines3.common.vec_env.base_vec_env import tile_images
except ImportError as error:
    raise ModuleNotFoundError(
        "make_sb3 needs Stable-Baselines3: pip install 'outlast[sb3]'", name="stable_baselines3"
    ) from error

Array = np.ndarray[Any, Any]


def make_sb3(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    seed: int | None = None,
    threads: int = 1,
    check_actions: bool = True,
    render_mode: str | None = None,
    render_worlds: int = 1,
) -> "SurvivalVecEnv":
    """`num_worlds` worlds of a variant or scenario for Stable-Baselines3.

    >>> model = PPO("MultiInputPolicy", VecMonitor(outlast.make_sb3("ffa_1", 64, seed=0)))

    seed: world w is keyed by (seed, w), as by SurvivalVecEnv.seed. threads, check_actions: see SurvivalVectorEnv.
    render_mode: None or "rgb_array", which render(mode="human") needs, too. render_worlds: render() shows the first so
    many worlds.
    """
    core = make_vec(
        scenario, num_worlds, threads=threads, check_actions=check_actions, autoreset=AutoresetMode.DISABLED
    )
    return SurvivalVecEnv(core, seed=seed, render_mode=render_mode, render_worlds=render_worlds)


class SurvivalVecEnv(VecEnv):  # type: ignore[misc]  # mypy does not follow it
    """All agents of all worlds: sub-environment w * num_agents + i is agent i of world w.

    Observations: dict of float32 (num_envs, ...), copies, because SB3's algorithms keep the last ones during a step.
    Actions: integers (num_envs, actions). Rewards: float32 (num_envs,). Dones: bool (num_envs,).

    An agent is done when its world ends, and starts anew in that very step. Until then a dead one stays: it is paid and
    observes what the scenario says, and its actions are ignored. Every info has "alive" (1 or 0) and
    "TimeLimit.truncated"; where the world ended, also "terminal_observation" and "statistics": numbers of the episode,
    of agents and sides the agent's own entry.

    core: the worlds, with autoreset DISABLED, as this face resets them itself.
    """

    def __init__(
        self, core: SurvivalVectorEnv, *, seed: int | None, render_mode: str | None, render_worlds: int
    ) -> None:
        check_count("render_worlds", render_worlds, 1)
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode = {render_mode!r}: None or 'rgb_array' is needed")
        self.core, self.render_mode, self.render_worlds = core, render_mode, render_worlds
        self.num_worlds, self.num_agents = core.num_worlds, core.num_agents
        (observations, *_), (actions, *_) = agent_spaces(core)  # everybody's are alike
        super().__init__(self.num_worlds * self.num_agents, observations, actions)
        fps = core.metadata["render_fps"]
        self.metadata = {"name": core.scenario.name, "render_modes": ["rgb_array"], "render_fps": fps}
        self._statistic_dims = {key: column.dims for key, _, _, column in published(core.worlds, Statistic)}
        self._actions: Array | None = None
        self._window: Window | None = None
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> list[int]:
        """Key world w by (seed, w) at the next reset; None: by a seed that nobody knows.

        Stable-Baselines3's own environments get seed + their number instead. Here that would give seeds 0 and 1 all
        worlds but one in common, and a learner trained with both nearly the same sample twice.

        Returns:
            The seed, once for each agent.

        Raises:
            ValueError: it is no integer from 0 to 2**64 - 1.
        """
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        keys(seed, 1, 0)
        self._seeds = [int(seed)] * self.num_envs
        return self._seeds

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Worlds have no options: ValueError for anything but empty ones."""
        if any(options) if isinstance(options, list) else options:
            raise ValueError(f"options = {options!r}: worlds take none; change the scenario's numbers instead")

    def reset(self) -> Arrays:
        """Start new episodes everywhere. A step that was begun is dropped."""
        self._actions = None
        observations, _ = self.core.reset(seed=self._seeds[0])
        self._reset_seeds()
        self.reset_infos = [{"alive": 1} for _ in range(self.num_envs)]
        return self._by_agent(observations)

    def step_async(self, actions: Array) -> None:
        """Begin a step, of which `step_wait` does the work. Raises PendingError, ActionError."""
        if self._actions is not None:
            raise PendingError("step_async() after step_async(): call step_wait(), or reset(), first")
        try:
            actions = np.array(actions)
        except ValueError:  # lists of unequal length
            actions = np.empty(0, object)
        shape = (self.num_envs, len(self.core.action_sizes))
        if actions.shape != shape:
            raise ActionError(f"actions have shape {actions.shape}: (num_envs, actions) = {shape} is needed")
        self._actions = actions.reshape(self.num_worlds, self.num_agents, -1)

    def step_wait(self) -> tuple[Arrays, Array, Array, list[dict[str, Any]]]:
        """One tick of every world, then new episodes where it was the last: observations, rewards, dones, infos.

        A refused call (PendingError, ActionError, NotResetError) changes nothing.
        """
        if self._actions is None:
            raise PendingError("step_wait() without step_async()")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, info = self.core.step(actions)
        alive = self.core.worlds[Entity].alive[:, self._rows].ravel().tolist()
        infos: list[dict[str, Any]] = [{"alive": each, "TimeLimit.truncated": False} for each in alive]
        over = terminated | truncated
        if over.any():
            self._report(np.flatnonzero(over), observations, truncated, info["statistics"], infos)
            observations, _ = self.core.reset(options={"reset_mask": over})
        return self._by_agent(observations), rewards.ravel(), np.repeat(over, self.num_agents), infos

    def close(self) -> None:
        """Let threads and window go; a later reset or step is a ClosedError."""
        if self._window is not None:
            self._window.close()
        self.core.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of this object, which all sub-environments share, once for each of them."""
        value = getattr(self, attr_name)
        return [value for _ in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of this object. All sub-environments share it: ValueError unless all are meant."""
        if len(set(self._chosen(indices))) < self.num_envs:
            raise ValueError(f"'{attr_name}' is shared by all sub-environments; leave out indices")
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """The one method that a single sub-environment has is render(): a picture of its world."""
        if method_name != "render" or args or kwargs:
            raise AttributeError(f"sub-environments have the method render() and no other; {method_name} was asked for")
        return self._pictures(i // self.num_agents for i in self._chosen(indices))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Never: there are no single environments that could be."""
        return [False for _ in self._chosen(indices)]

    def get_images(self) -> list[Array]:
        """A picture, uint8 (size, size, 3), for each sub-environment; agents of one world share one array."""
        return self._pictures(i // self.num_agents for i in range(self.num_envs))

    def render(self, mode: str | None = None) -> Array | None:
        """The first `render_worlds` worlds side by side, uint8 (height, width, 3); with mode "human" in a window."""
        if self.render_mode != "rgb_array" or mode not in (None, "rgb_array", "human"):
            nothing: Array | None = super().render(mode)  # warns
            return nothing
        picture: Array = tile_images(self._pictures(range(min(self.render_worlds, self.num_worlds))))
        if mode != "human":
            return picture
        self._window = self._window or Window("outlast", self.metadata["render_fps"])
        self._window.show(picture)
        return None

    @property
    def _rows(self) -> slice:
        return self.core.worlds.span("agent")

    def _by_agent(self, observations: Arrays) -> Arrays:
        return {key: values.reshape(self.num_envs, *values.shape[2:]).copy() for key, values in observations.items()}

    def _chosen(self, indices: Any) -> list[int]:
        return [range(self.num_envs)[i] for i in self._get_indices(indices)]

    def _pictures(self, worlds: Iterable[int]) -> list[Array]:
        from ..rendering.rgb import draw  # with what draws, which training has no use for

        if self.render_mode is None:
            raise ValueError("there are no pictures without a render_mode: make_sb3(..., render_mode='rgb_array')")
        drawn: dict[int, Array] = {}
        return [drawn[w] if w in drawn else drawn.setdefault(w, draw(self.core.worlds, w)) for w in worlds]

    def _report(
        self, worlds: Array, observations: Arrays, truncated: Array, statistics: Arrays, infos: list[dict[str, Any]]
    ) -> None:
        """Complete the infos of the agents of `worlds` (indices), which ended."""
        agents = (worlds[:, None] * self.num_agents + np.arange(self.num_agents)).ravel()
        last = {key: values[worlds].reshape(len(agents), *values.shape[2:]) for key, values in observations.items()}
        own = {key: self._own(key, values[worlds], worlds) for key, values in statistics.items()}
        cut = np.repeat(truncated[worlds], self.num_agents).tolist()
        for k, i in enumerate(agents.tolist()):
            infos[i]["TimeLimit.truncated"] = cut[k]
            infos[i]["terminal_observation"] = {key: rows[k] for key, rows in last.items()}
            infos[i]["statistics"] = {key: values[k] for key, values in own.items()}
            self.reset_infos[i] = {"alive": 1}

    def _own(self, key: str, values: Array, worlds: Array) -> list[Any]:
        """What of a statistic each agent of `worlds` is told."""
        dims = self._statistic_dims.get(key)
        if dims == ("agents",):
            return list(values.ravel().tolist())
        if dims == ("sides",):
            sides = self.core.worlds[Side].side[worlds, self._rows]
            return list(np.take_along_axis(values, sides, 1).ravel().tolist())
        return list(np.repeat(values, self.num_agents, axis=0).tolist())
