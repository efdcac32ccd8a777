"""The batched environment: many worlds, each with several agents, stepped together."""

import contextlib
import inspect
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from outlast.components import End, Reward
from outlast.components.agent import side_names
from outlast.ecs import AgentRoles, Fields, Observer

from ..errors import ActionError, RecordingError
from ..levels import Level
from ..rendering.rgb import FPS, RENDER_MODES, Pictured, render_worlds
from ..scenarios.scenario import Scenario
from ..snapshots.state import State, restore, snapshot
from . import lifecycle
from .action_spaces import ActionSpace
from .concurrency import CallGuard, check_callable, exclusive
from .numbers import change_levels, change_numbers, current_levels, current_numbers
from .observations import GlobalState, Observations, writable
from .one_world import Query, place
from .spaces import Presence, check_published, counted, statistics
from .validation import MAX_WORLDS, Array, Seeds, as_array, check_choice, check_count, check_flags, keys, reset_mask
from .validation import autoreset_mode as checked_autoreset_mode

Arrays = dict[str, Array]
Actions = Array
OUT = ("observations", "rewards", "terminated", "truncated", "state", "action_mask")  # names of what a step returns
Stops = Callable[[], tuple[Actions, Actions]]
Watcher = TypeVar("Watcher", bound=Observer)


class BatchedSpaces(VectorEnv[Arrays, Actions, Array]):
    """A VectorEnv whose batched spaces are made on first use, as they take as much memory as a batch does."""

    @cached_property
    def observation_space(self) -> Any:  # type: ignore[override]
        """`single_observation_space`, batched."""
        return batch_space(self.single_observation_space, self.num_envs)

    @cached_property
    def action_space(self) -> Any:  # type: ignore[override]
        """`single_action_space`, batched. Always the same object, as its generator goes on from sample to sample."""
        return batch_space(self.single_action_space, self.num_envs)


class SurvivalVectorEnv(Pictured, BatchedSpaces):
    """Many worlds of a scenario as a gymnasium VectorEnv whose sub-environments are worlds.

    ## Description
    Agents in a closed room fight with melee attacks, collect and use items, break boxes, and have to stay inside a zone
    that shrinks. All worlds advance together, one tick per step. The scenario sets the mechanics and their numbers.

    Only one thread may be in a call at a time; another one gets a PendingError. A signal handler gets no such error, so
    it must not call an environment that it may have interrupted. After Ctrl-C, a step either has not begun or is
    complete; otherwise `step` refuses to go on (NotResetError) until the worlds that it was interrupted in are reset.

    ## Action Space
    MultiDiscrete, integers (worlds, agents, actions); `action_columns` has their names. In the paper's variants it is
    [3, 3, 3, 2, 2, 2]: ahead, left and turn (0, 1, 2 for -1, 0, +1), attack, use, give. With actions="joint" a single
    integer per agent, (worlds, agents), stands for all of them, 0 to 215; with "continuous" each is a float from -1 to
    1. `noop` is the action that does nothing; `action_masks()` returns which others have no effect, either.

    ## Observation Space
    Dict of Box, float32 (worlds, agents, ...), in metres, metres per second, radians and hit points. The keys depend on
    the mechanics. What an agent does not see is 0, and so is its entry in the key's mask (`others_mask`). Mechanics may
    add columns to rows, so read columns by their names in `fields`. With observations="flat" it is a single Box,
    float32 (worlds, agents, flat_size), whose columns are named by `flat_names`. `state()` is the complete world.

    ## Rewards
    float32 (worlds, agents): every agent of a world has its own. Wrappers that sum up one reward per sub-environment,
    RecordEpisodeStatistics and NormalizeReward, do not fit; use `make_agents` with them.

    ## Starting State
    Agents, boxes and heals at random places of a grid, with full health. It is a function of (seed, world, episode): an
    int seed keys world i by (seed, first_world + i), so world i is the same in every batch with that seed.

    ## Episode End
    Terminated, truncated: bool (worlds,), as an episode ends for all agents of a world at once: terminated by the
    scenario's rule, truncated at its limit (`ending_limit`, ticks). Dead agents stay until then.

    Every info has "alive", bool (worlds, agents). When worlds end, it also has "statistics", the episode's numbers by
    name, (worlds,) or (worlds, n), and "_statistics", the mask of the worlds that have ended; under SAME_STEP also
    "final_obs" and "final_info" (info as it was before the reset), with their masks. If the number of agents varies,
    "statistics_present": the agents and sides of the episode, bool (worlds, n) by name; other entries are 0.

    ## Arguments
    See `make_vec`, which also takes the name of a variant.

    ## Version History
    v1: the rules of the paper's runs.
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
        check_count("threads", threads, 1, MAX_WORLDS)
        check_count("first_world", first_world, 0, MAX_WORLDS)
        check_choice("render_mode", render_mode, (None, *RENDER_MODES))
        flags = {"copy": copy, "check_actions": check_actions, "scaled": scaled, "action_masks": action_masks}
        check_flags(**flags, specialize=specialize)
        self.scenario, self.copy, self.check_actions, self.first_world = scenario, copy, check_actions, first_world
        self.autoreset_mode, self.render_mode = checked_autoreset_mode(autoreset_mode), render_mode
        self.metadata = {"render_modes": list(RENDER_MODES), "render_fps": FPS, "name": scenario.name}
        self.metadata["autoreset_mode"] = self.autoreset_mode
        self.worlds = scenario.worlds(int(num_worlds), int(threads), interpret=interpret, specialize=specialize)
        self._guard = CallGuard()
        lifecycle.check_playable(self.worlds, scenario.name)
        check_published(self.worlds)
        self.num_envs = self.num_worlds = int(num_worlds)
        self.num_agents = self.worlds.dims["agents"]
        self._reader = Observations(self.worlds, observations, scaled)
        self._actions, self._masked = ActionSpace(self.worlds, actions, action_masks), bool(action_masks)
        self.single_observation_space = self._reader.space
        self.single_action_space = self._actions.batched(self.num_agents)
        self._tracker = lifecycle.EpisodeTracker(self.worlds, self.autoreset_mode)
        end = self.worlds[End]
        self._reward, self._varied = self.worlds[Reward].reward, bool(self.worlds.layout.varied)
        self._terminated, self._truncated = end.terminated[:, 0], end.truncated[:, 0]
        self._step_events = lifecycle.StepEvents(self.worlds)
        self._stops: Stops | None = None
        seed = seed if seed is not None else int(np.random.SeedSequence().generate_state(1, np.uint64)[0] >> 1)
        self.worlds.seed(*keys(seed, self.num_worlds, self.first_world)[:2])
        with lifecycle.announce_compilation(self.worlds, scenario.name):
            self._tracker.load()
            self.worlds.run(self._tracker.mode)  # compiles or loads the tick; no world runs yet

    @exclusive
    def reset(
        self, *, seed: Seeds | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Arrays, dict[str, Any]]:
        """Start new episodes.

        Args:
            seed: An int keys the random numbers of world i by (seed, first_world + i); a sequence of num_worlds ints
                keys them by (seed[i], 0). Where it is None, or has the entry None, worlds go on to their next episode.
            options: {"reset_mask": bool (worlds,)}: the worlds to reset; without it, all.

        Returns:
            Observations, float32 (worlds, agents, ...) by key, and info with "alive", bool (worlds, agents). If numbers
            vary, info also has "numbers", their values in this episode, (worlds, ...) by name; if the number of agents
            does, "present", bool (worlds, agents).

        Raises:
            ValueError: The seed or the mask is not valid.
        """
        mask = reset_mask(options, self.num_worlds)
        given = None if seed is None else keys(seed, self.num_worlds, self.first_world)
        self._tracker.reset(mask, given)
        lifecycle.check_places(self.worlds, self.first_world)
        self._step_events.forget(mask)
        return self._observe(), self._info()

    @exclusive
    def step(
        self, actions: Actions, *, out: Mapping[str, Any] | None = None
    ) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """Advance every world by one tick. A refused call changes nothing.

        NEXT_STEP: a world that ended is reset by the next call, which ignores its actions. SAME_STEP: it is reset at
        once; info["final_obs"] holds its last observation. DISABLED: reset it yourself.

        Args:
            actions: Integers of any type, (worlds, agents, actions), each from 0 to its size - 1; with actions="joint"
                (worlds, agents); with actions="continuous" floats from -1 to 1, (worlds, agents, actions).
            out: The caller's own memory to write results into, instead of new arrays: numpy arrays or, for example,
                PyTorch tensors, by name. Any of "observations", as in `observe`, "rewards", "terminated", "truncated",
                and "state" and "action_mask", as in `state` and `action_masks`.

        Returns:
            Observations; rewards, float32 (worlds, agents); terminated and truncated, bool (worlds,); and info, which
            always has the entries that `reset` returns, for the observations returned here.

        Raises:
            ActionError: Actions of the wrong shape or type, or out of range.
            NotResetError: Some worlds have not been reset, or have ended under DISABLED.
            FaultError: A world is in a state that the physics cannot handle; the others have been stepped.
            ValueError: `out` has other names, shapes or types.
        """
        return self._step(actions, out)

    def _step(
        self, actions: Actions, out: Mapping[str, Any] | None = None, some: Any = None
    ) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        buffers = None if out is None else StepBuffers(self, out)
        tracker = self._tracker
        self._actions.write(actions, tracker.actions)
        flags = tracker.step(some is None and (self.check_actions or self._recording), some)
        if flags & tracker.REFUSED:
            tracker.check_going(some)
            self._actions.write(actions, tracker.actions, ranges=True)  # raises an error that names the action
            raise ActionError("actions were out of range, and are not any more: another thread has written to them")
        if self._step_events.some:
            self._step_events.forget()
        terminated, truncated = self._terminated.copy(), self._truncated.copy()
        if self._stops is not None:
            self._stop(slice(None), terminated, truncated)
        if lifecycle.DEATHS.isEnabledFor(lifecycle.LEVEL):
            lifecycle.log_deaths(self.worlds, self.first_world)
        reward = self._reward.copy() if buffers is None else buffers.put("rewards", self._reward)
        ended: dict[str, Any] = {}
        try:
            if flags & tracker.FAULT:
                lifecycle.check_faults(self.worlds, self.first_world)
        finally:  # episodes of the other worlds may have ended
            if flags & tracker.DONE or (self._stops is not None and tracker.stopped.any()):
                ended = self._finish(tracker.done)
        info = self._info()
        if ended:
            info |= ended
        if buffers is None:
            return self._observe(), reward, terminated, truncated, info
        ends = buffers.put("terminated", terminated), buffers.put("truncated", truncated)
        observed = buffers.fill()
        return self._observe() if observed is None else observed, reward, *ends, info

    def send(self, actions: Actions) -> None:
        """Begin a step in the background; `recv` returns its results. Until then, any other call raises PendingError.

        Two environments with half of the worlds each (see first_world) keep the policy and the simulation busy at the
        same time. The actions are copied. With copy=False, the step overwrites the arrays that the previous call
        returned while it runs.
        """
        check_callable(self)
        with contextlib.suppress(ActionError):  # `recv` raises it
            actions = np.array(as_array(actions))
        self._guard.begin(self._step, actions)

    def recv(self) -> tuple[Arrays, Any, Any, Any, dict[str, Any]]:
        """Return, or raise, what `step` would have for the actions that were sent. Raise PendingError if none were."""
        return self._guard.fetch()

    @exclusive
    def render(self) -> tuple[Any, ...] | None:
        """Draw every world: a tuple of images, uint8 (height, width, 3) in RGB, or of texts, depending on render_mode.

        Without a render_mode it warns and returns None. NotResetError before reset(). `outlast.draw` draws one world.
        """
        if self.render_mode is not None:
            self._tracker.check_running("render")
        return render_worlds(self.worlds, self.render_mode)

    @exclusive
    def get_state(self, where: Any = slice(None)) -> State:
        """Return the state of the worlds `where` (mask, indices or slice) as plain arrays, in mid-episode or not.

        The state of a world that has not been reset is saved as just that: whichever world goes on from it has to be
        reset first.
        """
        return snapshot(self.scenario, self.worlds, self._tracker.masks, where)

    @exclusive
    def set_state(self, state: State, where: Any = slice(None)) -> Arrays:
        """Go on from `state`. Random numbers continue as they would have: copies of a world have the same future.

        Args:
            state: The state of as many worlds as `where` names, or of one world, for all of them.
            where: The worlds that go on from it: mask, indices or slice.

        Returns:
            The observations.

        Raises:
            StateError: The state is of another scenario, has the wrong number of worlds or is not valid; nothing was
                changed.
            RecordingError: A recording is in progress.
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

        A number that varies (see Scenario.vary) is set in the worlds of `mask` from their next reset on, and no longer
        drawn there; this is part of a world's state. Any other number changes in all worlds from the next step on, even
        in mid-episode; `scenario` does not show such a change, and a saved state does not include it.

        Args:
            given: Values by name, as for Scenario.replace: {"melee_damage": array}. For a number that varies, one value
                or an array with one for each world, (worlds, ...), used where `mask` is True; None: draw it again.
            mask: The worlds, bool (worlds,); None: all.
            **numbers: More numbers by keyword: rewards_kill=5.

        Raises:
            NumberError: A number is unknown or cannot change while worlds run, a value is not allowed, or a mask is
                given for a number that does not vary; nothing was changed.
            ValueError: The mask is not valid.
            RecordingError: A recording is in progress, and one of the numbers does not vary.
        """
        asked = [*(given or {}).items(), *numbers.items()]
        change_numbers(self.scenario, self.worlds, asked, mask, lambda: self._check_unrecorded("set_numbers"))

    @exclusive
    def set_levels(self, levels: Sequence[Level], mask: Any = None) -> None:
        """Play these levels in the next episodes, instead of any that are still waiting; then worlds draw again.

        Args:
            levels: One for each world of the mask, in order, or one for all of them. Afterwards their numbers are drawn
                again, even those that had been set before.
            mask: The worlds, bool (worlds,); None: all.

        Raises:
            NumberError: The wrong number of levels, a number that does not vary, or a value that could not be drawn.
            ValueError: The mask is not valid.
        """
        change_levels(self.worlds, levels, mask)

    @exclusive
    def place(self, kind: str, number: int = 0, /, *, where: Any = slice(None), **values: Any) -> int:
        """Put an entity into running worlds, alive and at rest, for tests and scripts; observations follow in a step.

        >>> row = env.place("box", x=2.0, y=0.5, angle=math.pi / 4)
        >>> env.place("agent", 1, where=0, x=-3, y=0, points=50)

        Columns that follow from others are written, too: cosine and sine, what the engine computes of sizes and
        densities at resets.

        Args:
            kind: The kind of entity: "agent", "box", or one of your own.
            number: Which one of its kind, from 0.
            where: The worlds: mask, indices or slice.
            **values: Values of its columns by name, one or one for each of these worlds; "Component.column" where
                several components have a column of that name and Body does not. Others stay as they are.

        Returns:
            Its row.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: The kind has no such column, or no such number, the entity is absent or in a bag, a value does
                not fit its column, or a column that has to fit this one is missing; nothing was changed.
            RecordingError: A recording is in progress.
        """
        self._check_unrecorded("place")
        self._tracker.check_running("place")
        return place(self.worlds, kind, number, where, values)

    def query(self, world: int = 0) -> Query:
        """Return an object that answers what is near, how far away, first on a ray or in sight in one world.

        >>> env.query().distance(env.worlds.span("agent").start, env.worlds.span("box").start)
        """
        return Query(self.worlds, world)

    def stop_when(self, stops: Stops) -> None:
        """End episodes earlier than the scenario does. For adapters such as those that end with the learner's death.

        Worlds that are stopped are reported and reset like those that end by the scenario's rule.

        Args:
            stops: Called after every tick. Returns which worlds terminate and which are truncated, bool (worlds,)
                each, and must depend on the state of the worlds alone.
        """
        self._stops = stops

    @exclusive
    def add_observer(self, make: Callable[[], Watcher]) -> Watcher:
        """Let what make() returns look on at every tick. Used by outlast.record. Raises RecordingError."""
        self._check_unrecorded("record")
        if self.worlds.changed:
            names = ", ".join(self.worlds.changed)
            raise RecordingError(f"{names} changed by set_numbers(): record an environment of the scenario with them")
        observer = make()
        self._tracker.observers.append(observer)
        return observer

    def close_extras(self, **kwargs: Any) -> None:
        """Release the threads and end a recording."""
        if hasattr(self, "worlds"):  # it is missing if the constructor refused its arguments
            self._guard.wait()
            self._tracker.close()

    @property
    def fields(self) -> Fields:
        """Return what the last axis of observations holds: `ecs.Field` by key and name, in order of columns.

        Keys that declare no fields, such as masks, are not in it. `columns` of a field is its slice of the row, and
        `ecs.columns_of` the index of several fields: observations["own"][..., columns_of(env.fields["own"], "x", "y")].
        """
        return {key: dict(named) for key, named in self.worlds.layout.fields.items()}

    @property
    def sides(self) -> tuple[str, ...]:
        """The names of the sides, in the order in which statistics have an entry for each side."""
        return side_names(self.worlds.layout)

    @property
    def roles(self) -> tuple[str, ...]:
        """The names of the roles; info["roles"] holds indices of it (-1: agent absent). Empty without roles."""
        return self.scenario.by_role.names if self.scenario.by_role else ()

    @property
    def flat_size(self) -> int:
        """Return how many numbers the observation of one agent has: the length of its row in a flat array."""
        return self._reader.flat_size

    @property
    def flat_names(self) -> list[str]:
        """The names of a flat array's columns: "own.health", "heals.3.x" (of the fourth heal), "heals_mask.3"."""
        return self._reader.names

    @property
    def action_columns(self) -> list[tuple[str, int]]:
        """Names of the actions, and the value that the integer 0 stands for."""
        return list(zip(self._actions.keys, (-self._actions.zeros).tolist(), strict=True))

    @property
    def action_sizes(self) -> Actions:
        """Return how many values each action has, integers (actions,)."""
        return self._actions.sizes

    @property
    def noop(self) -> Actions:
        """The action that does nothing, integers (actions,); "joint": a single one; "continuous": floats (actions,)."""
        return self._actions.noop

    @property
    def action_mask_size(self) -> int:
        """The length of an agent's action mask: 15 in the paper; with actions="joint" 216, with "continuous" 0."""
        return self._actions.mask_size

    @property
    def state_space(self) -> Any:
        """The space of one world's row of `state`: Box, float32 (size,)."""
        return self._global_state.space

    @property
    def state_names(self) -> list[str]:
        """The names of the columns of `state`: "agent_0.health", "box_3.x" ..."""
        return self._global_state.names

    @exclusive
    def observe(self, out: Any = None) -> Arrays:
        """Return the observations as they are now.

        Args:
            out: Memory to write them to as well: float32 arrays (worlds, agents, ...) by key, or one float32 array
                (worlds, agents, flat_size) that joins all keys; numpy arrays, or tensors that can share memory with
                numpy.

        Returns:
            As from `step`: copies, or views if copy=False.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has other keys, shapes or types; nothing was written.
        """
        self._tracker.check_running("observe")
        if out is not None:
            self._reader.write(self._reader.check(out))
        return self._observe()

    @exclusive
    def state(self, out: Any = None) -> Actions:
        """Return each world as one vector, for centralised critics. It includes what no agent sees.

        `state_names` has the names of its columns, which observations.GlobalState describes.

        Args:
            out: Memory to write it to: float32 (worlds, size), a numpy array or a tensor that can share memory with it.

        Returns:
            float32 (worlds, size), scaled if observations are: a new array, or `out` as a numpy array.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has another shape or type.
        """
        self._tracker.check_running("state")
        return _written(self._global_state(slice(None)), out)

    @exclusive
    def action_masks(self, out: Any = None) -> Actions:
        """Return which actions can change anything in the next step, or are `noop`.

        An action that is False would leave exactly the same world behind as `noop`, to the bit: attacks while the
        weapon is cooling down, use with an empty bag, all actions of the dead. One that is True may still do nothing.

        Args:
            out: Memory to write it to, bool of the shape below; otherwise as for `state`.

        Returns:
            bool (worlds, agents, action_mask_size): the values of the first action, then those of the second, and so
            on; with actions="joint" all joint actions. A new array, or `out` as a numpy array.

        Raises:
            NotResetError: Some worlds have not been reset.
            ValueError: `out` has another shape or type, or actions are continuous.
        """
        self._tracker.check_running("action_masks")
        return _written(self._actions.masks(), out)

    @exclusive
    def events(self) -> dict[str, Array]:
        """Return what happened in the last step, or reset, of each world: who hit, killed, used, gave or broke what.

        Returns:
            By name of the event ("hit", "death", "item_used" ...), a structured array with a row for each event, in
            order of worlds: `world`, its index; `episode` and `tick`, int64; and the columns of the event (see
            docs/events.md), in which entities are rows of the world. The arrays are copies. A world that SAME_STEP has
            reset shows the events of the step that ended its episode.
        """
        return self._step_events.read()

    @exclusive
    def numbers(self) -> dict[str, Any]:
        """Return all numbers of the game by name, as they are now.

        Numbers that vary (see Scenario.vary) are arrays (worlds, ...), with the value in each world's current episode;
        those that differ by role are arrays (worlds, agents). If there are any such numbers, NotResetError before
        reset().
        """
        return current_numbers(self.worlds)

    @exclusive
    def levels(self, mask: Any = None) -> list[Level]:
        """Return what the worlds' current episodes were made from; see outlast.levels. mask: bool (worlds,)."""
        return current_levels(self.worlds, mask)

    @cached_property
    def _presence(self) -> Presence:
        return Presence(self.worlds)

    @cached_property
    def _global_state(self) -> GlobalState:
        return GlobalState(self.worlds, self._reader.scaled)

    def _observe(self) -> Arrays:
        return self._reader.read(self.copy)

    def _check_running(self, call: str) -> None:
        """Raise ClosedError, PendingError or NotResetError unless `call` can look at all worlds; for adapters."""
        check_callable(self)
        self._tracker.check_running(call)

    def _info(self) -> dict[str, Any]:
        """Return the entries of info about the observations that are returned."""
        info: dict[str, Any] = {**self._presence()}
        if self._masked:
            info["action_mask"] = self._actions.masks().view(np.int8)  # the type that Gymnasium's Space.sample takes
        if self._varied:
            info["numbers"] = self.worlds.numbers()
        if AgentRoles in self.worlds:
            info["roles"] = np.where(info.get("present", True), self.worlds[AgentRoles].role, np.int32(-1))
        return info

    def _ended(self, done: Actions) -> dict[str, Any]:
        """Return the entries of info about the episodes that just ended, in the worlds `done`."""
        info: dict[str, Any] = {"statistics": statistics(self.worlds, done), "_statistics": done}
        if there := counted(self.worlds):
            info["statistics_present"] = there
        return info

    def _finish(self, done: Actions) -> dict[str, Any]:
        """Report the episodes that just ended; under SAME_STEP also start the next ones."""
        info = self._ended(done)
        if self.autoreset_mode is AutoresetMode.SAME_STEP:
            info |= {"final_info": info | self._info(), "_final_info": done.copy()}
            info |= {"final_obs": self._reader.of_each(done), "_final_obs": done.copy()}
            self._step_events.keep(done)
            self._tracker.reset(done)
        return info

    def _stop(self, where: Any, *reported: Actions) -> None:
        """Ask `stop_when` about the worlds `where`, and add its answers to `reported`: terminated and truncated."""
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
        return any(observer.recording for observer in self._tracker.observers)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.scenario.name!r}, num_worlds={self.num_worlds})"

    def __reduce__(self) -> Any:
        raise TypeError(
            "an environment cannot be pickled or copied; pickle what makes it, as "
            "functools.partial(outlast.make_vec, 'ffa_3', 64, seed=0), and what get_state() returns"
        )


def world_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of SurvivalVectorEnv by name, out of the local variables of a factory."""
    named = inspect.signature(SurvivalVectorEnv).parameters.values()
    return {each.name: given[each.name] for each in named if each.kind is each.KEYWORD_ONLY and each.name in given}


def _written(values: Array, out: Any) -> Array:
    """Return the values, or the caller's memory `out` with them in it. Raises ValueError as `writable` does."""
    if out is None:
        return values
    array = writable("out", out, values.shape, values.dtype)
    array[...] = values
    return array


class StepBuffers:
    """The memory that SurvivalVectorEnv.step was given as `out`."""

    def __init__(self, env: SurvivalVectorEnv, out: Any) -> None:
        """Check it, without writing anything yet. Raises ValueError."""
        self._env, self._given = env, {} if out is None else out
        if not isinstance(self._given, Mapping) or (unknown := sorted(map(repr, self._given.keys() - set(OUT)))):
            found = f"the name {unknown[0]}" if isinstance(out, Mapping) else f"type {type(out).__name__}"
            raise ValueError(f"out has {found}: a mapping is needed, with names among {', '.join(OUT)}")
        self._arrays = {name: self._checked(name, array) for name, array in self._given.items()}
        if len({id(array) for array in self._given.values()}) < len(self._given):
            raise ValueError("out has one array for two names: each needs memory of its own")

    def put(self, name: str, values: Array) -> Any:
        """Write the values into the caller's memory of that name and return it; without any, return a copy of them."""
        if name not in self._given:
            return values.copy()
        self._arrays[name][...] = values
        return self._given[name]

    def fill(self) -> Any:
        """Write what is known when the step is over. Returns the caller's observations, or None if none were given."""
        if "state" in self._arrays:
            self._arrays["state"][...] = self._env._global_state(slice(None))
        if "action_mask" in self._arrays:
            self._arrays["action_mask"][...] = self._env._actions.masks()
        if "observations" not in self._arrays:
            return None
        self._env._reader.write(self._arrays["observations"])
        return self._given["observations"]

    def _checked(self, name: str, array: Any) -> Any:
        env, what = self._env, f"out[{name!r}]"
        worlds, rows = (env.num_worlds,), (env.num_worlds, env.worlds.dims["agents"])
        if name == "observations":
            return env._reader.check(array, what)
        if name == "state":
            return writable(what, array, worlds + env.state_space.shape)
        if name == "action_mask":
            env._actions.check_masked()
            return writable(what, array, (*rows, env.action_mask_size), bool)
        return writable(what, array, rows) if name == "rewards" else writable(what, array, worlds, bool)
