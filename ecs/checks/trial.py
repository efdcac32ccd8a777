"""A trial of a game's mechanics: a few ticks of one world as Python, in which users' systems run on stand-ins.

A slip gets an error that names system, line, component and column, before anything is compiled. Branches that do not
run are read in the source. Slips that neither notices are left to the compiler, and to the checks of indices and ranges
in machine code.
"""

import contextlib
import dataclasses
import logging
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from opcode import opmap
from types import CodeType, TracebackType
from typing import Any

import numba
import numpy as np
from numba.core.extending import _Intrinsic

from ..compilation.tick import in_python, segments
from ..declarations.component import Clock
from ..declarations.event import COUNT, Event, capacity_error
from ..declarations.phase import When
from ..declarations.system import System
from ..kernels.errors import CapacityError, DeclarationError, EngineError
from ..kernels.frozen_values import reachable, references
from ..kernels.jit import External, Intrinsic, interpreted
from ..memory.episode import RESET, STEP
from ..memory.layout import MemoryLayout
from ..memory.tables import Tables
from .source_check import check_paths, check_source
from .traced import PYTHON_ONLY, Columns, Traced

MODES = (RESET, STEP, STEP)
MOST_ROWS = 64  # where worlds have more, steps of outlast's own systems would take too long as Python
MOST_LINES = 100_000  # lines of Python run by users' systems
TRIED: dict[Any, None] = {}  # the games that were tried
KEPT = 256  # the most games that are remembered
NOTE = "Raised by {} in a trial: the first ticks of a world, as Python and with random actions."
LOGGER = logging.getLogger("outlast")


class _TooLong(BaseException):
    """More than MOST_LINES have run."""


def try_out(layout: MemoryLayout, systems: Sequence[System], key: Any) -> None:
    """Check users' systems in a game, with its systems in order, unless one with an equal key was tried before.

    Raises:
        EngineError: A system does something undeclared, or something that must be a slip.
        IndexError: A system uses an index out of range.
        Exception: Any exception of a system, with a note.
    """
    if key in TRIED:
        return
    found = {system.label: check_source(system) for system in systems if system.outside}
    for system in (each for each in systems if each.outside and each.compiled):
        check_paths(system)
    chosen = [system for system in systems if _runs(layout, system)]
    traced = {s.label: Traced(s, layout, {**PYTHON_ONLY, "print": _silent}) for s in chosen if s.outside}
    _play(layout, [dataclasses.replace(s, kernel=traced.get(s.label, s.kernel)) for s in chosen], traced)
    for label, each in traced.items():
        found[label][0].update(each.used)
        found[label][1].update(each.written)
    resets = [system.label for system in systems if system.phase.when is When.RESET]
    for system in systems:
        if system.outside:
            _check_events(system, found[system.label][0])
            behind = resets[resets.index(system.label) + 1 :] if system.label in resets else ()
            _check_coupled(system, found[system.label][1], behind)
    TRIED[key] = None
    while len(TRIED) > KEPT:
        del TRIED[next(iter(TRIED))]


def python_refusal(system: System) -> str:
    """Return the reason why a system cannot run as Python in a compiled process; "" if it can."""
    kernel: Any = system.kernel
    for function in reachable(getattr(kernel, "py_func", kernel), lambda inner: True):
        for name, value in references(function):
            if isinstance(value, External):
                return value.refusal
            if isinstance(value, (numba.types.ExternalFunction, _Intrinsic)) and not isinstance(value, Intrinsic):
                return f"only machine code can call {name}"
    return ""


def _runs(layout: MemoryLayout, system: System) -> bool:
    """Return whether a system is part of trials. Users' Python may change more than the world, such as files."""
    few = system.outside or layout.dims["rows"] <= MOST_ROWS or system.phase.when is When.RESET
    return few and system.compiled and not python_refusal(system)


def _play(layout: MemoryLayout, systems: Sequence[System], traced: Mapping[str, Traced]) -> None:
    """Take a world through a few ticks, with random actions. An error of outlast's own systems only ends the trial."""
    tables, generator = Tables(layout, 1), np.random.default_rng(0)
    tables[Clock].seed[:] = 1
    units = [unit for segment in segments(layout, systems, python=True) for unit in segment.units]
    calls = [*in_python(units, tables)]
    left = [MOST_LINES]
    for mode in MODES:
        tables.mode[:] = mode
        for actions, (component, name) in zip(tables.actions, layout.actions, strict=True):
            column = component.columns[name]
            actions[:] = generator.integers(int(column.low), int(column.high) + 1, actions.shape)
        for unit, _, call in calls:
            try:
                with interpreted(), _limited(traced[unit.label].codes if unit.label in traced else (), left):
                    call()
            except _TooLong as error:
                LOGGER.warning("%s: the trial of %s ended after %d lines of Python", error, unit.label, MOST_LINES)
                return
            except Exception as error:
                if isinstance(error, CapacityError):
                    ticks = tables[Clock].tick[:, 0]
                    error = capacity_error(layout.events, tables.event_memory, systems, ticks) or error
                elif isinstance(error, EngineError) and not unit.system:
                    error = type(error)(f"{unit.label}: {error}{unit.needed}")
                elif not isinstance(error, EngineError):
                    owned = unit.label in traced and (isinstance(error, IndexError) or _is_raised(error.__traceback__))
                    if not owned:
                        return  # of outlast's own, or about numbers and types, where machine code has different rules
                error.add_note(NOTE.format(unit.label))
                raise error from error.__cause__


def _is_raised(trace: TracebackType | None) -> bool:
    """Return whether an exception comes from a statement `raise` or `assert`, and not from Python or numpy."""
    while trace and trace.tb_next:
        trace = trace.tb_next
    return trace is not None and trace.tb_frame.f_code.co_code[trace.tb_lasti] == opmap["RAISE_VARARGS"]


def _limited(codes: Collection[CodeType], left: list[int]) -> Any:
    """Return a context that raises _TooLong once these have run more lines than are left.

    Without effect for an empty set, or under a debugger or a measurement of coverage.
    """

    def trace(frame: Any, event: str, value: Any) -> Any:
        if frame.f_code not in codes:
            return None
        left[0] -= 1
        if left[0] < 0:
            raise _TooLong(f"{frame.f_code.co_filename}, line {frame.f_lineno}")
        return trace

    context = contextlib.ExitStack()
    if codes and sys.gettrace() is None:
        context.callback(sys.settrace, None)
        sys.settrace(trace)
    return context


def _silent(*values: Any, **options: Any) -> None:
    """Print nothing: the system prints when it runs in earnest."""


def _check_events(system: System, used: Columns) -> None:
    """Refuse columns of events that are used without looking at the count of events."""
    for parameter in system.parameters:
        for event in parameter.components if parameter.kind in ("read", "write") else ():
            columns = {name for component, name in used if component is event}
            if issubclass(event, Event) and columns and COUNT not in columns:
                raise DeclarationError(
                    f"{system.label} uses {event.__name__}.{min(columns)}, but neither emits the event nor looks at "
                    f"its count: take k = emit({parameter.name}) for a new one, or a loop over "
                    f"range({parameter.name}.count[0]), and {parameter.name}.{min(columns)}[k]"
                )


def _check_coupled(system: System, written: Columns, behind: Iterable[str]) -> None:
    """Refuse columns that are written without those that must fit them. behind: later systems of the reset."""
    for component, name in sorted(written, key=lambda column: (column[0].__qualname__, column[1])):
        for coupled in component.coupled:
            lacking = [each for each in coupled.needs if (component, each) not in written]
            if name in coupled.columns and lacking and coupled.computed_by not in behind:
                later = system.phase.when is When.RESET and coupled.computed_by
                raise DeclarationError(
                    f"{system.label} writes {component.__name__}.{name}, but not {' and '.join(lacking)}, which must "
                    f"fit it: {coupled.cure}{f'; or run before {later}, which computes that' if later else ''}"
                )
