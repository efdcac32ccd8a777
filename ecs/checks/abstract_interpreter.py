"""An abstract interpreter of kernels: numba's intermediate representation, run over abstract values.

A variable's abstract values are those that any of its assignments may give it; an error is reported only if all of them
agree. A value that cannot be followed (a table in a list, in an array or in a numpy function) is unknown and left to
the compiler. Only tables that are declared Add must be followed everywhere, as nothing later would notice if they are
read or overwritten.
"""

import builtins
import inspect
import operator
from collections.abc import Callable, Iterable
from dataclasses import replace
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core import ir

from ..kernels import by_role, random
from ..kernels.errors import DeclarationError, EngineError, ScheduleError, did_you_mean, place
from ..kernels.frozen_values import is_outside
from . import random_check
from .abstract_values import (
    ANYTHING,
    FLOATING,
    UNKNOWN,
    Calls,
    Column,
    Constant,
    Definitions,
    Interval,
    Member,
    PerAgent,
    Shared,
    Slice,
    Sum,
    Table,
    Values,
    added,
    bounded,
    can_follow,
    component_name,
    computed,
    counted,
    floating,
    tracked,
)
from .index_check import wrong_field, wrong_index

WRITING = ("fill", "itemset", "partition", "put", "sort")  # methods of arrays that write in place
VIEWS = ("ravel", "reshape", "transpose")  # methods of arrays whose result may be a view
SIZES = ("dtype", "itemsize", "nbytes", "ndim", "shape", "size", "strides")  # attributes that do not show an element
FLOATS = (float, np.float32, np.float64)
TRUTHS = {getattr(operator, name) for name in ("lt", "le", "eq", "ne", "ge", "gt", "not_", "contains")}
DRAWS = ("uniform", "normal")  # functions of kernels.random that return floats
WHOLE = ("ceil", "comb", "factorial", "floor", "gcd", "isqrt", "lcm", "perm", "trunc")  # math's that return integers
SAME = (np.ascontiguousarray, np.asfortranarray, np.asarray, np.ravel, np.reshape, np.transpose)  # may return a view
WRITERS = (np.copyto, np.fill_diagonal, np.nditer, np.place, np.put, np.putmask)  # write their first argument
ROUNDS = 9  # passes over a function, at most, until values flow no further; nested loops need fewer


class Activation:
    """One call of a function.

    Args:
        calls: What follows the calls that this function makes.
        function: A Python function.
        code: Its intermediate representation, numba's FunctionIR.
        arguments: Values by parameter; parameters that are missing here are unknown.
        trail: The places of the calls that lead here.
    """

    def __init__(
        self, calls: Calls, function: FunctionType, code: Any, arguments: dict[str, Values], trail: tuple[str, ...]
    ) -> None:
        self.calls, self.function, self.trail = calls, function, trail
        self.arguments, self.statements = arguments, [each for _, b in sorted(code.blocks.items()) for each in b.body]
        self.definitions = Definitions(self.statements)
        self.values: dict[str, Values] = {}
        self.returned: Values = frozenset()
        self.bounded = set[Any]()  # values that the function compares, so that it may know that they are in bounds
        self.report, self.certain, self.line = False, False, 0

    def run(self, report: bool) -> Values:
        """The values that it returns. report: whether errors are raised; only if the arguments are final."""
        for _ in range(ROUNDS):
            before = dict(self.values)
            self._pass()
            if self.values == before:
                break
        else:
            self.values = {name: values | ANYTHING for name, values in self.values.items()}
        self.report = report
        self._pass()
        return self.returned or ANYTHING

    def _pass(self) -> None:
        for statement in self.statements:
            self.line = statement.loc.line
            match statement:
                case ir.Assign():
                    name = statement.target.name
                    self.values[name] = self.values.get(name, frozenset()) | self._value(statement.value)
                case ir.SetItem():
                    self._set_item(statement)
                case ir.SetAttr():
                    self._set_attribute(statement)
                case ir.Return():
                    self.returned |= self._of(statement.value)
                case _:
                    self._refuse_added(statement.list_vars())

    def _of(self, variable: Any) -> Values:
        values = self.values.get(variable.name, frozenset())
        return values if self.bounded.isdisjoint(values) else ANYTHING

    def _only(self, variable: Any) -> Any:
        """The value of a variable if there is only one, else UNKNOWN."""
        values = self._of(variable)
        return next(iter(values)) if len(values) == 1 else UNKNOWN

    # ---- expressions

    def _value(self, value: Any) -> Values:
        match value:
            case ir.Arg():
                return self.arguments.get(value.name, ANYTHING)
            case ir.Var():
                return self._of(value)
            case ir.Global() | ir.FreeVar() | ir.Const():
                if value.value is ir.UNDEFINED:
                    known = [*self.arguments, *self.function.__globals__, *dir(builtins)]
                    hint = did_you_mean(value.name, known, before="; ")
                    self._refuse(f"the name '{value.name}' is not defined{hint}")
                return frozenset([FLOATING if isinstance(value.value, FLOATS) else Constant(value.value)])
            case ir.Expr():
                return self._expression(value)
        self._refuse_added(value.list_vars())
        return ANYTHING

    def _expression(self, expression: Any) -> Values:
        match expression.op:
            case "cast" | "exhaust_iter" | "getiter" | "iternext":
                return self._of(expression.value)
            case "build_tuple":
                return frozenset([tuple(map(self._of, expression.items))])
            case "getattr":
                return self._union(expression.value, lambda value: self._attribute(value, expression.attr))
            case "static_getitem":
                return self._union(expression.value, lambda value: self._item(value, Constant(expression.index)))
            case "getitem":
                self._refuse_added([expression.index])
                index = self._only(expression.index)
                return self._union(expression.value, lambda value: self._item(value, index))
            case "pair_first":
                return self._union(expression.value, self._elements)
            case "pair_second":
                return ANYTHING
            case "inplace_binop":
                return self._inplace(expression)
            case "call":
                return self._call(expression)
        self._refuse_added(expression.list_vars())
        if expression.op in ("binop", "unary"):
            return self._number(list(expression.list_vars()), expression.fn)
        return ANYTHING

    def _union(self, variable: Any, function: Callable[[Any], Values]) -> Values:
        """Apply `function` to every value that the variable may have; errors are raised only if there is just one."""
        values = self._of(variable)
        self.certain = len(values) == 1
        return frozenset().union(*map(function, values))

    def _number(self, variables: list[Any], function: Any) -> Values:
        self._refuse_per_agent(variables)
        operands = [self._of(each) for each in variables]
        self.bounded |= bounded(function, operands)
        if found := computed(function, operands):
            return found
        float_ = function is operator.truediv or any(map(floating, operands))
        return frozenset([FLOATING]) if float_ and function not in TRUTHS else ANYTHING

    def _refuse_per_agent(self, variables: Iterable[Any]) -> None:
        for value in [value for variable in variables for value in self._of(variable) if isinstance(value, PerAgent)]:
            self._refuse(
                f"computes with {value.name}, in which roles differ: write of({value.name}, e), where e is the row "
                "of the agent"
            )

    def _attribute(self, value: Any, name: str) -> Values:
        value = value.column if isinstance(value, Sum) else value
        if isinstance(value, Table):
            columns = value.component.columns
            if name in columns:
                self.calls.used.add((value.component, name))
                return frozenset([Column(value.component, value.access, name)])
            if self.certain:
                known = f"it has: {', '.join(columns)}{did_you_mean(name, columns, before='; ')}"
                self._refuse(f"{component_name(value)} has no column '{name}'; {known}")
        elif isinstance(value, Column):
            if value.access == "add" and name not in SIZES:
                self._refuse_access(value, f"takes .{name} of {value}")
            if name in ("T", "flat"):
                return frozenset([value])
            if name in (*WRITING, *VIEWS):
                return frozenset([replace(value, method=name)])
        elif isinstance(value, Shared):
            return value.has(name)
        elif isinstance(value, Constant) and isinstance(value.value, ModuleType):
            if hasattr(value.value, name):
                found = getattr(value.value, name)
                return frozenset([FLOATING if isinstance(found, FLOATS) else Constant(found)])
            if self.certain:
                hint = did_you_mean(name, dir(value.value), before="; ")
                self._refuse(f"{value.value.__name__} has no '{name}'{hint}")
        return ANYTHING

    def _item(self, value: Any, index: Any) -> Values:
        value, known = value.column if isinstance(value, Sum) else value, index
        index = index.value if isinstance(index, Constant) else None
        if isinstance(value, Table):
            columns = [*value.component.columns]
            if isinstance(index, int) and -len(columns) <= index < len(columns):
                return frozenset([Column(value.component, value.access, columns[index])])
            if value.access == "add":
                self._refuse_access(value, f"takes a part of the table of {component_name(value)}")
        elif isinstance(value, (Column, Shared)):
            self._check_index(value, known)
            return frozenset([value.at(known)]) if isinstance(value, Column) else value.has("element")
        elif isinstance(value, tuple):
            if isinstance(index, int) and -len(value) <= index < len(value):
                return value[index]  # type: ignore[no-any-return]
            return ANYTHING.union(*value)
        return ANYTHING

    def _elements(self, value: Any) -> Values:
        """The values that a loop over `value` yields."""
        if isinstance(value, tuple):
            return frozenset().union(*value)
        return frozenset([value]) if isinstance(value, (Interval, Member)) else self._item(value, UNKNOWN)

    # ---- calls

    def _call(self, expression: Any) -> Values:
        """The values of a call. A Python function is followed with the values of its arguments."""
        target = self._only(expression.func)
        called: Any = target.value if isinstance(target, Constant) else None
        if called is len or called is enumerate:
            rows = self._only(expression.args[0]) if len(expression.args) == 1 and not expression.kws else UNKNOWN
            if isinstance(rows, Shared) or called is len:
                return rows.has(called.__name__) if isinstance(rows, Shared) else ANYTHING
        if called is slice:
            return frozenset([Slice(*map(self._only, expression.args[:2]))])
        if called is range:
            return counted([self._only(argument) for argument in expression.args])
        if isinstance(target, Column) and target.method in VIEWS:
            return frozenset([replace(target, method="")])
        if isinstance(target, Column) and target.method:
            self._refuse_write(target, whole=True)
        called = getattr(called, "python", getattr(called, "py_func", called))
        module = getattr(called, "__module__", "")
        if module == by_role.__name__:  # `of`, whose Python form computes with the number
            self._refuse_added(expression.list_vars())
            if len(expression.args) == 2:
                self._check_index(*map(self._only, expression.args))
            return ANYTHING
        if not can_follow(called) or expression.vararg is not None or expression.varkwarg is not None:
            self._refuse_added(expression.list_vars())
            if any(called is each for each in SAME) and expression.args:
                return self._of(expression.args[0])
            if any(called is each for each in WRITERS) and expression.args:
                self._refuse_write(self._only(expression.args[0]), whole=True)
            if module == "math" and not called.__name__.startswith(("is", *WHOLE)):
                return frozenset([FLOATING])
            if any(called is each for each in (abs, max, min, round, sum, int, *FLOATS)):
                self._refuse_per_agent(expression.args)
            return frozenset([FLOATING]) if any(called is kind for kind in FLOATS) else ANYTHING
        positional = [self._of(argument) for argument in expression.args]
        named = {name: self._of(argument) for name, argument in expression.kws}
        try:
            bound = inspect.signature(called).bind(*positional, **named)
        except TypeError as error:
            self._refuse(f"{called.__name__}(): {error}")
            return ANYTHING
        if module == random.__name__ and (wrong := random_check.refusal(bound.arguments)):
            self._refuse(wrong)
        if not is_outside(called) and not any(map(tracked, bound.arguments.values())):
            if module == random.__name__ and called.__name__ in DRAWS:
                return frozenset([FLOATING])
            return ANYTHING  # nothing to check in a kernel of outlast's own that gets no table
        trail = (*self.trail, place(self.function, self.line))
        return self.calls.call(called, dict(bound.arguments), trail, self.report)

    # ---- writes

    def _set_item(self, statement: Any) -> None:
        self._refuse_added([statement.index])
        target = self._only(statement.target)
        if totals := [*added(self._of(statement.target))]:
            if not self.definitions.is_addition(statement):
                self._refuse_access(totals[0], f"writes {totals[0]}")
            return
        self._refuse_added([statement.value])
        if isinstance(target, Table):
            example = next(iter(target.component.columns))
            self._refuse(f"{component_name(target)} is a table: write one of its columns, as in .{example}[...]")
        self._refuse_write(target)
        self._refuse_per_agent([statement.value])
        if isinstance(target, Column):
            index, kind = self._only(statement.index), target.dtype
            self._check_index(target, index)
            self._check_field(target, index)
            if kind.kind in "iu" and floating(self._of(statement.value)):
                self._refuse(f"writes a float to {target}, {kind}, which cuts it off; say so, as in np.{kind}(...)")
            literal = self._only(statement.value)
            number = literal.value if isinstance(literal, Constant) and isinstance(literal.value, int) else 0
            if kind.kind in "iu" and not np.iinfo(kind).min <= number <= np.iinfo(kind).max:
                self._refuse(f"writes {number} to {target}, {kind}, which cannot hold it")

    def _check_index(self, target: Any, index: Any) -> None:
        """Refuse a row where an index among some entities is needed, and the reverse."""
        layout = self.calls.layout if self.report else None
        if layout is not None and (wrong := wrong_index(layout, target, index)):
            self._refuse(wrong)

    def _check_field(self, target: Column, index: Any) -> None:
        """Refuse writes beside the fields of a system's Offsets: its order relies on these naming all it touches."""
        if wrong := wrong_field(self.calls.offsets.get((target.component, target.name), set()), target, index):
            self._refuse(wrong)

    def _set_attribute(self, statement: Any) -> None:
        target = self._only(statement.target)
        if isinstance(target, Table):
            self._refuse(
                f"a column cannot be replaced; write into it: {component_name(target)}.{statement.attr}[...] = ..."
            )
        self._refuse_added([statement.target, statement.value])

    def _inplace(self, expression: Any) -> Values:
        """The values of += and the like. On an array, they write it in place."""
        self._refuse_added([expression.rhs])
        target = self._only(expression.lhs)
        if isinstance(target, Column) and target.access == "add" and target.part:
            if expression.fn not in (operator.iadd, operator.isub):
                self._refuse_access(target, f"does more to {target} than add")
            kind = target.dtype
            if kind.kind not in "iu" or floating(self._of(expression.rhs)):
                what = f"{target} is {kind}" if kind.kind not in "iu" else f"a float is added to {target}, {kind}"
                self._refuse_access(target, f"adds, but {what}, and only sums of integers do not depend on the order")
            return frozenset([Sum(target)])
        self._refuse_added([expression.lhs])
        if isinstance(target, Shared) or (isinstance(target, Column) and not target.part):
            self._refuse_write(target, whole=True)
            return frozenset([target])
        return self._number([expression.lhs, expression.rhs], expression.immutable_fn)

    # ---- errors

    def _refuse_write(self, target: Any, whole: bool = False) -> None:
        """Refuse a write to something read-only. whole: whether the write covers all of the target."""
        if isinstance(target, Column):
            self.calls.written.add((target.component, target.name))
        if isinstance(target, Column) and whole:
            self._check_field(target, Slice(Constant(None)))
        if isinstance(target, Column) and target.access == "read":
            cure = f"declare it Write[{component_name(target)}]"
            self._raise(ScheduleError, f"writes {target}, which its parameter list declares as Read; {cure}")
        if isinstance(target, Shared):
            cure = "take a Scratch or a column of a component"
            self._raise(
                ScheduleError, f"writes '{target.name}', which is read-only and the same for all worlds; {cure}"
            )

    def _refuse_added(self, variables: Iterable[Any]) -> None:
        """Refuse a use of these variables, which is not one of the allowed sums, if any is declared Add."""
        for value in added(*map(self._of, variables)):
            self._refuse_access(value, f"uses {value if isinstance(value, Column) else component_name(value)}")

    def _refuse_access(self, value: Any, does: str) -> None:
        name = component_name(value)
        allowed = f"declares Add[{name}], which allows column[...] += integer and -= only"
        self._raise(ScheduleError, f"{does}, but {allowed}; declare Write[{name}]")

    def _refuse(self, what: str) -> None:
        self._raise(DeclarationError, what, colon=":")

    def _raise(self, kind: type[EngineError], what: str, colon: str = "") -> None:
        if self.report:
            places = "; ".join((*self.trail, place(self.function, self.line)))
            raise kind(f"{self.calls.label} ({places}){colon} {what}")
