"""Plans: the shared parts of all batches of worlds of one game. Plans do not change, so they are kept and reused."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..checks.code_hash import code_digest
from ..checks.traced import PYTHON_ONLY, Traced
from ..checks.trial import python_refusal, try_out
from ..compilation.cache import CompiledUnits
from ..compilation.compiled_step import RUN, WHOLE_STEP, run_units, step
from ..compilation.schedule import Schedule, check_brought, order
from ..compilation.tick import Segment, segments
from ..declarations.access import SELECTIONS
from ..declarations.distributions import Distribution
from ..declarations.module import Module
from ..declarations.phase import PhaseBase
from ..declarations.roles import Roles
from ..declarations.system import System
from ..kernels.errors import DeclarationError, ScheduleError, did_you_mean
from ..kernels.frozen_values import is_outside
from ..kernels.jit import compiled
from ..memory.can_differ import check_numbers
from ..memory.layout import MemoryLayout

KEPT = 16  # maximum number of kept plans: the most recently used


@dataclass(frozen=True)
class Wanted:
    """The key of a plan: the arguments of Worlds, except `count` and `threads`."""

    modules: tuple[Module, ...]
    varied: tuple[tuple[str, Distribution], ...]
    observed: tuple[str, ...]
    roles: Roles | None
    without: frozenset[PhaseBase]
    ordered: tuple[tuple[str, ...], ...]
    interpret: tuple[str, ...]
    specialize: bool


@dataclass(frozen=True, eq=False)
class CompiledGame:
    """All that a batch of worlds needs except memory."""

    layout: MemoryLayout
    schedule: Schedule
    segments: Sequence[Segment]  # of the tick
    units: CompiledUnits  # including the functions and parts for steps


def plan(wanted: Wanted) -> CompiledGame:
    """Return the plan for `wanted`, perhaps an earlier one. For errors, see Worlds.

    Games with a user's mechanics get a new plan each time, since their references may have changed. The code of
    outlast itself is assumed not to change while a process runs.
    """
    systems = tuple(system for module in wanted.modules for system in module.systems())
    if any(is_outside(type(module)) for module in wanted.modules):
        return _made(wanted)
    try:
        hash(wanted)
    except TypeError:  # a number of a kind that is not hashable
        return _made(wanted)
    return _kept(wanted, repr(wanted), systems, compiled())


@functools.lru_cache(maxsize=KEPT)
def _kept(wanted: Wanted, text: str, systems: tuple[System, ...], as_machine_code: bool) -> CompiledGame:
    """Return the plan.

    text: distinguishes games whose numbers are equal but not the same, such as 1 and 1.0, or 0.0 and -0.0.
    """
    return _made(wanted)


def _made(wanted: Wanted) -> CompiledGame:
    layout = MemoryLayout(wanted.modules, dict(wanted.varied), wanted.observed, wanted.roles)
    check_numbers(layout)
    check_brought(layout.systems, layout.components)
    systems = [s for s in layout.systems if _applies(s, layout) and s.phase not in wanted.without]
    schedule = order(systems, layout.components, wanted.ordered)
    known = [system.label for system in schedule.systems]
    for label in (each for each in wanted.interpret if each not in known):
        hint = did_you_mean(label, known, after=" ")
        raise ScheduleError(f"interpret: unknown system '{label}'; {hint}known: {', '.join(known)}")
    if any(system.outside for system in schedule.systems):
        outside = [code_digest(module) for module in layout.modules if is_outside(type(module))]
        options = wanted.varied, wanted.roles, wanted.without, wanted.ordered
        try_out(layout, schedule.systems, (repr((wanted.modules, options)), *outside, compiled()))
    run = list[System]()
    for system in schedule.systems:
        interpreted = system.label in wanted.interpret
        if interpreted and (why := python_refusal(system)):
            raise DeclarationError(f"{system.label} cannot run as Python: {why}")
        if system.outside and (interpreted or not system.compiled):  # users' systems run on stand-ins
            system = replace(system, kernel=Traced(system, layout, PYTHON_ONLY if system.compiled else None))
        run.append(system)
    tick = segments(layout, run, wanted.interpret, wanted.specialize)
    units = [unit for segment in tick for unit in segment.units if unit.compiled]
    code = CompiledUnits(units, {WHOLE_STEP: step}, {RUN: run_units})
    return CompiledGame(layout, schedule, tick, code)


def _applies(system: System, layout: MemoryLayout) -> bool:
    """Return whether a system is scheduled: its components exist, and none of its lists of rows is empty."""
    rows = (layout.rows(*p.components) for p in system.parameters if p.kind in SELECTIONS.values())
    return {*system.needs} <= {*layout.components} and all(map(len, rows))
