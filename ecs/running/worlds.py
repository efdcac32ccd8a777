"""A batch of worlds of one scenario: their tables, and the tick that advances them on several threads."""

import threading
import time
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from ..declarations import event
from ..declarations.component import Clock
from ..declarations.distributions import Distribution
from ..declarations.event import Event
from ..declarations.module import Module, check_kind
from ..declarations.phase import PhaseBase
from ..declarations.roles import Roles
from ..kernels.errors import CapacityError, NumberError
from ..memory.can_differ import changed_modules, differing
from ..memory.entity_view import EntityView
from ..memory.given import given_words
from ..memory.numbers import AWAY, KEY, NO_LEVELS, ONCE, Given, Varied
from ..memory.tables import Tables
from .compiled_game import Wanted, plan
from .execution import CompiledExecution, PythonExecution
from .team import Team, shared


class Worlds(Tables):
    """`count` worlds made of `modules`, stored as tables and advanced together.

    worlds[C] is the table of component C: columns of shape (count, capacity, ...) or, per world, (count, ...).
    The arrays are the state itself, and always remain the same objects.

    Args:
        modules: The mechanics, in any order.
        count: Number of worlds.
        threads: Number of threads that `run` uses; results do not depend on it.
        without: Phases to leave out, such as that of observations.
        ordered: Chains of labels of systems or names of mechanics, each of which runs before the next one in its chain.
        interpret: Labels of systems to run as Python, such as for breakpoints; the others remain machine code.
        specialize: Compile the systems for the sizes and rows of these modules only. This makes the tick faster, but
            other modules or other sizes then need machine code of their own. The results are the same.
        varied: Distributions by name, "module_number": each world draws the number when an episode begins.
        observed: Names of the varied numbers that agents observe.
        roles: Roles of agents with numbers of their own.

    Attributes:
        modules: The mechanics with their present numbers; layout.modules has the initial ones.
        schedule: The systems, in order.
        segments: The tick: units, run by one call for each segment.
        units: The machine code of these.
        times: The seconds that `run` has spent in each segment, by its first unit.
        threads: As given.

    Raises:
        DeclarationError: A module is invalid, or several modules do not fit each other.
        ScheduleError: The order of the systems is ambiguous or contradictory, or `interpret` names an unknown system.
    """

    def __init__(
        self,
        modules: Sequence[Module],
        count: int,
        threads: int = 1,
        without: Collection[PhaseBase] = (),
        ordered: Sequence[Sequence[str]] = (),
        interpret: Collection[str] = (),
        specialize: bool = False,
        varied: Mapping[str, Distribution] | None = None,
        observed: Sequence[str] = (),
        roles: Roles | None = None,
    ) -> None:
        wanted = Wanted(
            modules=tuple(modules),
            varied=tuple((varied or {}).items()),
            observed=tuple(observed),
            roles=roles,
            without=frozenset(without),
            ordered=tuple(map(tuple, ordered)),
            interpret=(interpret,) if isinstance(interpret, str) else tuple(map(str, interpret)),
            specialize=specialize,
        )
        for what, given in (("count", count), ("threads", threads)):
            if given < 1:
                raise NumberError(f"Worlds(..., {what}={given}): at least 1 is needed")
        game = plan(wanted)
        super().__init__(game.layout, count)
        self.schedule, self.segments, self.units, self.threads = game.schedule, game.segments, game.units, threads
        self.modules = list(self.layout.modules)
        self.times = defaultdict[str, float](float)
        self._lock = threading.Lock()  # held while executions are made or changed
        self._executions = list[CompiledExecution | PythonExecution]()
        self._team = Team(threads) if shared(count, threads) else None

    def __repr__(self) -> str:
        return f"Worlds({self.count} worlds, {len(self.components)} components)"

    @property
    def compiled(self) -> bool:
        """Return whether machine code for this tick is ready or cached on disk."""
        return not self.uncompiled

    @property
    def uncompiled(self) -> list[str]:
        """Labels of the systems, and of other parts of the tick, that the next `run` compiles."""
        return self.units.missing + (self._team.code.missing if self._team is not None else [])

    def events(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return the events of the last tick of each world, by name of the event; see `entries`."""
        return {kind.name: self.entries(kind) for kind in self.layout.events}

    def entries(self, kind: type[Event]) -> np.ndarray[Any, Any]:
        """Return a copy of the events of one kind in the last tick of each world; empty if the event is missing.

        A structured array has a row for each, in order of worlds: `world`, `episode` and `tick`, int64, and the event's
        columns.
        """
        clock = self[Clock]
        times = (np.arange(self.count), clock.episode[:, 0], clock.tick[:, 0])
        return event.entries(kind, self.layout.events, self.event_memory, times)

    def number(self, name: str) -> Any:
        """Return the value of the number "module_number" in this episode, also if it varies or differs by role.

        Returns:
            A single value; if worlds differ in it, an array (count,), or (count, length) for a tuple (see `numbers`);
            if agents do, int32 or float32 (count, agents). Arrays are copies.

        Raises:
            NumberError: The number does not exist.
        """
        if (agents := self.layout.per_agent.get(name)) is not None:
            return self.agent_values(agents)
        if (varied := self.layout.varied.get(name)) is not None:
            return varied.decode(self[Varied].words.T.copy(), self.layout.modules[varied.module])
        for module in self.modules:
            own = name.removeprefix(f"{module.name}_")
            if own != name and any(item.name == own for item in fields(module)):
                return getattr(module, own)
        raise NumberError(f"this scenario has no number '{name}'")

    def span(self, archetype: str) -> slice:
        """Return the rows of an archetype, the same in every world; an empty slice if this scenario lacks it.

        DeclarationError if none of the imported mechanics has it.
        """
        if (rows := self.layout.spans.get(archetype)) is None:
            check_kind(archetype, self.layout.spans)
            return slice(0, 0)
        return slice(rows.start, rows.stop)

    def entity(self, row: int, world: int = 0) -> EntityView:
        """Return one entity with all its components, to print or inspect. DeclarationError if it does not exist."""
        return EntityView(self, row, world)

    def seed(self, seeds: Any, worlds: Any, where: Any = slice(None)) -> None:
        """Set the keys of the worlds `where` to (seeds, worlds), and restart the counts of their episodes."""
        clock = self[Clock]
        clock.seed[where] = np.asarray(seeds, np.uint64).reshape(-1, 1)
        clock.world[where] = np.asarray(worlds, np.uint64).reshape(-1, 1)
        clock.episode[where] = 0
        if self.layout.keyed:
            self[Given].words[where, AWAY] = 0

    def set_numbers(self, /, **numbers: Any) -> None:
        """Change numbers of mechanics by name, module_number ("rewards_kill"), from the next tick on, in all worlds.

        Raises:
            NumberError: A number is unknown, a value is not allowed, or the number affects more than computations of
                kernels (sizes of tables, initial values of entities, the choice of systems, or bounds of observations);
                nothing is changed.
        """
        with self._lock:
            self.modules = changed_modules(self.layout, self.schedule.systems, self.modules, numbers)
            for block in (block for execution in self._executions for block in execution.blocks):
                block.set_numbers(self.changed)

    def numbers(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return the varied numbers of each world in this episode, by name: int32, float32, bool or str (count,).

        A tuple is float32 (count, length).
        """
        if not self.layout.varied:
            return {}
        words = self[Varied].words.T.copy()
        return {name: n.decode(words, self.layout.modules[n.module]) for name, n in self.layout.varied.items()}

    def agent_numbers(self) -> dict[str, np.ndarray[Any, Any]]:
        """Return each agent's numbers that differ by role in this episode: int32 or float32 (count, agents) by name."""
        return {name: self.agent_values(number) for name, number in self.layout.per_agent.items()}

    def give_numbers(self, numbers: Mapping[str, Any], where: Any = slice(None), once: bool = False) -> None:
        """Set varied numbers from the next reset of each world on; they are then not drawn.

        Args:
            numbers: By name, one value, or one for each of the worlds `where`; None: draw it again.
            where: The worlds: mask, indices or slice.
            once: Whether to set them for that episode only.

        Raises:
            NumberError: A number does not vary, or a value has the wrong shape or could not be drawn; nothing is
                changed.
        """
        rows = np.atleast_1d(np.arange(self.count)[where])
        words = dict[str, Any]()
        for name, values in numbers.items():
            if name not in self.layout.varied:
                known = ", ".join(self.layout.varied) or "none"
                raise NumberError(f"{name} does not vary between worlds here; these do: {known}")
            number = self.layout.varied[name]
            words[name] = np.uint64(0) if values is None else given_words(number, self.layout, values, len(rows))
            if once and values is not None:
                words[name] = words[name] | np.uint64(1) << ONCE
        for name, given in words.items():
            self[Given].words[rows, self.layout.varied[name].words] = given

    def give_keys(self, keys: Any, where: Any = slice(None)) -> None:
        """Set the key of the next episode; later episodes have the worlds' own keys again.

        keys: (seed, world, episode) for each of the worlds `where` (mask, indices or slice), uint64 (n, 3). NumberError
        unless layout.keyed.
        """
        if not self.layout.keyed:
            raise NumberError(NO_LEVELS)
        rows = np.atleast_1d(np.arange(self.count)[where])
        self[Given].words[rows, KEY] = np.insert(np.asarray(keys, np.uint64), 0, 1, axis=1)

    @property
    def changed(self) -> dict[str, int | float]:
        """The numbers that have changed since the worlds were made, by name, in the form for kernels."""
        return differing(self.layout.modules, self.modules)

    def run(self, mode: np.ndarray[Any, Any]) -> None:
        """Run the tick of every world. mode: int8 (count,), SKIP, STEP or RESET for each world.

        Raises CapacityError if a tick has more events of a kind than its capacity; the tick is then cut short.
        """
        self.mode[:] = mode
        try:
            for segment, execution in zip(self.segments, self.load(), strict=True):
                start = time.perf_counter()
                execution()
                self.times[segment.units[0].label] += time.perf_counter() - start
        except CapacityError as error:
            raise self.overflow(error) from None

    def load(self) -> list[CompiledExecution | PythonExecution]:
        """Load or compile the machine code of the tick; return the executions of its segments on these worlds."""
        if not self._executions:
            self.units.load()
            if self._team is not None:
                self._team.code.load()
            with self._lock:  # one thread at a time: modules' scratch() need not be thread-safe
                self._executions = self._executions or [
                    CompiledExecution(each, self, self.units, self._team, self.schedule.touched)
                    if each.compiled
                    else PythonExecution(each, self)
                    for each in self.segments
                ]
        return self._executions

    def source(self) -> str:
        """Return the generated code of the tick: a function for each system, in order, with the phases as comments."""
        slots = "# Slots, in upper case, are positions in the argument block of a unit; see ecs.compilation.arguments."
        lines, phase = [slots], None
        for unit in (unit for segment in self.segments for unit in segment.units):
            if unit.system and unit.system.phase is not phase:
                phase = unit.system.phase
                lines.append(f"# ---- {phase.name} ({phase.when.value}): {phase.postcondition}")
            lines.append(unit.source)
        return "\n\n".join(lines)

    def close(self) -> None:
        """End the threads. The tables remain readable."""
        if self._team is not None:
            self._team.close()

    def overflow(self, error: BaseException) -> BaseException:
        """Return the error that names the full list of events, if `error` is about one; otherwise `error`."""
        if not isinstance(error, CapacityError):
            return error
        ticks = self[Clock].tick[:, 0]
        found = event.capacity_error(self.layout.events, self.event_memory, self.schedule.systems, ticks)
        return found or error


def checked_worlds(given: Any) -> Worlds:
    """Return the argument, which must be Worlds. Raises TypeError."""
    if not isinstance(given, Worlds):
        raise TypeError(f"{type(given).__name__} is given for worlds: those of an environment are env.worlds")
    return given
