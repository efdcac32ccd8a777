"""PettingZoo: one world as a ParallelEnv, and as an AECEnv through PettingZoo's own conversion."""

from collections.abc import Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces

from outlast.components import End
from outlast.ecs import Entity

from ..core.make import make_vec
from ..core.validation import Array, check_choice, check_count
from ..errors import ActionError, ClosedError, NotResetError
from ..rendering import modes
from ..rendering.window import Window
from ..scenarios.scenario import Scenario
from ..scenarios.variants import variant
from ..snapshots.state import State
from .agent_spaces import agent_action, agent_spaces
from .global_state import Overview

try:
    from pettingzoo import ParallelEnv
    from pettingzoo.utils.conversions import parallel_to_aec
except ModuleNotFoundError as error:
    hint = "parallel_env and aec_env need PettingZoo: pip install 'outlast[pettingzoo]'"
    raise ModuleNotFoundError(hint, name=error.name) from error

Observations = dict[str, dict[str, Array]]
Infos = dict[str, dict[str, int]]

DEAD = ("remove", "keep")
RENDER_MODES = (*modes.RENDER_MODES, "human")
METADATA = {"render_modes": list(RENDER_MODES), "render_fps": modes.FPS, "is_parallelizable": True}


class SurvivalParallelEnv(ParallelEnv):  # type: ignore[misc]  # untyped, see pyproject.toml
    """One world of a scenario as a PettingZoo ParallelEnv; its agents are agent_0, agent_1 ...

    dead="remove": who dies is reported once, with terminated True, and leaves `agents`, as PettingZoo has it. Rewards
    after death and those of a team for its dead members are then lost. dead="keep": all stay until the world ends, with
    their rewards; the masks in observations of the dead are 0.

    When the world ends by its rule, terminated is True for everybody left; at the time limit, truncated is True for
    everybody reported. Observations are new float32 arrays, rewards are floats. Every info is {"alive": 1 or 0}.
    statistics: of the episode that ended last, {} before that.

    batch: the SurvivalVectorEnv of one world below. Copies and pickles hold how an environment was made, not where it
    is: what comes out has not been reset. get_state and set_state are for the rest.
    """

    def __init__(
        self, scenario: str | Scenario, *, render_mode: str | None = None, seed: int | None = None, dead: str = "remove"
    ) -> None:
        check_choice("dead", dead, DEAD)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        self._recipe = partial(type(self), scenario, render_mode=render_mode, seed=seed, dead=dead)
        self._window = Window("outlast", modes.FPS) if render_mode == "human" else None
        self.render_mode, self.dead = render_mode, dead
        self.batch = make_vec(scenario, 1, seed=seed, autoreset="Disabled", check_actions=False)
        self.metadata = {**METADATA, "name": self.batch.scenario.name}
        self.possible_agents = [f"agent_{i}" for i in range(self.batch.num_agents)]
        self.agents: list[str] = []
        self.statistics: dict[str, Any] = {}
        self._index = {agent: i for i, agent in enumerate(self.possible_agents)}
        self._observation_spaces, self._action_spaces = agent_spaces(self.batch)
        self._overview = Overview(self.batch.worlds)
        self.state_space = self._overview.space
        self._alive = self.batch.worlds[Entity].alive[0, self.batch.worlds.span("agent")]
        self._idle = np.array([-low for _, low in self.batch.action_columns])
        self._started = False

    def observation_space(self, agent: str) -> spaces.Dict:
        """What the agent sees: Dict of float32 Boxes; the same object in every call."""
        return self._observation_spaces[self._number(agent)]

    def action_space(self, agent: str) -> spaces.MultiDiscrete:
        """What the agent does: MultiDiscrete, [3, 3, 3, 2, 2, 2] in the paper; the same object in every call."""
        return self._action_spaces[self._number(agent)]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observations, Infos]:
        """Start an episode: of `seed`, or the next one. The first reset takes the constructor's seed.

        A seed gives world 0 of a batch with that seed. options are PettingZoo's custom; nothing is made of them.
        """
        self._check_open()
        self.batch.reset(seed=seed)
        self.agents, self._started = self.possible_agents[:], True
        self._show()
        return self._observe(self.agents), self._inform(self.agents)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """One tick. actions: agent -> integers, as many as its action space has, of any integer type, or a list.

        Who has no action idles; actions of the dead are not looked at. Raises ActionError, and changes nothing, for
        unknown agents and what is not in the action space, and NotResetError where there is nobody to step.
        """
        self._check_open()
        if not self.agents:
            raise NotResetError("step() with no agents: the episode is over or has not begun; call reset() first")
        _, reward, terminated, truncated, info = self.batch.step(self._joint(actions))
        reported, over, cut = self.agents, bool(terminated[0]), bool(truncated[0])
        self.agents = self._present(reported)
        if info:
            self.statistics = {key: values[0] for key, values in info["statistics"].items()}
        self._show()
        rewards = {agent: float(reward[0, self._index[agent]]) for agent in reported}
        dead = {agent: over or (self.dead == "remove" and not self._lives(agent)) for agent in reported}
        return self._observe(reported), rewards, dead, dict.fromkeys(reported, cut), self._inform(reported)

    def state(self) -> Array:
        """Everything that agents do not see, too: float32 vector; see envs.parallel_spaces.Overview."""
        self._check_started("state")
        return self._overview()

    def get_state(self) -> State:
        """The world as plain arrays, to go on from later; see SurvivalVectorEnv.get_state."""
        return self.batch.get_state()

    def set_state(self, state: State) -> Observations:
        """Go on from `state`; returns what the agents see. Raises StateError if it is of another scenario."""
        self.batch.set_state(state)
        self.agents, self._started = self._present(self.possible_agents), True
        return self._observe(self.agents)

    def render(self) -> Array | str | None:
        """uint8 (height, width, 3) RGB, or text, or None and a window (which reset and step draw by themselves)."""
        self._check_started("render")
        if self.render_mode is None:
            raise ValueError(f"render() needs an environment made with a render_mode: {', '.join(RENDER_MODES)}")
        from ..rendering.rgb import draw, text  # here, as OpenCV takes a while to load

        if self.render_mode == "ansi":
            return text(self.batch.worlds, 0)
        frame: Array = draw(self.batch.worlds, 0)
        if self._window is None:
            return frame
        self._window.show(frame)
        return None

    def close(self) -> None:
        """Let go of window and threads; again does no harm."""
        if self._window is not None:
            self._window.close()
        self.batch.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return self._recipe, ()

    def _joint(self, actions: Mapping[str, Any]) -> Array:
        """The actions of everybody as the batch takes them, int64 (1, agents, actions)."""
        if not isinstance(actions, Mapping):
            raise ActionError(f"actions are {actions!r}: a dict of agent -> action is needed")
        joint = np.tile(self._idle, (1, self.batch.num_agents, 1))
        for agent, action in actions.items():
            i = self._index.get(agent)
            if i is None:
                raise ActionError(f"there is no agent {agent!r} to act; there are: {', '.join(self.possible_agents)}")
            if agent in self.agents and self._alive[i]:
                joint[0, i] = agent_action(agent, action, self.batch.action_sizes)
        return joint

    def _present(self, agents: Iterable[str]) -> list[str]:
        """Those of `agents` that go on: nobody if the world has ended."""
        end = self.batch.worlds[End]
        if end.terminated[0, 0] or end.truncated[0, 0]:
            return []
        return [agent for agent in agents if self.dead == "keep" or self._lives(agent)]

    def _observe(self, agents: Iterable[str]) -> Observations:
        fresh = {key: buffer[0].copy() for key, buffer in self.batch.observe().items()}
        return {agent: {key: rows[self._index[agent]] for key, rows in fresh.items()} for agent in agents}

    def _inform(self, agents: Iterable[str]) -> Infos:
        return {agent: {"alive": int(self._lives(agent))} for agent in agents}

    def _lives(self, agent: str) -> bool:
        return bool(self._alive[self._index[agent]])

    def _show(self) -> None:
        if self.render_mode == "human":
            self.render()

    def _number(self, agent: str) -> int:
        if agent not in self._index:
            raise KeyError(f"there is no agent {agent!r}; there are: {', '.join(self.possible_agents)}")
        return self._index[agent]

    def _check_open(self) -> None:
        if self.batch.closed:
            raise ClosedError("the environment is closed; make a new one")

    def _check_started(self, call: str) -> None:
        self._check_open()
        if not self._started:
            raise NotResetError(f"{call}() before reset(): there is no world to tell of")


def parallel_env(
    scenario: str | Scenario = "ffa_3",
    *,
    render_mode: str | None = None,
    seed: int | None = None,
    dead: str = "remove",
    max_cycles: int | None = None,
    **numbers: Any,
) -> SurvivalParallelEnv:
    """One world of a variant or scenario for PettingZoo's learners and wrappers.

    >>> env = outlast.parallel_env("teams_3", dead="keep", max_cycles=1000, melee_damage=20)

    max_cycles: ticks until it is truncated, the scenario's own ending_limit. numbers: any others of the scenario, see
    Scenario.replace. The rest is in SurvivalParallelEnv. Raises ScenarioError for an unknown variant, NumberError for
    an unknown or impossible number, ValueError for the rest.
    """
    if max_cycles is not None:
        check_count("max_cycles", max_cycles, 1)
        if "ending_limit" in numbers:
            raise ValueError("max_cycles and ending_limit are the same number: give one of them")
        numbers["ending_limit"] = max_cycles
    if isinstance(scenario, str):
        scenario = variant(scenario)
    if isinstance(scenario, Scenario):  # what else it is, the constructor refuses
        scenario = scenario.replace(**numbers)
    return SurvivalParallelEnv(scenario, render_mode=render_mode, seed=seed, dead=dead)


def aec_env(scenario: str | Scenario = "ffa_3", **options: Any) -> Any:
    """The same as a PettingZoo AECEnv, in which agents act in turns and the tick comes after the last of them.

    Takes what parallel_env takes; `unwrapped` is its SurvivalParallelEnv.
    """
    return parallel_to_aec(parallel_env(scenario, **options))


env = aec_env  # the name that PettingZoo's modules have for it
