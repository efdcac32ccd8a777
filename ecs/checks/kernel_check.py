"""A static check of a system against its parameter list. It takes milliseconds, before anything is compiled.

It reports a misspelt column, a write to a component that is declared Read, and anything but a sum on one that is
declared Add, with the line, also if that is in a kernel that the system calls; abstract_interpreter finds these. It
also reports a variable that may have no value where it is used (assignment_check), a random number that is drawn twice
(random_check), and a loop that nothing leaves.
"""

from collections.abc import Collection, Mapping
from types import FunctionType
from typing import Any

from numba.core.analysis import compute_cfg_from_blocks
from numba.core.compiler import run_frontend

from ..compilation.cache_key import FOREIGN
from ..compilation.compile_errors import AS_PYTHON, first_sentence, places
from ..declarations.access import SELECTIONS, Parameter
from ..declarations.component import Component
from ..declarations.event import COUNT, Event
from ..declarations.phase import When
from ..declarations.system import System
from ..kernels.errors import DeclarationError, ScheduleError, place
from ..kernels.frozen_values import is_outside, reachable, references
from ..kernels.jit import External, compiled
from ..memory.layout import MemoryLayout
from .abstract_interpreter import Activation
from .abstract_values import (
    ANYTHING,
    FLOATING,
    UNKNOWN,
    Interval,
    PerAgent,
    Place,
    Shared,
    Table,
    Values,
    added,
    component_name,
)
from .assignment_check import first_unassigned
from .random_check import repeated_draw


def check(
    system: System,
    per_agent: Collection[str] = (),
    widths: Mapping[str, int] | None = None,
    layout: MemoryLayout | None = None,
    behind: Collection[str] = (),
) -> None:
    """Compare what a system does with what its parameter list declares.

    Args:
        system: Any system. In one that stays Python, only code that numba's front end understands is checked.
        per_agent: Names of its mechanic's numbers in which roles differ.
        widths: By name of the Offset of each field that its mechanic adds, how many columns from there on are its own.
        layout: The layout of the worlds, by which indices of entities are checked; None: they are not.
        behind: Labels of the systems that run after it in the reset that it is part of.

    Raises:
        DeclarationError: It uses a column or a name that does not exist or a variable that may have no value, calls a
            kernel with the wrong arguments, or cannot be compiled because of its syntax.
        ScheduleError: It writes what it declares as Read, or does more than add integers to what it declares as Add.
    """
    function: Any = getattr(system.function, "py_func", system.function)
    arguments = {
        parameter.name: frozenset([_value(parameter, per_agent, widths or {})]) for parameter in system.parameters
    }
    checked = _Check(system, layout)
    checked.call(function, arguments, ())
    checked.check_code(function)
    checked.check_events()
    if system.outside:
        checked.check_coupled(behind)


def check_interpretable(system: System) -> None:
    """Raise DeclarationError if a system cannot run as Python in a compiled process, because it calls a C library."""
    kernel: Any = system.kernel
    for function in reachable(getattr(kernel, "py_func", kernel), lambda inner: True):
        for _, value in references(function):
            if isinstance(value, External):
                raise DeclarationError(f"{system.label} cannot run as Python: {value.refusal}")


def _value(parameter: Parameter, per_agent: Collection[str], widths: Mapping[str, int]) -> Any:
    if parameter.kind == "offset" and parameter.name in widths:
        return Place(parameter.name, widths[parameter.name])
    if parameter.kind == "number" and parameter.name in per_agent:
        return PerAgent(parameter.name)
    if parameter.kind in ("read", "write", "add"):
        return Table(parameter.components[0], parameter.kind)
    if parameter.kind == "numbers" or parameter.kind in SELECTIONS.values():
        return Shared(parameter.name, parameter.kind, parameter.components)
    return FLOATING if parameter.type is float else UNKNOWN


def _passed(values: Values) -> Values:
    """What a function gets: no Interval, as a recursive one would change it with every call, and never end."""
    return ANYTHING if any(isinstance(each, Interval) for each in values) else values


def _endless(code: Any) -> int | None:
    """The line of a loop that nothing leaves, in numba's intermediate representation of a function."""
    loops = compute_cfg_from_blocks(code.blocks).loops().values()
    return next((code.blocks[loop.header].loc.line for loop in loops if not loop.exits), None)


def _is_own(function: FunctionType) -> bool:
    """Whether a function is part of a user's mechanic."""
    return is_outside(function) and function.__module__.partition(".")[0] not in FOREIGN


class _Check:
    """The check of one system, which follows the functions it calls, each with the values of its arguments."""

    def __init__(self, system: System, layout: MemoryLayout | None) -> None:
        self.system, self.label, self.offsets, self.layout = system, system.label, system.offsets(), layout
        self.code: dict[FunctionType, Any] = {}  # numba's intermediate representation of each, or None: see _code
        self.results: dict[Any, Values] = {}
        self.used, self.written = set[tuple[type[Component], str]](), set[tuple[type[Component], str]]()

    def call(
        self, function: FunctionType, arguments: dict[str, Values], trail: tuple[str, ...], report: bool = True
    ) -> Values:
        """The values that `function` returns. trail: the calls that lead to it. report: whether errors are raised."""
        arguments = {name: _passed(values) for name, values in arguments.items()}
        key = (function, tuple(arguments.items()), report)
        if key not in self.results:
            self.results[key] = ANYTHING  # for a recursive call within this one
            code = self._code(function, arguments, trail)
            self.results[key] = Activation(self, function, code, arguments, trail).run(report) if code else ANYTHING
        return self.results[key]

    def check_code(self, function: FunctionType) -> None:
        """Look for mistakes that do not depend on values, in `function` and the user's functions that it refers to."""
        for each in reachable(function, _is_own):
            code = self._code(each, {}, ())
            if code and (again := repeated_draw(code)):
                raise DeclarationError(
                    f"{self.label} ({place(each, again)}) draws at an index at which it has drawn already, or "
                    "does so in each round of a loop: all are made of the same random number; take another index for "
                    "each, as in 2 * i and 2 * i + 1, or entities.identity[e]"
                )
            if code and (line := _endless(code)):
                raise DeclarationError(
                    f"{self.label} ({place(each, line)}): this loop never ends, and nothing interrupts machine code; "
                    "leave it by break or return"
                )
            if code and (found := first_unassigned(code)):
                name, line = found
                raise DeclarationError(
                    f"{self.label} ({place(each, line)}): on some path '{name}' has no value here, where machine code "
                    f"takes 0 or what an earlier round left; give it one ahead of that, as in {name} = -1"
                )

    def check_events(self) -> None:
        """Look for events whose columns are written, or read, while nothing asks which of them there are."""
        for parameter in self.system.parameters:
            for event in parameter.components if parameter.kind in ("read", "write") else ():
                columns = {name for component, name in self.used if component is event}
                if issubclass(event, Event) and columns and COUNT not in columns:
                    raise DeclarationError(
                        f"{self.label} uses {event.__name__}.{min(columns)}, but neither emits the event nor looks at "
                        f"its count: take k = emit({parameter.name}) for a new one, or a loop over "
                        f"range({parameter.name}.count[0]), and {parameter.name}.{min(columns)}[k]"
                    )

    def check_coupled(self, behind: Collection[str]) -> None:
        """Look for columns that are written without those that have to fit them. Outlast's own systems share that."""
        for component, name in sorted(self.written, key=lambda column: (column[0].__qualname__, column[1])):
            for coupled in component.coupled:
                lacking = [each for each in coupled.needs if (component, each) not in self.written]
                if name in coupled.columns and lacking and coupled.computed_by not in behind:
                    later = self.system.phase.when is When.RESET and coupled.computed_by
                    raise DeclarationError(
                        f"{self.label} writes {component.__name__}.{name}, but not {' and '.join(lacking)}, which must "
                        f"fit it: {coupled.cure}{f'; or run before {later}, which computes that' if later else ''}"
                    )

    def _code(self, function: FunctionType, arguments: dict[str, Values], trail: tuple[str, ...]) -> Any:
        """The intermediate representation of a function; None if numba cannot make one and it stays Python."""
        if function not in self.code:
            try:
                self.code[function] = run_frontend(function)
            except Exception as error:  # numba raises any type for code it does not expect
                if compiled() and self.system.compiled:
                    line = next((line for _, line in places(error)), function.__code__.co_firstlineno)
                    where = "; ".join((*trail, place(function, line)))
                    raise DeclarationError(
                        f"{self.label} ({where}) cannot be compiled: {first_sentence(error)}\n{AS_PYTHON}"
                    ) from error
                self.code[function] = None
        if self.code[function] is None and (totals := [*added(*arguments.values())]):
            where = "; ".join((*trail, place(function, function.__code__.co_firstlineno)))
            raise ScheduleError(
                f"{self.label} ({where}) declares Add[{component_name(totals[0])}], but what is done with it "
                f"here cannot be followed; declare Write[{component_name(totals[0])}]"
            )
        return self.code[function]
