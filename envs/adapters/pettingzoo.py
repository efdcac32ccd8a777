"""PettingZoo: one world as a ParallelEnv, or, by PettingZoo's own conversion, as an AECEnv."""

import copy
from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any, Self, Unpack

import numpy as np
from gymnasium import spaces

from outlast.components.respawn import inactive

from ..core.action_spaces import ActionSpace
from ..core.concurrency import check_callable
from ..core.numbers import copy_changed
from ..core.observations import each
from ..core.spaces import alive, counted, present, statistics
from ..core.validation import Array, check_choice, check_count
from ..core.vector_env import SurvivalVectorEnv, world_options
from ..errors import ActionError, NotResetError, needed
from ..rendering.rgb import RENDER_MODES, draw, render_world
from ..scenarios.known_numbers import Numbers
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .base import OneWorldAdapter, check_dead, requested

with needed("pettingzoo", "parallel_env and aec_env need PettingZoo"):
    from pettingzoo import ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec_wrapper
    from pettingzoo.utils.wrappers import OrderEnforcingWrapper

Observations = dict[str, Any]  # by name of the agent
Infos = dict[str, dict[str, Any]]
Outcome = tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]


class SurvivalParallelEnv(OneWorldAdapter, ParallelEnv):  # type: ignore[misc]  # untyped, see pyproject.toml
    """One world as a PettingZoo ParallelEnv; made by `adapters.parallel_env`. Its agents are agent_0, agent_1 ...

    Spaces, rewards and starting states are, by agent, those of `SurvivalEnv`; observations are new in every step. With
    action_masks="observation", an agent observes {"observation": as before, "action_mask": int8 (entries,)}. Infos are
    {"alive": 1 or 0} for each agent, after every call; if the number of agents varies, also "present" in the episode.

    With dead="end", an agent's death ends its episode: it is reported once, with terminated True, and leaves `agents`,
    as usual in PettingZoo. Rewards after death, such as those of a team for its dead members, are then lost. With
    dead="keep", all agents stay until the world ends, with their rewards; the masks in observations of the dead are 0.
    Terminated is True for all agents that are left when the world ends by its rule; truncated, at the time limit.

    If the scenario varies the number of agents, `agents` are those that the episode has; with dead="keep" they are all
    of `possible_agents`, for libraries that need the same agents in every episode.

    Attributes:
        statistics: The world's statistics of the last episode that ended, by key; {} before that. An episode ends when
            no agent is left, even if the world could go on. "return" also counts rewards after an agent has left.
        statistics_present: If the number of agents varies, which agents and sides that episode had, bool (n,) by key.
        base_env: The SurvivalVectorEnv of one world below.
        np_random: A generator for wrappers, as SuperSuit's frame_skip_v0, which is seeded as the worlds are.

    Pickles and copies by copy.copy hold how an environment was made, not its state: the new environment has not been
    reset. Use `get_state` and `set_state` for the state. A copy by copy.deepcopy goes on from where this one is.
    """

    def __init__(
        self, scenario: Scenario, *, dead: str, render_mode: str | None, actions: str, action_masks: Any, **options: Any
    ) -> None:
        self._prepare_render(render_mode)
        if not isinstance(action_masks, (bool, np.bool_)):
            check_choice("action_masks", action_masks, ("observation",), ", True and False")
        self._recipe = partial(type(self), scenario, dead=dead, **options, **world_options(locals()))
        self.dead = dead
        options |= {"autoreset_mode": "Disabled", "copy": False, "check_actions": False}
        self.base_env = SurvivalVectorEnv(scenario, 1, **options)
        self.np_random = np.random.default_rng(options["seed"])
        check_dead(dead, self.base_env.worlds)
        self.metadata = {**self.metadata, "is_parallelizable": True, "name": scenario.name}
        self.possible_agents = [f"agent_{i}" for i in range(self.base_env.num_agents)]
        self.agents: list[str] = []
        self.statistics, self.statistics_present = dict[str, Any](), dict[str, Array]()
        self._index = {agent: i for i, agent in enumerate(self.possible_agents)}
        self._actions, self._masked = ActionSpace(self.base_env.worlds, actions, bool(action_masks)), bool(action_masks)
        self.observation_spaces = {agent: self.base_env._reader.of_agent(i) for agent, i in self._index.items()}
        self.action_spaces = {agent: self._actions.single for agent in self._index}  # noqa: C420 - a new one each
        self._mask_form: tuple[str, Any] | None = None
        if action_masks == "observation":
            self._observe_masks("observation", np.int8)

    def observation_space(self, agent: str) -> Any:
        """Return the agent's observation space: Dict of float32 Boxes, or a flat Box; always the same object."""
        return self._of(self.observation_spaces, agent)

    def action_space(self, agent: str) -> Any:
        """Return the agent's action space: MultiDiscrete, Discrete or Box; always the same object."""
        return self._of(self.action_spaces, agent)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start the first episode of `seed`, an integer from 0 to 2**64 - 1, or the next one. `options` are ignored."""
        check_callable(self.base_env)
        self.base_env.reset(seed=seed)
        if seed is not None:
            self.np_random = np.random.default_rng(seed)
        self.agents = self._beginning()
        self._show()
        return self._observe(self.agents), self._infos(self.agents)

    def step(self, actions: Mapping[str, Any]) -> Outcome:
        """Advance the world by one tick. Results are of those in `agents` before. A refused call changes nothing.

        actions: By agent, integers of any type in its action space, as an array or a list, or a single integer. An
        agent that is left out does nothing; actions of the dead are ignored. Raises ActionError if an agent is unknown
        or an action not in its space; NotResetError if the episode is over, or has not begun.
        """
        check_callable(self.base_env)
        if not self.agents and not actions and self.base_env._tracker.running[0]:
            return {}, {}, {}, {}, {}  # wrappers take another step after the last agent is gone
        if not self.agents:
            raise NotResetError("step() with no agents: the episode is over or has not begun; call reset() first")
        _, reward, terminated, truncated, _ = self.base_env.step(self._joint(actions))
        reported, done, cut = self.agents, bool(terminated[0]), bool(truncated[0])
        self.agents = self._remaining(reported)
        if not self.agents:
            found = statistics(self.base_env.worlds, np.ones(1, bool))
            self.statistics = {key: values[0] for key, values in found.items()}
            self.statistics_present = {key: there[0] for key, there in counted(self.base_env.worlds).items()}
        self._show()
        rewards, infos = reward[0].tolist(), self._infos(reported)
        return (
            self._observe(reported),
            {agent: rewards[self._index[agent]] for agent in reported},
            {agent: done or (self.dead == "end" and not infos[agent]["alive"]) for agent in reported},
            dict.fromkeys(reported, cut),
            infos,
        )

    def action_masks(self) -> dict[str, Array]:
        """Return which actions of each of `agents` can do something, bool (entries,); see SurvivalVectorEnv."""
        self.base_env._check_running("action_masks")
        masks = self._actions.masks()[0]
        return {agent: masks[self._index[agent]] for agent in self.agents}

    def set_state(self, state: State) -> Observations:
        """Go on from `state`. Returns the observations, which an AECEnv around this one does not notice."""
        self.base_env.set_state(state)
        self.agents = self._remaining(self._beginning())
        return self._observe(self.agents)

    def render(self) -> Array | str | None:
        """Return uint8 (height, width, 3), RGB, or text, or None for a window, which reset and step also update."""
        self.base_env._check_running("render")
        if self.render_mode is None:
            raise ValueError(f"render() needs an environment made with a render_mode: {', '.join(RENDER_MODES)}, human")
        if self._window is None:
            return render_world(self.base_env.worlds, 0, self.render_mode)
        self._window.show(draw(self.base_env.worlds, 0))
        return None

    def __deepcopy__(self, memo: Any) -> Self:
        other = self._recipe()
        copy_changed(self.base_env.worlds, other.base_env.worlds)
        other.set_state(self.get_state())
        # random generators included, so that both go on with the same draws
        for name in ("agents", "statistics", "statistics_present", "action_spaces", "np_random"):
            setattr(other, name, copy.deepcopy(getattr(self, name)))
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        return self._recipe, ()

    def _joint(self, actions: Mapping[str, Any]) -> Array:
        """Return the actions of all agents, int64 (1, agents, actions)."""
        if not isinstance(actions, Mapping):
            raise ActionError(f"actions are {actions!r}: a dict of agent -> action is needed")
        idle = inactive(self.base_env.worlds)[0]
        joint = np.tile(self.base_env.noop, (1, self.base_env.num_agents, 1))
        for agent, action in actions.items():
            i = self._index.get(agent)
            if i is None:
                raise ActionError(f"there is no agent {agent!r} to act; there are: {', '.join(self.possible_agents)}")
            if agent in self.agents and not idle[i]:
                joint[0, i] = self._actions.rows(action, (), what=f"actions of {agent}", who=agent)
        return joint

    def _beginning(self) -> list[str]:
        """Return the agents that an episode begins with: all of them if `dead` is "keep", otherwise those present."""
        there = present(self.base_env.worlds, 0)
        return [agent for agent, i in self._index.items() if self.dead == "keep" or there[i]]

    def _remaining(self, agents: Iterable[str]) -> list[str]:
        """Return those of `agents` whose episode goes on: none if the world has ended."""
        if self.base_env._tracker.done[0]:
            return []
        living = alive(self.base_env.worlds, 0)
        return [agent for agent in agents if self.dead == "keep" or living[self._index[agent]]]

    def _observe_masks(self, key: str, dtype: Any) -> None:
        """Make agents observe {key: as before, "action_mask": (entries,)} from now on, as some libraries need it."""
        self._mask_form = key, dtype
        masks = spaces.Box(0, 1, (self._actions.mask_size,), dtype)
        for agent, own in self.observation_spaces.items():
            self.observation_spaces[agent] = spaces.Dict({"action_mask": masks, key: own})

    def _observe(self, agents: Iterable[str]) -> Observations:
        fresh = each(self.base_env._observe(), lambda buffer: buffer[0].copy())
        observed = {agent: each(fresh, lambda rows: rows[self._index[agent]]) for agent in agents}  # noqa: B023
        if self._mask_form is not None:
            key, dtype = self._mask_form
            masks = self._actions.masks()[0].astype(dtype)
            return {agent: {"action_mask": masks[self._index[agent]], key: own} for agent, own in observed.items()}
        return observed

    def _infos(self, agents: Iterable[str]) -> Infos:
        found = self.base_env._presence(0)
        infos: Infos = {agent: {key: int(ones[self._index[agent]]) for key, ones in found.items()} for agent in agents}
        if self._masked and self._mask_form is None:
            masks = self._actions.masks()[0].view(np.int8)
            for agent, info in infos.items():
                info["action_mask"] = masks[self._index[agent]]
        return infos

    def _of(self, spaces: dict[str, Any], agent: str) -> Any:
        if agent not in spaces:
            raise KeyError(f"there is no agent {agent!r}; there are: {', '.join(self.possible_agents)}")
        return spaces[agent]


class SurvivalTurns(parallel_to_aec_wrapper):  # type: ignore[misc]  # untyped, see pyproject.toml
    """The agents of a SurvivalParallelEnv in turns; made by `outlast.adapters.aec_env`."""

    def step(self, action: Any) -> None:
        """Take the turn of `agent_selection`; None if it is done. A refused action leaves the turn with the agent."""
        agent = self.agent_selection
        if not (self.terminations[agent] or self.truncations[agent]):
            check_callable(self.env.base_env)
            self.env._joint({agent: action})  # PettingZoo would keep it, and refuse the turn of the last agent for it
        super().step(action)


def parallel_env(
    scenario: str | Scenario = "ffa_3",
    *,
    render_mode: str | None = None,
    seed: int | None = None,
    dead: str = "end",
    max_episode_steps: int | None = None,
    max_cycles: int | None = None,
    actions: str = "multi",
    observations: str = "dict",
    scaled: bool = False,
    action_masks: bool | str = False,
    **numbers: Unpack[Numbers],
) -> SurvivalParallelEnv:
    """Make one world for PettingZoo's learners and wrappers.

    >>> env = outlast.adapters.parallel_env("teams_3", dead="keep", max_episode_steps=1000, melee_damage=20)

    Arguments that are not listed, numbers and errors are those of `outlast.make_vec`.

    Args:
        render_mode: None, "rgb_array", "ansi" or "human".
        dead: "end": agents leave when they die. "keep": all agents stay until the world ends. See SurvivalParallelEnv.
        max_episode_steps: Ticks after which a world is truncated; it sets the scenario's ending_limit.
        max_cycles: PettingZoo's name for max_episode_steps.
        action_masks: Whether the info of each agent has "action_mask", int8 (entries,): what `action_masks` returns.
            "observation": its observation instead, where Tianshou and PettingZoo's classic games have it.
    """
    if max_cycles is not None:
        check_count("max_cycles", max_cycles, 1)
        if max_episode_steps is not None:
            raise ValueError("max_cycles and max_episode_steps are the same number: give one of them")
        max_episode_steps = max_cycles
    asked = requested(parallel_env, scenario, numbers, max_episode_steps)
    return SurvivalParallelEnv(asked, dead=dead, **world_options(locals()))


def aec_env(scenario: str | Scenario = "ffa_3", **options: Any) -> Any:
    """Make one world as a PettingZoo AECEnv, in which agents act in turns, and the tick follows the last agent's turn.

    It has the arguments and errors of `parallel_env`, which makes its `unwrapped`.
    """
    return OrderEnforcingWrapper(SurvivalTurns(parallel_env(scenario, **options)))


env = aec_env  # PettingZoo's own modules call it `env`
