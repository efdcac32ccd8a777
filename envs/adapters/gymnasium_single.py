"""One agent of one world as an ordinary gymnasium environment; the others follow a policy."""

import copy
from functools import partial
from typing import Any, Unpack

import gymnasium
import numpy as np

from ..core.numbers import copy_changed
from ..core.observations import each
from ..core.validation import Array, keys
from ..core.vector_env import world_options
from ..errors import NotResetError
from ..rollout.lineup import Others, copied_others
from ..scenarios.known_numbers import Numbers
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .base import Info, OneWorldAdapter, requested
from .gymnasium_learners import SurvivalLearnerVectorEnv

Observation = dict[str, Array]


class SurvivalEnv(OneWorldAdapter, gymnasium.Env[Observation, Array]):
    """One world in which one agent learns; made by `gymnasium.make`.

    >>> env = gymnasium.make("outlast/Teams3-v1", others="scripted", melee_damage=20)

    ## Description
    Agents in a shrinking safe zone strike each other, fetch heals and push boxes, depending on the scenario. One of
    them is the environment's agent, the learner; the others follow a policy.

    ## Action Space
    MultiDiscrete, in the paper [3, 3, 3, 2, 2, 2]: ahead, left and turn (0, 1, 2 for -1, 0, +1), attack, use, give.
    With actions="joint" Discrete(216), with "continuous" Box(-1, 1, (6,)).

    ## Observation Space
    Dict of float32 arrays, new ones, by the keys that the mechanics declare; with observations="flat" a single array.

    ## Rewards
    A float, the agent's own, according to the scenario's rewards_* numbers.

    ## Starting State
    reset(seed=s) begins the first episode of world 0 of `outlast.make_vec` with seed s; reset() begins the next.

    ## Episode End
    Terminated: the world ended by its rule, or the learner died; with dead="keep" a dead learner stays, with its
    rewards, until its world ends. Truncated: at the scenario's time limit (ending_limit) or at max_episode_steps.

    ## Info
    The same keys after every call: "alive", bool, and the statistics of the episode so far as Python numbers
    ("length", "return", "kills" of the agent's side, "deaths_zone", ...).

    ## Arguments
    * scenario: A Scenario or the name of one: "ffa_3", "mygame.py:arena".
    * learner: Index of the agent that learns.
    * others: The name of a policy, such as "scripted", a FILE.zip saved by `outlast train`, a function (observations)
      -> actions, or several of these with weights, one of which is drawn for each episode: {"scripted": 2, play: 1},
      "scripted:2,random:1"; see lineup.Lineup.
    * dead: "end" or "keep", see above.
    * max_episode_steps: Ticks until the episode is truncated, if that is before the scenario's limit.
    * render_mode: None, "rgb_array", "ansi" or "human".
    * actions, observations, scaled: As in `outlast.make_vec`.
    * action_masks: Whether info has "action_mask", int8 (entries,): what `action_masks` returns.
    * numbers: Numbers of the scenario to change, as for `Scenario.replace`.

    ## Version History
    v1: the rules of the paper's runs.

    Pickles and copies by copy.copy hold how an environment was made, not its state: the new environment has not been
    reset. Use `get_state` and `set_state` for the state. A copy by copy.deepcopy goes on from where this one is.
    """

    def __init__(
        self,
        scenario: str | Scenario = "ffa_3",
        *,
        learner: int = 0,
        others: Others = "random",
        dead: str = "end",
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        actions: str = "multi",
        observations: str = "dict",
        scaled: bool = False,
        action_masks: bool = False,
        **numbers: Unpack[Numbers],
    ) -> None:
        self._prepare_render(render_mode)
        scenario = requested(type(self).__init__, scenario, numbers)
        options: Info = {"learner": learner, "others": others, "dead": dead}
        options |= {"max_episode_steps": max_episode_steps, **world_options(locals())}
        self._recipe = partial(type(self), scenario, **options)
        options["render_mode"] = "rgb_array" if render_mode == "human" else render_mode
        self._batch = SurvivalLearnerVectorEnv(1, scenario, autoreset_mode="Disabled", **options)
        self.base_env = self._batch.base_env
        self.metadata = {**self.metadata, "name": self.base_env.scenario.name}
        self.observation_space = self._batch.single_observation_space
        self.action_space = self._batch.single_action_space

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Observation, Info]:
        """Start the first episode of `seed`, an integer from 0 to 2**64 - 1, or the next one. `options` are ignored."""
        if seed is not None:
            keys(seed, 1, 0)
            seed = int(seed)  # Gymnasium does not accept numpy's integers
        super().reset(seed=seed)
        observations, info = self._batch.reset(seed=seed)
        self._show()
        return _first(observations), _numbers(info)

    def step(self, action: Array) -> tuple[Observation, float, bool, bool, Info]:
        """Advance the world by one tick. action: Integers of any type, or a list, in the action space.

        Raises ActionError if it is not, or if `others` returned one that is not; NotResetError between episodes.
        """
        if self.base_env._tracker.done[0]:
            raise NotResetError("step() after the end of the episode; call reset() first")
        self._batch._actions.rows(action, (), who="the learner")
        observations, reward, terminated, truncated, info = self._batch.step(np.asarray(action)[None])
        self._show()
        return _first(observations), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _numbers(info)

    def render(self) -> Any:
        """Return uint8 (height, width, 3), RGB, or text; None with a window, and, with a warning, without a mode."""
        frames = self._batch.render()
        if frames is None or self._window is None:
            return None if frames is None else frames[0]
        self._window.show(frames[0])
        return None

    def action_masks(self) -> Array:
        """Return which actions can do something, bool (entries,); see SurvivalVectorEnv.action_masks."""
        return self._batch.action_masks()[0]

    def set_state(self, state: State) -> Observation:
        """Go on from `state`. Returns the learner's observation. Raises StateError if it is of another scenario."""
        return _first(self._batch.set_state(state))

    def __deepcopy__(self, memo: Any) -> "SurvivalEnv":
        """Return an environment that goes on from where this one is, with `others` of its own."""
        other: SurvivalEnv = type(self).__new__(type(self))
        memo[id(self)] = other  # a policy may refer to the environment that it plays in
        options = self._recipe.keywords
        own = {"others": copied_others(options["others"], memo)}
        other.__init__(*self._recipe.args, **options | own)  # type: ignore[misc]
        copy_changed(self.base_env.worlds, other.base_env.worlds)
        other.set_state(self.get_state())
        other.spec, other.action_space = self.spec, copy.deepcopy(self.action_space)  # with its random generator
        return other

    def __reduce__(self) -> tuple[Any, ...]:
        return self._recipe, (), {"spec": self.spec}


def _first(observations: Observation) -> Observation:
    return each(observations, lambda values: values[0])


def _numbers(info: Info) -> Info:
    """Return the entries of info without their masks, single values as Python's numbers and several as arrays."""
    return {key: values[0].tolist() if values.ndim == 1 else values[0] for key, values in info.items() if key[0] != "_"}
