"""A check of a system's source, for the branches that a trial does not take.

Its source shows the columns that it uses and writes, and any operation but sums on columns declared Add, also in called
functions that get tables; functions without source are left to the trial. Numba's form of it shows variables that may
have no value where they are used, loops that never end, and accesses to memory that numba does not check.
"""

import ast
import functools
import inspect
import linecache
import textwrap
import warnings
from collections import Counter
from collections.abc import Iterator
from types import CodeType, FunctionType
from typing import Any

from numba.core import config, ir
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.compiler import run_frontend
from numba.core.errors import NumbaWarning
from numba.core.ssa import reconstruct_ssa

from ..declarations.component import Component
from ..declarations.system import System
from ..kernels.errors import DeclarationError, ScheduleError, place
from ..kernels.frozen_values import is_library, is_outside, reachable, references
from .traced import ONLY_SUMS, SIZES, Columns

ENDLESS = "this loop never ends, and nothing interrupts machine code; leave it by break or return"
NO_VALUE = (
    "on some path '{0}' has no value here, where machine code takes 0 or what an earlier round left; give it one ahead "
    "of that, as in {0} = -1"
)
UNCHECKED = {  # attributes and functions that give access to unchecked memory, with their errors
    "flat": "takes .flat of an array, whose indices nothing checks; index the array, or its .ravel()",
    "ctypes": "takes .ctypes of an array, an address that nothing checks; index the array",
    "as_strided": "calls as_strided, whose shape nothing checks; take slices, or reshape",
    "delete": "calls np.delete, whose indices nothing checks; take what is to stay, as in a[stays]",
}
Names = dict[str, tuple[type[Component], str, str]]  # component, access, and column ("" for a table) by variable


def check_source(system: System) -> tuple[Columns, Columns]:
    """Return the columns that a system's source names, and those that it writes, over all branches.

    Raises:
        ScheduleError: It does more than sums on a column that is declared Add; with its label, file and line.
    """
    function: Any = getattr(system.function, "py_func", system.function)
    tables = {p.name: (p.components[0], p.kind, "") for p in system.parameters if p.kind in ("read", "write", "add")}
    ahead, used, written = [_Uses(function, tables, "")], Columns(), Columns()
    for each in ahead:  # grows in the loop
        for node, (component, access, column) in each.columns():
            parent = each.parents[node]
            used.add((component, column))
            if isinstance(parent, ast.Subscript) and parent.value is node and _is_stored(parent):
                written.add((component, column))
            if access == "add" and not each.adds(node, parent):
                where = f"{each.trail}{place(each.function, getattr(node, 'lineno', 0))}"
                text = f"reads or changes {component.__name__}.{column}, {ONLY_SUMS.format(component.__name__)}"
                raise ScheduleError(f"{system.label} ({where}) {text}")
        ahead += [called for called in each.calls() if called.key not in (known.key for known in ahead)]
    return used, written


def check_paths(system: System) -> None:
    """Refuse variables of a user's compiled system, and of functions it calls, that have a value on some paths only.

    Raises:
        DeclarationError: A variable is one of these, a loop never ends, or an access is UNCHECKED; with the label,
            file and line.
    """
    columns = {name for parameter in system.parameters for each in parameter.components for name in each.columns}
    function: Any = getattr(system.function, "py_func", system.function)
    for inner in reachable(function, lambda inner: is_outside(inner) and not is_library(inner)):
        try:
            code = run_frontend(inner)
        except Exception:  # numba will refuse it with a reason
            continue
        if found := _unchecked(code, columns) or _wrong_path(code):
            line, what = found
            raise DeclarationError(f"{system.label} ({place(inner, line)}): {what}")


def _unchecked(code: Any, columns: set[str]) -> tuple[int, str] | None:
    """Return the line of an UNCHECKED access in numba's form of a function, and its description.

    columns: names that are not attributes of arrays.
    """
    for statement in (each for block in code.blocks.values() for each in block.find_insts(ir.Assign)):
        value = statement.value
        is_attribute = isinstance(value, ir.Expr) and value.op == "getattr"
        name = value.attr if is_attribute else value.name if isinstance(value, (ir.Global, ir.FreeVar)) else ""
        if name in UNCHECKED and name not in columns:
            return statement.loc.line, UNCHECKED[name]
    return None


def _wrong_path(code: Any) -> tuple[int, str] | None:
    """Return the line of code that check_paths refuses in numba's form of a function, and the reason."""
    for label, loop in compute_cfg_from_blocks(code.blocks).loops().items():
        if not loop.exits:
            return code.blocks[label].loc.line, ENDLESS
    before = config.ALWAYS_WARN_UNINIT_VAR
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        try:
            config.ALWAYS_WARN_UNINIT_VAR = 1
            reconstruct_ssa(code)
        finally:
            config.ALWAYS_WARN_UNINIT_VAR = before
    for each in (each.message for each in found if isinstance(each.message, NumbaWarning)):
        name = each.msg.partition("variable ")[2].partition(".")[0]
        if each.loc and not name.startswith("$"):
            return each.loc.line, NO_VALUE.format(name)
    return None


class _Uses:
    """Uses of tables and columns by a function: the system, or one that it calls.

    names: the meanings of the function's parameters, as far as known. trail: the places of the calls that lead to it,
    each followed by "; ".
    """

    def __init__(self, function: FunctionType, names: Names, trail: str) -> None:
        self.function, self.trail, self.key = function, trail, (function, names)
        self.nodes = [*ast.walk(tree)] if (tree := _parsed(function.__code__)) else []
        self.parents = {child: node for node in self.nodes for child in ast.iter_child_nodes(node)}
        stored = Counter(node.id for node in self.nodes if isinstance(node, ast.Name) and _is_stored(node))
        self.names = {name: what for name, what in names.items() if name not in stored}
        for node in self.nodes:  # other names of columns
            match node:
                case ast.Assign(targets=[ast.Name(id=name)]) if stored[name] == 1 and (what := self._of(node.value)):
                    self.names[name] = what

    def _of(self, node: ast.AST) -> tuple[type[Component], str, str] | None:
        """Return the component, access and column that an expression stands for; or None."""
        match node:
            case ast.Name(id=name):
                return self.names.get(name)
            case ast.Attribute(value=ast.Name(id=name), attr=attr) if name in self.names and not self.names[name][2]:
                component, access, _ = self.names[name]
                return (component, access, attr) if attr in component.columns else None
        return None

    def columns(self) -> Iterator[tuple[ast.AST, tuple[type[Component], str, str]]]:
        """Yield the expressions that stand for columns, but are not given a value."""
        for node in self.nodes:
            if not _is_stored(node) and (what := self._of(node)) and what[2]:
                yield node, what

    def adds(self, node: ast.AST, parent: Any) -> bool:
        """Return whether a column that is declared Add is only added to, asked for its size, or handed on."""
        match parent:
            case ast.Subscript() if parent.value is node:
                total: Any = self.parents[parent]
                sums = isinstance(total, ast.AugAssign) and isinstance(total.op, (ast.Add, ast.Sub))
                return sums and total.target is parent
            case ast.Attribute(attr=name):
                return name in SIZES
            case ast.Call(func=function):
                return node is not function and (ast.unparse(function) == "len" or self._called(parent) is not None)
            case ast.Assign(targets=[ast.Name(id=name)]):
                return name in self.names
        return isinstance(parent, (ast.Tuple, ast.keyword))

    def _called(self, call: ast.Call) -> FunctionType | None:
        """Return the called function, if it is a Python function that can be followed."""
        found = dict(references(self.function)).get(ast.unparse(call.func))
        plain = getattr(found, "py_func", found)
        return plain if isinstance(plain, FunctionType) and not is_library(plain) else None

    def calls(self) -> Iterator["_Uses"]:
        """Yield the calls of functions that get a table or a column."""
        for node in self.nodes:
            if isinstance(node, ast.Call) and (called := self._called(node)):
                code = called.__code__
                given = [*zip(code.co_varnames[: code.co_argcount], node.args, strict=False)]
                given += [(keyword.arg or "", keyword.value) for keyword in node.keywords]
                names = {name: what for name, value in given if (what := self._of(value))}
                if names and not any(isinstance(value, ast.Starred) for value in node.args):
                    yield _Uses(called, names, f"{self.trail}{place(self.function, node.lineno)}; ")


@functools.lru_cache(maxsize=4096)
def _parsed(code: CodeType) -> ast.FunctionDef | None:
    """Return the syntax tree of a function, with the line numbers of its file; None without source."""
    lines = inspect.getblock(linecache.getlines(code.co_filename)[code.co_firstlineno - 1 :])
    try:
        (tree,) = ast.parse(textwrap.dedent("".join(lines))).body
    except (SyntaxError, ValueError):
        return None
    ast.increment_lineno(tree, code.co_firstlineno - 1)
    return tree if isinstance(tree, ast.FunctionDef) and tree.name == code.co_name else None


def _is_stored(node: Any) -> bool:
    return isinstance(getattr(node, "ctx", None), ast.Store)
