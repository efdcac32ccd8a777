"""Checks of how a system draws random numbers, as far as its code shows it.

The functions of kernels.random compute their numbers from (key, index): two draws with the same index give the same
number.
"""

from collections.abc import Hashable, Mapping
from types import ModuleType
from typing import Any

from numba.core import ir
from numba.core.analysis import compute_cfg_from_blocks

from ..kernels import random
from .abstract_values import Constant, Values, floating

DRAWS = ("integer", "normal", "uniform", "uniform2", "words")  # functions of kernels.random
FUNCTIONS = {getattr(getattr(random, name), "py_func", getattr(random, name)) for name in DRAWS}
PURE = ("numpy", "math", "builtins")  # modules whose functions write no column here


def refusal(arguments: Mapping[str, Values]) -> str:
    """Why a draw is refused; "" if it is not. arguments: the values of its arguments, by name."""
    for name in ("index", "bound"):
        if floating(arguments.get(name, frozenset())):
            return f"draws with a float as {name}, which cuts it off; an integer is needed, as in int({name})"
    bounds = [value.value if isinstance(value, Constant) else 1 for value in arguments.get("bound", ())]
    if bounds and all(isinstance(bound, int) and bound < 1 for bound in bounds):
        return f"draws an integer below {bounds[0]}: the bound is 1 or more"
    return ""


def repeated_draw(code: Any) -> int | None:
    """The line of a draw with the same key and index as an earlier one; None: there is none.

    The earlier one is in the same basic block, or is that of the round before in a loop: see _in_each_round.

    Args:
        code: The intermediate representation of a function, numba's FunctionIR.
    """
    lines = (_repeated(block.body) for _, block in sorted(code.blocks.items()))
    return next((line for line in lines if line is not None), None) or _in_each_round(code.blocks)


def _in_each_round(blocks: Mapping[int, Any]) -> int | None:
    """The line of a draw that every round of a loop makes with one key and index, which nothing in the loop changes.

    A draw that only some rounds make is none: the loop may look for the one entity for which it is made.
    """
    graph = compute_cfg_from_blocks(blocks)
    dominators = graph.dominators()
    for loop in graph.loops().values():
        assigned: dict[str, list[Any]] = {}
        for statement in (one for label in loop.body for one in blocks[label].find_insts(ir.Assign)):
            assigned.setdefault(statement.target.name, []).append(statement.value)
        ends = [label for label in loop.body if loop.header in dict(graph.successors(label))]
        for label in sorted(set(loop.body).intersection(*(dominators[end] for end in ends))):
            for call in blocks[label].find_exprs(op="call"):
                function = _named(call.func.name, assigned)
                drawn = getattr(function, "py_func", function) in FUNCTIONS and len(call.args) >= 2
                if drawn and all(_constant(argument.name, assigned, ()) for argument in call.args[:2]):
                    return int(call.loc.line)
    return None


def _named(variable: str, assigned: Mapping[str, list[Any]]) -> Any:
    """The function that a variable of a loop stands for; None if it is computed."""
    match assigned.get(variable):
        case [ir.Global() | ir.FreeVar() as named]:
            return named.value
        case [ir.Expr(op="getattr") as member]:
            return getattr(_named(member.value.name, assigned), member.attr, None)
    return None


def _constant(variable: str, assigned: Mapping[str, list[Any]], trail: tuple[str, ...]) -> bool:
    """Whether a variable is the same in all rounds of a loop. trail: the variables that are computed from it."""
    if variable not in assigned:
        return True
    match assigned[variable]:
        case [ir.Const() | ir.Global() | ir.FreeVar()]:
            return True
        case [ir.Var() as source]:
            sources = [source]
        case [ir.Expr(op="binop" | "unary" | "cast" | "build_tuple") as computed]:
            sources = computed.list_vars()
        case _:
            return False
    trail = (*trail, variable)
    return all(each.name not in trail and _constant(each.name, assigned, trail) for each in sources)


def _repeated(statements: Any) -> int | None:
    """The line of a repeated draw in a block.

    A variable is known by what it was computed from, an element of a column also by how often the column had been
    written. Calls of functions that are not PURE count as writes of all columns.
    """
    terms, writes, drawn = dict[str, Hashable](), dict[Hashable, int](), set[Hashable]()

    def term(variable: Any) -> Hashable:
        return terms.setdefault(variable.name, variable.name)

    def computed(value: Any) -> Hashable:
        match value:
            case ir.Var():
                return term(value)
            case ir.Const() | ir.Global() | ir.FreeVar():
                return value.value if isinstance(value.value, Hashable) else id(value.value)
            case ir.Expr(op="getattr"):
                owner = term(value.value)
                return getattr(owner, value.attr, 0) if isinstance(owner, ModuleType) else (owner, value.attr)
            case ir.Expr(op="getitem"):
                return term(value.value), term(value.index), writes.get(term(value.value), 0), writes.get("", 0)
            case ir.Expr(op="static_getitem"):
                return term(value.value), str(value.index), writes.get(term(value.value), 0), writes.get("", 0)
            case ir.Expr(op="binop" | "unary"):
                return value.fn, *map(term, value.list_vars())
            case ir.Expr(op="build_tuple" | "cast"):
                return value.op, *map(term, value.list_vars())
        return object()  # equal to nothing else

    for statement in statements:
        if isinstance(statement, (ir.SetItem, ir.StaticSetItem)):
            writes[term(statement.target)] = writes.get(term(statement.target), 0) + 1
        if not isinstance(statement, ir.Assign):
            continue
        value = statement.value
        if isinstance(value, ir.Expr) and value.op == "inplace_binop":
            writes[term(value.lhs)] = writes.get(term(value.lhs), 0) + 1
        if isinstance(value, ir.Expr) and value.op == "call":
            called: Any = terms.get(value.func.name)
            if getattr(called, "py_func", called) in FUNCTIONS and len(value.args) >= 2:
                draw = term(value.args[0]), term(value.args[1])
                if draw in drawn:
                    return int(statement.loc.line)
                drawn.add(draw)
            elif str(getattr(called, "__module__", "")).partition(".")[0] not in PURE:
                writes[""] = writes.get("", 0) + 1
        terms[statement.target.name] = computed(value)
    return None
