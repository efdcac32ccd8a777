"""The batched environment: many worlds, each with several agents, stepped together."""

import contextlib
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode

from outlast.components import End, Reward
from outlast.ecs import Entity

from ..errors import ActionError, RecordingError
from ..levels import Level
from ..rendering.modes import FPS, RENDER_MODES, render_worlds
from ..scenarios.scenario import Scenario
from ..snapshots.state import State, restore, snapshot
from . import deaths
from .action_spaces import ActionSpace
from .concurrency import CallGuard, check_callable, exclusive, exclusive_step
from .described import Actions, Arrays, Described
from .lifecycle import EpisodeTracker, check_faults, check_places, check_playable
from .notice import announce_compilation
from .numbers import change_levels, change_numbers
from .observations import Observations
from .spaces import check_published
from .step_buffers import StepBuffers
from .step_events import StepEvents
from .step_functions import DONE, FAULTY, FUNCTIONS, OUT_OF_RANGE, PARTS
from .validation import MAX_WORLDS, Seeds, as_array, check_choice, check_count, check_flags, keys, reset_mask
from .validation import autoreset_mode as checked_autoreset_mode
from .wrappers import refuse_dicts, refuse_reward_sums

Stops = Callable[[], tuple[Actions, Actions]]
Runner = TypeVar("Runner")  # see recording.Recorder: run, check, close and recording


class SurvivalVectorEnv(Described):
    """Many worlds of a scenario as a gymnasium VectorEnv whose sub-environments are whole worlds.

    ## Description
    Agents in a closed room fight with melee attacks, collect and use items, break boxes, and have to stay inside a zone
    that shrinks. All worlds advance together by one tick a step. Mechanics and numbers are those of the scenario.

    One call at a time: PendingError refuses a thread while another one is in a call, but not a signal handler, which
    must not call the environment that it may have interrupted. Ctrl-C leaves a step not begun or whole, or else worlds
    that `step` refuses (NotResetError) until they are reset.

    ## Action Space
    MultiDiscrete, integers (worlds, agents, actions); `action_columns` has their names. In the paper's variants
    [3, 3, 3, 2, 2, 2]: ahead, left and turn (0, 1, 2 for -1, 0, +1), attack, use, give. With actions="joint" a single
    integer (worlds, agents) stands for all of them, 0 to 215; with "continuous" each is a float from -1 to 1. `noop` is
    the action that does nothing; `action_masks()` says which others would do as little.

    ## Observation Space
    Dict of Box, float32 (worlds, agents, ...), in metres, metres a second, radians and hit points. Which keys there are
    depends on the mechanics; what an agent does not see is 0, and so is its entry in the key's mask (`others_mask`).
    Mechanics may add to rows: read them by the names in `fields`. With observations="flat" a single Box, float32
    (worlds, agents, flat_size), whose columns have the names `flat_names`. `state()` is the whole world.

    ## Rewards
    float32 (worlds, agents): every agent of a world has its own. Wrappers that sum one reward for each sub-environment
    are refused; `make_agents` is for them.

    ## Starting State
    Agents, boxes and heals at random places of a grid, with full health. A function of (seed, world, episode): an int
    seed keys world i by (seed, first_world + i), so that it is world i of any other batch of that seed.

    ## Episode End
    Terminated, truncated: bool (worlds,), as an episode ends for all agents of a world at once: terminated by the
    scenario's rule, truncated at its limit (`ending_limit`, ticks). Dead agents stay until then.

    Every info has "alive", bool (worlds, agents). When worlds end it also has "statistics", the episode's numbers by
    name, (worlds,) or (worlds, n), with "_statistics", the mask of worlds that they are of; under SAME_STEP "final_obs"
    and "final_info" (what info was before the reset), with their masks, too. Where the number of agents varies,
    "statistics_present" says which entries of agents and sides the episode had, bool (worlds, n) by name; others are 0.

    ## Arguments
    See `make_vec`, which also takes the name of a variant.

    ## Version History
    v1: the rules of the paper's runs. v0: those of outlast 0.1.0.
    """

    def __init__(
        self,
        scenario: Scenario,
        num_worlds: int,
        *,
        seed: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        check_actions: bool = True,
        first_world: int = 0,
        render_mode: str | None = None,
        actions: str = "multi",
        observations: str = "dict",
        scaled: bool = False,
        action_masks: bool = False,
        specialize: bool = False,
        interpret: Collection[str] = (),
    ) -> None:
        check_count("num_worlds", num_worlds, 1, MAX_WORLDS)
        check_count("threads", threads, 1)
        check_count("first_world", first_world, 0, MAX_WORLDS)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        check_flags(copy=copy, check_actions=check_actions, scaled=scaled)
        check_flags(action_masks=action_masks, specialize=specialize)
        self.scenario, self.copy, self.check_actions, self.first_world = scenario, copy, check_actions, first_world
        self.autoreset_mode, self.render_mode = checked_autoreset_mode(autoreset_mode), render_mode
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": FPS, "name": scenario.name}
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.worlds = scenario.worlds(
            int(num_worlds), int(threads), interpret=interpret, specialize=specialize, functions=FUNCTIONS, parts=PARTS
        )
        self._runner: Any = self.worlds  # or what also records it
        self._guard = CallGuard()
        check_playable(self.worlds, scenario.name)
        check_published(self.worlds)
        self.num_envs = self.num_worlds = int(num_worlds)
        self.num_agents = self.worlds.dims["agents"]
        self._reader = Observations(self.worlds, observations, scaled)
        self._actions, self._masked = ActionSpace(self.worlds, actions, action_masks), bool(action_masks)
        self.single_observation_space = self._reader.space
        self.single_action_space = self._actions.batched(self.num_agents)
        self._tracker = EpisodeTracker(self.worlds, self._actions.sizes, self._actions.zeros, self.autoreset_mode)
        end = self.worlds[End]
        self._reward = self.worlds[Reward].reward
        self._terminated, self._truncated = end.terminated[:, 0], end.truncated[:, 0]
        self._living = self.worlds[Entity].alive[:, self.worlds.span("agent")]
        self._step_events = StepEvents(self.worlds)
        self._stops: Stops | None = None
        self._wrappers_checked = False
        seed = seed if seed is not None else int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> 1)
        self.worlds.seed(*keys(seed, self.num_worlds, self.first_world)[:2])
        with announce_compilation(self.worlds, scenario.name):
            self._tracker.load()
            self.worlds.run(self._tracker.mode)  # nothing moves

    @exclusive
    def reset(
        self, *, seed: Seeds | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: An int keys the random numbers of world i by (seed, first_world + i); a sequence of num_worlds ints
                keys them by (seed[i], 0). None, for all or in the sequence: the world goes on to its next episode.
            options: {"reset_mask": bool (worlds,)}: the worlds to reset; without it, all.

        Returns:
            Observations, float32 (worlds, agents, ...) by key, and info with "alive", bool (worlds, agents). Where
            numbers vary, info also has "numbers", those of the episode, (worlds, ...) by name, and "present", bool
            (worlds, agents).

        Raises:
            ValueError: A seed or mask that cannot be.
            TypeError: A wrapper is around that cannot work with a reward for each agent.
        """
        refuse_reward_sums(sys._getframe(2))
        refuse_dicts(sys._getframe(2))
        self._wrappers_checked = False
        mask = reset_mask(options, self.num_worlds)
        given = None if seed is None else keys(seed, self.num_worlds, self.first_world)
        self._tracker.reset(self._runner, mask, given)
        check_places(self.worlds, self.first_world)
        self._step_events.forget(mask)
        return self._observe(), self._info()

    @exclusive_step
    def step(
        self, actions: Actions, *, out: Mapping[str, Any] | None = None
    ) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """Take every world through one tick. A refused call changes nothing.

        NEXT_STEP: a world that ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at
        once; info["final_obs"] holds its last observation. DISABLED: reset it yourself.

        Args:
            actions: Integers of any type, (worlds, agents, actions), each from 0 to its size - 1; with actions="joint"
                (worlds, agents); with actions="continuous" floats from -1 to 1, (worlds, agents, actions).
            out: Where to write what is returned, instead of into new arrays: memory of the caller's, such as a tensor
                of PyTorch, by name. "observations" as in `observe`, "rewards", "terminated", "truncated"; "state" and
                "action_mask" as `state` and `action_masks` have them; some or all.

        Returns:
            Observations; rewards, float32 (worlds, agents); terminated and truncated, bool (worlds,); and info, which
            always has what that of `reset` has, of the observations that are returned.

        Raises:
            ActionError: Actions of the wrong shape or type, or out of range.
            NotResetError: Worlds that have not been reset, or have ended under DISABLED.
            FaultError: A world is in a state that physics cannot take; the others have been stepped.
            ValueError: `out` has other names, shapes or types.
            TypeError: A wrapper is around that cannot work with a reward for each agent.
        """
        if not self._wrappers_checked:  # once between two resets
            refuse_reward_sums(sys._getframe(2))
            self._wrappers_checked = True
        return self._step(actions, out)

    def _step(
        self, actions: Actions, out: Mapping[str, Any] | None = None, some: Any = None
    ) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        buffers = None if out is None else StepBuffers(self, out)
        tracker = self._tracker
        self._actions.write(actions, tracker.actions)
        ranges = self.check_actions or self._recording
        flags = tracker.step(self._runner, ranges) if some is None else tracker.step_some(self._runner, some)
        if flags & OUT_OF_RANGE:
            self._actions.write(actions, tracker.actions, ranges=True)  # raises what is wrong
            raise ActionError("actions were out of range, and are not any more: another thread has written to them")
        if self._step_events.some:
            self._step_events.forget()
        terminated, truncated = self._terminated.copy(), self._truncated.copy()
        if self._stops is not None:
            self._stop(slice(None), terminated, truncated)
        if deaths.LOGGER.level <= deaths.LEVEL:
            deaths.log(self.worlds, self.first_world)
        reward = self._reward.copy() if buffers is None else buffers.put("rewards", self._reward)
        ended: dict[str, Any] = {}
        try:
            if flags & FAULTY:
                check_faults(self.worlds, self.first_world)
        finally:  # the other worlds go on
            if (flags & DONE or self._stops is not None) and (done := tracker.done).any():
                ended = self._finish(done)
        info = self._info()
        if ended:
            info |= ended
        if buffers is None:
            return self._observe(), reward, terminated, truncated, info
        ends = buffers.put("terminated", terminated), buffers.put("truncated", truncated)
        observed = buffers.fill()
        return self._observe() if observed is None else observed, reward, *ends, info

    def send(self, actions: Actions) -> None:
        """Begin a step in the background; `recv` returns it. Until then every other call is a PendingError.

        Two environments, each half of the worlds (first_world=), keep a policy and the simulation busy at once. The
        actions are copied. With copy=False, the arrays that the call before returned are overwritten while it runs.
        """
        check_callable(self)
        with contextlib.suppress(ActionError):  # which `recv` raises
            actions = np.array(as_array(actions))
        self._guard.begin(self._step, actions)

    def recv(self) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """What `step` would have returned or raised for the actions that were sent. PendingError if none were."""
        result: tuple[Arrays, Any, Any, Any, dict[str, Any]] = self._guard.fetch()
        return result

    @exclusive
    def render(self) -> tuple[Any, ...] | None:
        """Draw every world: a tuple of uint8 (height, width, 3), RGB, or of texts, as render_mode says.

        None, with a warning, without a render_mode. NotResetError before reset(). `outlast.draw` draws one world.
        """
        if self.render_mode is not None:
            self._tracker.check_running("render")
        return render_worlds(self.worlds, self.render_mode)

    @exclusive
    def get_state(self, where: Any = slice(None)) -> State:
        """The state of the worlds `where` (mask, indices or slice) as plain arrays, in mid-episode or not.

        Of a world that has not been reset, it is the state of one that has to be reset.
        """
        return snapshot(self.scenario, self.worlds, self._tracker.masks, where)

    @exclusive
    def set_state(self, state: State, where: Any = slice(None)) -> Arrays:
        """Go on from `state`. Random numbers go on as they would have: copies of a world have the same future.

        Args:
            state: The state of as many worlds as `where` names, or of one for all of them.
            where: The worlds that go on from it: mask, indices or slice.

        Returns:
            The observations.

        Raises:
            StateError: It is of another scenario or of too many worlds; nothing was changed.
            RecordingError: A recording goes on.
        """
        self._check_unrecorded("set_state")
        with self._tracker.overwritten(where) as masks:
            restore(state, self.scenario, self.worlds, masks, where)
            self._step_events.forget(where)
            self._stop(where)
        return self._observe()

    @exclusive
    def set_numbers(self, given: Mapping[str, Any] | None = None, /, *, mask: Any = None, **numbers: Any) -> None:
        """Change numbers of the game.

        One that varies (see Scenario.vary) is set for some worlds from their next reset on, and no longer drawn there;
        that is part of their state. All others change in all worlds, from the next step on, in mid-episode or not;
        `scenario` stays what was asked for, and a state does not have them.

        Args:
            given: By name, as Scenario.replace takes them: {"melee_damage": array}. Of one that varies, a value or an
                array with one for each world, (worlds, ...), of which those of `mask` count; None: it is drawn again.
            mask: The worlds, bool (worlds,); None: all.
            **numbers: More of them: rewards_kill=5.

        Raises:
            NumberError: One that is unknown or cannot change while worlds run, a value that cannot be, or a mask for
                one that does not vary; nothing was changed.
            ValueError: A mask that cannot be.
            RecordingError: A recording goes on, and one does not vary.
        """
        asked = [*(given or {}).items(), *numbers.items()]
        change_numbers(self.scenario, self.worlds, asked, mask, lambda: self._check_unrecorded("set_numbers"))

    @exclusive
    def set_levels(self, levels: Sequence[Level], mask: Any = None) -> None:
        """Play these levels in the next episodes, in place of others that wait; after that, worlds draw again.

        Args:
            levels: One for each world of the mask, in order, or one for all of them. Their numbers are drawn again
                afterwards, also those that had been set.
            mask: The worlds, bool (worlds,); None: all.

        Raises:
            NumberError: Another number of levels, numbers that do not vary, or values that could not be drawn.
            ValueError: A mask that cannot be.
        """
        change_levels(self.worlds, levels, mask)

    def stop_when(self, stops: Stops) -> None:
        """End episodes earlier than the scenario does; for adapters, such as one whose episode ends with its learner.

        The worlds that it names are reported and reset like those that ended by themselves.

        Args:
            stops: Called after every tick; who terminates, who is truncated, bool (worlds,), by the state alone.
        """
        self._stops = stops

    @exclusive
    def run_with(self, make_runner: Callable[[], Runner]) -> Runner:
        """Run the worlds through what make_runner() returns, for outlast.record. Raises RecordingError."""
        self._check_unrecorded("record")
        if self.worlds.changed:
            names = ", ".join(self.worlds.changed)
            raise RecordingError(f"{names} changed by set_numbers(): record an environment of the scenario with them")
        self._runner = runner = make_runner()
        return runner

    def close_extras(self, **kwargs: Any) -> None:
        """Let the threads go, and end a recording."""
        if hasattr(self, "worlds"):  # it is not there when the constructor refused its arguments
            self._guard.close()
            self.worlds.close()
            self._runner.close()

    def _finish(self, done: Actions) -> dict[str, Any]:
        """Report the episodes that just ended; under SAME_STEP also start the next ones."""
        info = self._ended(done)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            info |= {"final_info": info | self._info(), "_final_info": done.copy()}
            info |= {"final_obs": self._reader.of_each(done), "_final_obs": done.copy()}
            self._step_events.keep(done)
            self._tracker.reset(self._runner, done)
        return info

    def _stop(self, where: Any, *reported: Actions) -> None:
        """Ask `stop_when` about the worlds `where`; it is added to what is reported of them."""
        if self._stops is None:
            return
        stops = self._stops()
        self._tracker.stopped[where] = np.logical_or(*stops)[where]
        for mask, more in zip(reported, stops):
            mask |= more

    def _check_unrecorded(self, call: str) -> None:
        if self._recording:
            raise RecordingError(f"{call}() while a recording goes on; close() that first")

    @property
    def _recording(self) -> bool:
        return self._runner is not self.worlds and bool(self._runner.recording)
