"""The batched environment: many worlds, each with several agents, stepped together."""

import os
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.components import End, Reward
from outlast.ecs import RESET, SKIP, STEP, Action, Observation, Worlds

from ..errors import RecordingError
from ..rendering.modes import FPS, RENDER_MODES, render_worlds
from ..scenarios.scenario import Scenario
from ..snapshots.state import State, put, take
from .buffers import copies, flat_size, locked, write
from .concurrency import Background, alone, check_callable
from .deaths import log_deaths
from .lifecycle import EpisodeTracker, check_faults, check_playable
from .notice import announce_compilation
from .spaces import action_space, check_published, observation_space, published, statistics
from .validation import autoreset_mode, check_choice, check_count, checked_actions, keys, reset_mask

if TYPE_CHECKING:
    from ..recording import Recorder  # which needs this module

Arrays = dict[str, np.ndarray[Any, Any]]
Actions = np.ndarray[Any, Any]
Stops = Callable[[], tuple[Actions, Actions]]
Runner = TypeVar("Runner")  # see recording.Recorder: run, check, close and recording


class SurvivalVectorEnv(VectorEnv[Arrays, Actions, np.ndarray[Any, Any]]):
    """`num_worlds` worlds of a scenario as a gymnasium VectorEnv whose sub-environments are whole worlds.

    Observations: dict of float32 (worlds, agents, ...). Actions: integers (worlds, agents, actions). Rewards: float32
    (worlds, agents). Terminated, truncated: bool (worlds,), as an episode ends for all agents of a world at once.

    Randomness is a function of (seed, world, episode): world i of a batch is the world i of any other batch, so
    `first_world=i` gives it alone. Observations are read-only and overwritten by the next call, unless copy=True.
    check_actions=False leaves out the range check (out-of-range actions then mean nothing in particular, but harm
    nothing). noop: the action of an agent that does nothing, read-only integers (actions,).

    One call at a time: PendingError refuses a thread while another one is in a call. Ctrl-C leaves a step not begun or
    whole, or else worlds that a step refuses (NotResetError) until they are reset.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_worlds: int,
        *,
        seed: int | None = None,
        threads: int = 1,
        autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = False,
        check_actions: bool = True,
        first_world: int = 0,
        render_mode: str | None = None,
    ) -> None:
        check_count("num_worlds", num_worlds, 1)
        check_count("threads", threads, 1)
        check_count("first_world", first_world, 0)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        self.scenario, self.copy, self.check_actions, self.first_world = scenario, copy, check_actions, first_world
        self.autoreset, self.render_mode = autoreset_mode(autoreset), render_mode
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": FPS, "name": scenario.name}
        self.metadata["autoreset_mode"] = self.autoreset
        self.worlds = Worlds(scenario.modules, int(num_worlds), int(threads))
        self._runner: Any = self.worlds  # or what also records it
        self._background = Background()
        check_playable(self.worlds, scenario.name)
        check_published(self.worlds)
        self.num_envs = self.num_worlds = int(num_worlds)
        self.num_agents = self.worlds.dims["agents"]
        self.single_observation_space = observation_space(self.worlds)
        self.single_action_space = action_space(self.worlds)
        actions = published(self.worlds, Action)
        self.action_columns = [(key, int(column.low)) for key, _, _, column in actions]
        self.noop = np.array([-low for _, low in self.action_columns])
        self.noop.flags.writeable = False
        self.action_sizes = self.single_action_space.nvec[0]
        self._observations = {
            k: locked(getattr(self.worlds[c], n)) for k, c, n, _ in published(self.worlds, Observation)
        }
        self._mode = np.zeros(self.num_worlds, np.int8)
        self._tracker = EpisodeTracker(self.worlds, self.autoreset is AutoresetMode.SAME_STEP)
        self._masks = {"over": self._tracker.ended, "started": self._tracker.running}  # as saved states name them
        self._stops: Stops | None = None
        seed = seed if seed is not None else int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> 1)
        self.worlds.seed(*keys(seed, self.num_worlds, self.first_world))
        with announce_compilation(self.worlds, scenario.name):
            self.worlds.run(self._mode)  # nobody moves, but the tick gets compiled or loaded

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; made when first asked for, as it is as large as a batch of observations."""
        return batch_space(self.single_observation_space, self.num_worlds)

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """The single space, batched; the same object in every call, as its generator goes on from sample to sample."""
        return batch_space(self.single_action_space, self.num_worlds)

    @alone
    def reset(
        self, *, seed: int | list[int] | np.ndarray[Any, Any] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes everywhere, or where options["reset_mask"] (bool, (worlds,)) says.

        seed: an int keys world i by (seed, first_world + i); a sequence keys it by (seed[i], 0). Without a seed, every
        world goes on to its next episode.
        """
        mask = reset_mask(options, self.num_worlds)
        given = None if seed is None else keys(seed, self.num_worlds, self.first_world)
        self._run(mask, given)
        return self._observe(), {}

    @alone
    def step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """One tick of every world. A refused call (see ActionError) changes nothing.

        NEXT_STEP: a world that ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at
        once; info["final_obs"] holds its last observation. DISABLED: reset it yourself. Whenever worlds end,
        info["statistics"] holds their episodes and info["_statistics"] says which.
        """
        return self._step(actions)

    def _step(self, actions: Actions) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        self._tracker.check(resets=self.autoreset is not AutoresetMode.DISABLED)
        self._take(actions)
        self._run()
        end = self.worlds[End]
        terminated, truncated = end.terminated[:, 0].copy(), end.truncated[:, 0].copy()
        self._stop(slice(None), terminated, truncated)
        log_deaths(self.worlds, self.first_world)
        reward = self.worlds[Reward].reward.copy()
        try:
            check_faults(self.worlds)
        finally:  # the other worlds go on
            info = self._finish(done) if (done := self._tracker.done).any() else {}
        return self._observe(), reward, terminated, truncated, info

    def send(self, actions: Actions) -> None:
        """Begin a step in the background; `recv` returns it. Until then every other call is a PendingError.

        Two environments, each half of the worlds (first_world=), keep a policy and the simulation busy at once. The
        arrays that the call before returned are overwritten while the step runs, unless copy=True.
        """
        check_callable(self)
        self._background.begin(self._step, actions)

    def recv(self) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """What `step` would have returned or raised for the actions that were sent."""
        result: tuple[Arrays, Any, Any, Any, dict[str, Any]] = self._background.fetch()
        return result

    @alone
    def render(self) -> tuple[Any, ...] | None:
        """A frame of each world, uint8 (512, 512, 3) or text; None without a render_mode."""
        return render_worlds(self.worlds, self.render_mode)

    @alone
    def observe(self, out: Any = None) -> Arrays:
        """The observations as they are now; also written into `out`, if that is given (see core.buffers).

        out: {key: float32 (worlds, agents, ...)} or one float32 array (worlds, agents, flat_size).
        """
        if out is not None:
            write(self._observations, out)
        return self._observe()

    @property
    def flat_size(self) -> int:
        """Numbers that one agent is told: the length of its row in a flat array."""
        return flat_size(self._observations)

    @alone
    def get_state(self, where: Any = slice(None)) -> State:
        """The state of the worlds `where` (mask, indices or slice) as plain arrays, in mid-episode or not."""
        return take(self.scenario, self.worlds, self._masks, where)

    @alone
    def set_state(self, state: State, where: Any = slice(None)) -> Arrays:
        """Go on from `state` in the worlds `where`: one for each, or one for all of them. Returns the observations.

        Raises StateError, and changes nothing, if it is of another scenario or of too many worlds. Random numbers go on
        as they would have: copies of a world see the same.
        """
        self._check_unrecorded("set_state")
        with self._tracker.overwritten(where):
            put(state, self.scenario, self.worlds, self._masks, where)
        self._stop(where)
        return self._observe()

    def stop_when(self, stops: Stops) -> None:
        """End episodes earlier than the scenario does; for adapters, such as one whose episode ends with its learner.

        The worlds that it names are treated as those that ended by themselves: reported in terminated, truncated and
        info, and reset as autoreset_mode says.

        Args:
            stops: Called after every tick; returns who terminates and who is truncated, bool (worlds,) each, as a
                function of the worlds' state alone.
        """
        self._stops = stops

    def record(self, path: str | os.PathLike[str]) -> "Recorder":
        """See outlast.record, which takes the place of this."""
        from ..recording import record

        return record(self, path)

    @alone
    def run_with(self, make_runner: Callable[[], Runner]) -> Runner:
        """Run the worlds through what make_runner() returns; for outlast.record. Raises RecordingError if one does."""
        self._check_unrecorded("record")
        self._runner = runner = make_runner()
        return runner

    def __reduce__(self) -> Any:
        raise TypeError(
            "an environment cannot be pickled or copied; pickle what makes it, as "
            "functools.partial(outlast.make_vec, 'ffa_3', 64, seed=0), and what get_state() returns"
        )

    def close_extras(self, **kwargs: Any) -> None:
        """Let the threads go, and end a recording."""
        if hasattr(self, "worlds"):  # it is not there when the constructor refused its arguments
            self._background.close()
            self.worlds.close()
            self._runner.close()

    def _finish(self, done: Actions) -> dict[str, Any]:
        """Report the episodes that just ended; under SAME_STEP also start the next ones."""
        info: dict[str, Any] = {"statistics": statistics(self.worlds, done), "_statistics": done}
        if self.autoreset is AutoresetMode.SAME_STEP:
            info |= {"final_obs": copies(self._observations, done), "_final_obs": done.copy()}
            info |= {"final_info": {"statistics": info["statistics"]}, "_final_info": done.copy()}
            self._run(done)
        return info

    def _stop(self, where: Any, *reported: Actions) -> None:
        """Ask `stop_when` about the worlds `where`; it is added to what is reported of them."""
        if self._stops is None:
            return
        stops = self._stops()
        self._tracker.stopped[where] = np.logical_or(*stops)[where]
        for mask, more in zip(reported, stops):
            mask |= more

    def _run(self, resets: Actions | None = None, given: tuple[Actions, Actions] | None = None) -> None:
        """Reset these worlds, keyed as given; or take a step everywhere, which is a reset where an episode is over."""
        self._mode[:] = STEP + self._tracker.done if resets is None else np.where(resets, RESET, SKIP)
        if given is not None and self._recording:
            self._runner.check(self._mode)  # ahead of new seeds
        self._tracker.run(self._runner, self._mode, resets, given)

    def _observe(self) -> Arrays:
        return {key: buffer.copy() if self.copy else buffer for key, buffer in self._observations.items()}

    def _check_unrecorded(self, call: str) -> None:
        if self._recording:
            raise RecordingError(f"{call}() while a recording goes on; close() that first")

    @property
    def _recording(self) -> bool:
        return self._runner is not self.worlds and bool(self._runner.recording)

    def _take(self, actions: Any) -> None:
        shape = (self.num_worlds, self.num_agents, len(self.action_sizes))
        actions = checked_actions(actions, shape, self.action_sizes, self.check_actions or self._recording)
        np.subtract(actions.transpose(2, 0, 1), self.noop[:, None, None], out=self.worlds.actions, casting="unsafe")
