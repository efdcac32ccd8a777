"""The bases of all adapters, and of those of a single world."""

from collections.abc import Callable, Mapping
from typing import Any

from outlast.components import Return
from outlast.ecs import NumberError, Worlds

from ..core.validation import Array, check_choice, check_count
from ..core.vector_env import SurvivalVectorEnv
from ..rendering.rgb import FPS, RENDER_MODES, Pictured, Window
from ..scenarios.parse import options_of, resolve
from ..scenarios.scenario import Scenario
from ..snapshots.state import State

Info = dict[str, Any]


def check_dead(dead: str, worlds: Worlds) -> None:
    """Raise ValueError unless `dead` is "end" or "keep", and "keep" if agents come back to life."""
    check_choice("dead", dead, ("end", "keep"))
    if dead == "end" and Return in worlds:
        raise ValueError("dead = 'end': agents come back in this scenario, so none ends at its death; take dead='keep'")


def requested(
    make: Callable[..., Any], scenario: str | Scenario, numbers: Mapping[str, Any], max_episode_steps: int | None = None
) -> Scenario:
    """Return the scenario that the factory `make` was called with; its time limit becomes the number ending_limit."""
    given = dict(numbers)
    if (dead := given.pop("dead", "keep")) != "keep":  # for factories that have no keyword `dead`
        cure = "gymnasium.make, gymnasium.make_vec, parallel_env and SurvivalMultiAgentEnv have dead='end'"
        raise ValueError(f"dead = {dead!r}: 'keep' is needed, as all agents of a world end together here; {cure}")
    if max_episode_steps is not None:
        check_count("max_episode_steps", max_episode_steps, 1)
        if "ending_limit" in given:
            raise ValueError("max_episode_steps and ending_limit are the same number: give one of them")
        scenario = resolve(scenario)
        if "ending_limit" not in scenario.numbers():
            raise NumberError(f"max_episode_steps: {scenario.name} has no mechanic Ending, whose ending_limit that is")
        given["ending_limit"] = max_episode_steps
    return resolve(scenario, given, options_of(make))


class Adapter(Pictured):
    """The base of adapters: what all of them take from `base_env`, the SurvivalVectorEnv below."""

    base_env: SurvivalVectorEnv

    @property
    def state_space(self) -> Any:
        """The space of one world's row of `state`: Box, float32 (size,)."""
        return self.base_env.state_space

    @property
    def state_names(self) -> list[str]:
        """The names of the columns of `state`; see SurvivalVectorEnv.state_names."""
        return self.base_env.state_names

    def state(self, out: Any = None) -> Array:
        """Return each world as one vector, float32 (num_worlds, size), for critics; see SurvivalVectorEnv.state."""
        return self.base_env.state(out)

    def get_state(self) -> State:
        """Return the worlds' state as plain arrays, to go on from later; see SurvivalVectorEnv.get_state."""
        return self.base_env.get_state()


class OneWorldAdapter(Adapter):
    """The base of adapters of a single world, which a window may show."""

    metadata = {"render_modes": [*RENDER_MODES, "human"], "render_fps": FPS}  # noqa: RUF012
    render_mode: str | None
    render: Callable[[], Any]

    def _prepare_render(self, render_mode: str | None) -> None:
        check_choice("render_mode", render_mode, (None, *RENDER_MODES, "human"))
        self.render_mode, self._window = render_mode, Window(FPS) if render_mode == "human" else None

    def state(self) -> Array:  # type: ignore[override]
        """Return the complete world, also what no agent sees, float32 (size,); see SurvivalVectorEnv.state."""
        return self.base_env.state()[0]

    def close(self) -> None:
        """Close the window and the world. Closing again does no harm."""
        if self._window is not None:
            self._window.close()
        self.base_env.close()

    def _show(self) -> None:
        if self._window is not None:
            self.render()
