"""PufferLib: all agents of many worlds as one native PufferEnv, which writes into PufferLib's own arrays."""

from typing import Any, Unpack

import numpy as np

from ..core.action_spaces import ActionSpace
from ..core.spaces import alive
from ..core.validation import Array, check_choice, check_flags
from ..core.vector_env import SurvivalVectorEnv
from ..errors import needed
from ..rendering.rgb import RENDER_MODES, render_world
from ..scenarios.known_numbers import Numbers
from ..scenarios.parse import checks_keywords
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .base import Adapter, requested

with needed("puffer", "make_puffer needs PufferLib 3"):
    from pufferlib import PufferEnv

Infos = list[dict[str, Any]]


@checks_keywords
def make_puffer(
    scenario: str | Scenario,
    num_worlds: int,
    *,
    seed: int | None = 0,
    threads: int = 1,
    max_episode_steps: int | None = None,
    check_actions: bool = True,
    render_mode: str | None = None,
    actions: str = "multi",
    scaled: bool = False,
    buf: dict[str, Array] | None = None,
    **numbers: Unpack[Numbers],
) -> "SurvivalPufferEnv":
    """Make all agents of `num_worlds` worlds for PufferLib, directly or through its vector.make.

    >>> vecenv = outlast.adapters.make_puffer("ffa_3", 1024)
    >>> vecenv = pufferlib.vector.make(adapters.make_puffer, ["ffa_3", 512], num_envs=2, backend="Multiprocessing")

    Arguments that are not listed, numbers and errors are those of `outlast.make_vec`.

    Args:
        seed: World w is keyed by (seed, w), so that environments with different seeds have no world in common. None: an
            unpredictable seed. PufferLib resets environment j of worker i with seed + i + j, so give every environment
            its own worker (num_workers=num_envs, the default); otherwise some environments play the same worlds.
        max_episode_steps: Ticks after which a world is truncated; it sets the scenario's ending_limit.
        buf: Arrays that PufferLib passes in.
    """
    check_choice("render_mode", render_mode, (None, *RENDER_MODES))
    check_flags(check_actions=check_actions)
    asked = requested(make_puffer, scenario, numbers, max_episode_steps)
    more: dict[str, Any] = {"seed": seed, "threads": threads, "scaled": scaled, "observations": "flat"}
    base_env = SurvivalVectorEnv(asked, num_worlds, autoreset_mode="SameStep", copy=False, check_actions=False, **more)
    return SurvivalPufferEnv(base_env, actions, check_actions, render_mode, buf)


class SurvivalPufferEnv(Adapter, PufferEnv):  # type: ignore[misc]  # untyped, see pyproject.toml
    """All agents of all worlds: row w * agents + i of every array is agent i of world w. num_agents counts all rows.

    The arrays are those of PufferLib (buf) or, without these, the environment's own; every call overwrites them:

    ============ ======= ================== ========================================================================
    observations float32 (num_agents, size) all that an agent sees, flat, in order of the keys
    rewards      float32 (num_agents,)
    terminals    bool    (num_agents,)      whether its world ended by its rule
    truncations  bool    (num_agents,)      whether its world ended at the time limit
    masks        bool    (num_agents,)      whether the agent of this observation is alive: info["alive"] elsewhere
    ============ ======= ================== ========================================================================

    The dead stay until their world ends, with their rewards (dead="keep" of other adapters). A world that ended starts
    again in that very step: the observation is already the next episode's. PufferLib's own trainer ends returns only at
    terminals.

    infos: a list, empty or with one dict, which holds the statistics of the episodes that just ended: lists of numbers,
    with one for each agent or side that the episode had in statistics of agents and sides. After a truncation it also
    has "final_obs", float32 (n, size): the last observations of the rows that are truncated, in order, so that a
    learner can add their values to `rewards[truncations]`. In batches of several environments, join those of all infos.

    base_env: The SurvivalVectorEnv below, whose autoreset mode is SAME_STEP, and whose flat_names are the names of the
    columns of observations.
    """

    def __init__(
        self, base_env: SurvivalVectorEnv, actions: str, check_actions: bool, render_mode: str | None, buf: Any
    ) -> None:
        self.base_env, self.check_actions, self.render_mode = base_env, check_actions, render_mode
        self.num_worlds, self.num_agents = base_env.num_worlds, base_env.num_worlds * base_env.num_agents
        self._actions = ActionSpace(base_env.worlds, actions)
        self.single_observation_space = base_env._reader.of_agent(0)  # all agents have the same space
        self.single_action_space = self._actions.single
        self.metadata = base_env.metadata  # the base class reads it
        super().__init__(buf)

    def reset(self, seed: int | None = None) -> tuple[Array, Infos]:
        """Start new episodes in all worlds: those of `seed`, or the next ones. Returns (observations, infos)."""
        self.base_env.reset(seed=seed)
        return self._beginning(), []

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, Infos]:
        """Advance every world by one tick, and begin new episodes where worlds ended. Refused calls change nothing."""
        shape, who = (self.num_agents,), "sub-environment {0}"
        rows = self._actions.rows(actions, shape, self.check_actions, axes="num_agents", who=who)
        out = {name: self._by_world(getattr(self, name)) for name in ("observations", "rewards")}
        *_, terminated, truncated, info = self.base_env.step(self._by_world(rows), out=out)
        self._by_world(self.terminals)[:] = terminated[:, None]
        self._by_world(self.truncations)[:] = truncated[:, None]
        infos: Infos = []
        if "statistics" in info:
            done, there, found = info["_statistics"], info.get("statistics_present", {}), info["statistics"]
            ended = {key: values[done][there[key][done] if key in there else ...] for key, values in found.items()}
            infos.append({key: values.ravel().tolist() for key, values in ended.items()})
            if truncated.any():  # an array, which PufferLib's trainer leaves out of its means
                infos[0]["final_obs"] = np.concatenate(info["final_obs"][truncated])
        self.masks[:] = info["alive"].ravel()
        return self.observations, self.rewards, self.terminals, self.truncations, infos

    def action_masks(self) -> Array:
        """Return which actions can do something, bool (num_agents, entries); see SurvivalVectorEnv.action_masks."""
        self.base_env._check_running("action_masks")
        return self._actions.masks().reshape(self.num_agents, -1)

    def set_state(self, state: State) -> Array:
        """Go on from `state`, of as many worlds or of one for all. Returns the observations. Raises StateError."""
        self.base_env.set_state(state)
        return self._beginning()

    def render(self) -> Any:
        """Draw world 0 as uint8 (height, width, 3), RGB, or text, by render_mode. NotResetError before reset()."""
        if self.render_mode is None:
            raise ValueError(f"render() needs an environment made with a render_mode: {' or '.join(RENDER_MODES)}")
        self.base_env._check_running("render")
        return render_world(self.base_env.worlds, 0, self.render_mode)

    def close(self) -> None:
        """Close the worlds and their threads. Closing again does no harm."""
        self.base_env.close()

    def _beginning(self) -> Array:
        """Write observations and masks that do not follow from a step, so without rewards and ends, and return them."""
        self.rewards[:] = 0
        self.terminals[:] = self.truncations[:] = False
        self.base_env.observe(out=self._by_world(self.observations))
        self.masks[:] = alive(self.base_env.worlds).ravel()
        return self.observations

    def _by_world(self, rows: Array) -> Array:
        """Reshape (num_agents, ...) to (worlds, agents, ...): a view, even if `rows` is part of a larger array."""
        return np.reshape(rows, (self.num_worlds, -1, *rows.shape[1:]))
