"""One agent of one world as an ordinary gymnasium environment; the others follow a policy."""

from functools import partial
from typing import Any

import gymnasium

from ..core.validation import Array, as_array, check_choice
from ..errors import ActionError, NotResetError
from ..rendering.modes import FPS, RENDER_MODES
from ..rendering.window import Window
from ..scenarios.scenario import Scenario
from ..snapshots.state import State
from .gymnasium_learners import SurvivalLearnerVectorEnv
from .opponents import Others

Observation = dict[str, Array]


class SurvivalEnv(gymnasium.Env[Observation, Array]):
    """One agent of one world learns.

    Observations: dict of float32 arrays, copies. Actions: MultiDiscrete, in the paper [3, 3, 3, 2, 2, 2]: ahead, left
    and turn (0, 1, 2 for -1, 0, +1), attack, use, give. The reward is the agent's own. Terminated: the world ended by
    its rule, or the learner died; with dead="keep" it stays, with its rewards, until its world ends. Truncated: at the
    time limit, the scenario's (ending_limit) or the one that gymnasium.make was given (max_episode_steps).

    info has the same keys always, numbers all: "alive", and the statistics of the episode so far ("length", "return",
    "kills" of the agent's side, "deaths_zone" ...).

    variant: name or Scenario. learner: id of the agent that learns. others: "noop", "random", "scripted", or a function
    (observations) -> actions; see opponents.Opponents. Copies and pickles hold how an environment was made, not where
    it is: what comes out has not been reset.
    """

    metadata = {"render_modes": [*RENDER_MODES, "human"], "render_fps": FPS}  # noqa: RUF012

    def __init__(
        self,
        variant: str | Scenario = "ffa_3",
        *,
        learner: int = 0,
        others: Others = "random",
        dead: str = "end",
        render_mode: str | None = None,
    ) -> None:
        check_choice("render_mode", render_mode, (None, *RENDER_MODES, "human"))
        options: dict[str, Any] = {"learner": learner, "others": others, "dead": dead}
        self._recipe = partial(type(self), variant, **options, render_mode=render_mode)
        self._window = Window("outlast", FPS) if render_mode == "human" else None
        drawn = "rgb_array" if render_mode == "human" else render_mode
        self.batch = SurvivalLearnerVectorEnv(1, variant, autoreset="Disabled", **options, render_mode=drawn)
        self.metadata = {**type(self).metadata, "name": self.batch.core.scenario.name}
        self.render_mode = render_mode
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode: the first of `seed`, or the next one. Nothing is read from options."""
        super().reset(seed=seed)
        observations, info = self.batch.reset(seed=seed)
        self._show()
        return _first(observations), _numbers(info)

    def step(self, action: Array) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One tick. action: integers of any type, or a list. Raises ActionError, and NotResetError after the end."""
        if self.batch.over[0]:
            raise NotResetError("step() after the end of the episode; call reset() first")
        row, sizes = as_array(action), self.batch.core.action_sizes
        if row.shape != sizes.shape:
            raise ActionError(f"the action has shape {row.shape}: {sizes.shape} is needed, {len(sizes)} integers")
        observations, reward, terminated, truncated, info = self.batch.step(row[None])
        self._show()
        return _first(observations), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _numbers(info)

    def render(self) -> Any:
        """uint8 (height, width, 3) RGB, or text, or None and a window, as render_mode says; reset and step draw that.

        None, with a warning, without a render_mode.
        """
        frames = self.batch.render()
        if frames is None or self._window is None:
            return None if frames is None else frames[0]
        self._window.show(frames[0])
        return None

    def get_state(self) -> State:
        """The world as plain arrays, to go on from later; see SurvivalVectorEnv.get_state."""
        return self.batch.get_state()

    def set_state(self, state: State) -> Observation:
        """Go on from `state`; returns what the learner sees. Raises StateError if it is of another scenario."""
        return _first(self.batch.set_state(state))

    def close(self) -> None:
        """Let go of window and world; again does no harm."""
        if self._window is not None:
            self._window.close()
        self.batch.close()

    def _show(self) -> None:
        if self._window is not None:
            self.render()

    def __reduce__(self) -> tuple[Any, ...]:
        return self._recipe, (), {"spec": self.spec}


def _first(observations: Observation) -> Observation:
    return {key: values[0] for key, values in observations.items()}


def _numbers(info: dict[str, Any]) -> dict[str, Any]:
    """The values without their masks, as Python's own numbers; arrays where there are several."""
    return {key: values[0].tolist() if values.ndim == 1 else values[0] for key, values in info.items() if key[0] != "_"}
