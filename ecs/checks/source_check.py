"""A check of a system's source, for the branches that a trial does not take.

It finds columns that do not exist, writes to what is declared Read, anything but sums on what is declared Add, also in
functions that are called with tables; and variables that may have no value where they are used, and loops that nothing
leaves. Functions whose source is not at hand are left to the trial and to the compiler.
"""

import ast
import functools
import inspect
import linecache
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from types import CodeType, FunctionType
from typing import Any, NoReturn

from ..compilation.cache_key import FOREIGN
from ..declarations.component import Component
from ..declarations.system import System
from ..kernels.errors import DeclarationError, EngineError, ScheduleError, did_you_mean, place
from ..kernels.frozen_values import is_outside, reachable, references
from .stand_ins import ONLY_SUMS, READ_ONLY, SIZES, Columns

Names = dict[str, tuple[type[Component], str, str]]  # component, access, and column ("" for a table) by variable
SCOPES = (ast.FunctionDef, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def check_source(system: System) -> tuple[Columns, Columns]:
    """Check what a system's source says, whatever branches it takes.

    Returns:
        The columns that it names, and those that it writes.

    Raises:
        EngineError: With the system's label, file and line.
    """
    function: Any = getattr(system.function, "py_func", system.function)
    tables = {p.name: (p.components[0], p.kind, "") for p in system.parameters if p.kind in ("read", "write", "add")}
    ahead, used, written = [_Uses(system, function, tables, "")], Columns(), Columns()
    for each in ahead:  # grows meanwhile
        each.check(used, written)
        ahead += [called for called in each.calls() if called.key not in (known.key for known in ahead)]
    for inner in reachable(function, lambda inner: is_outside(inner) and not is_foreign(inner)):
        if tree := _parsed(inner.__code__):
            _Assignments(system, inner, tree).check()
    return used, written


def is_foreign(function: FunctionType) -> bool:
    """Whether numba itself, and not its source, says what the machine code of a function is."""
    return str(function.__module__).partition(".")[0] in FOREIGN


@functools.lru_cache(maxsize=4096)
def _parsed(code: CodeType) -> ast.FunctionDef | None:
    """The syntax tree of a function, with the line numbers of its file; None if there is no source."""
    lines = inspect.getblock(linecache.getlines(code.co_filename)[code.co_firstlineno - 1 :])
    try:
        (tree,) = ast.parse(textwrap.dedent("".join(lines))).body
    except (SyntaxError, ValueError):
        return None
    ast.increment_lineno(tree, code.co_firstlineno - 1)
    return tree if isinstance(tree, ast.FunctionDef) and tree.name == code.co_name else None


class _Uses:
    """How a function uses tables and columns.

    Args:
        system: The system.
        function: It, or a function that it calls.
        names: What the function's parameters stand for, as far as that is known.
        trail: The places of the calls that lead to it, each followed by "; ".
    """

    def __init__(self, system: System, function: FunctionType, names: Names, trail: str) -> None:
        self.system, self.function, self.trail, self.key = system, function, trail, (function, names)
        tree = _parsed(function.__code__)
        self.nodes = [*ast.walk(tree)] if tree else []
        self.parents = {child: node for node in self.nodes for child in ast.iter_child_nodes(node)}
        stored = Counter(node.id for node in self.nodes if isinstance(node, ast.Name) and _is_stored(node))
        self.names = {name: what for name, what in names.items() if name not in stored}
        for node in self.nodes:  # other names of columns
            match node:
                case ast.Assign(targets=[ast.Name(id=name)]) if stored[name] == 1 and (what := self._of(node.value)):
                    self.names[name] = what

    def _of(self, node: ast.AST) -> tuple[type[Component], str, str] | None:
        """Component, access and column that an expression stands for; None if it is something else."""
        match node:
            case ast.Name(id=name):
                return self.names.get(name)
            case ast.Attribute(value=ast.Name(id=name), attr=attr) if name in self.names and not self.names[name][2]:
                component, access, _ = self.names[name]
                if attr in component.columns:
                    return component, access, attr
                if not hasattr(component.Table, attr):
                    known = (
                        f"it has: {', '.join(component.columns)}{did_you_mean(attr, component.columns, before='; ')}"
                    )
                    self._refuse(node, DeclarationError, f": {component.__name__} has no column '{attr}'; {known}")
        return None

    def check(self, used: Columns, written: Columns) -> None:
        """Check all uses, and add the columns to these sets."""
        for node in self.nodes:
            if (what := self._of(node)) and what[2] and not (isinstance(node, ast.Name) and _is_stored(node)):
                component, access, column = what
                if _is_stored(node):
                    example = f"{component.__name__}.{column}[...] = ..."
                    self._refuse(node, DeclarationError, f": a column cannot be replaced; write into it: {example}")
                used.add((component, column))
                parent = self.parents[node]
                if isinstance(parent, ast.Subscript) and parent.value is node and _is_stored(parent):
                    written.add((component, column))
                    if access == "read":
                        text = f" writes {component.__name__}.{column}, {READ_ONLY.format(component.__name__)}"
                        self._refuse(node, ScheduleError, text)
                if access == "add" and not self._adds(node, parent):
                    text = f" reads or changes {component.__name__}.{column}, {ONLY_SUMS.format(component.__name__)}"
                    self._refuse(node, ScheduleError, text)

    def _adds(self, node: ast.AST, parent: Any) -> bool:
        """Whether a column that is declared Add is only added to, asked for its size, or handed on."""
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
        """The function that is called, if it is one of Python that can be followed."""
        found = dict(references(self.function)).get(ast.unparse(call.func))
        plain = getattr(found, "py_func", found)
        return plain if isinstance(plain, FunctionType) and not is_foreign(plain) else None

    def calls(self) -> Iterator["_Uses"]:
        """Yield the calls of functions that get a table or a column."""
        for node in self.nodes:
            if isinstance(node, ast.Call) and (called := self._called(node)):
                code = called.__code__
                given = [*zip(code.co_varnames[: code.co_argcount], node.args, strict=False)]
                given += [(keyword.arg or "", keyword.value) for keyword in node.keywords]
                names = {name: what for name, value in given if (what := self._of(value))}
                if names and not any(isinstance(value, ast.Starred) for value in node.args):
                    yield _Uses(self.system, called, names, f"{self.trail}{place(self.function, node.lineno)}; ")

    def _refuse(self, node: Any, kind: type[EngineError], text: str) -> NoReturn:
        raise kind(f"{self.system.label} ({self.trail}{place(self.function, node.lineno)}){text}")


class _Assignments:
    """Which variables of a function have a value in each of its lines, whatever way led there."""

    def __init__(self, system: System, function: FunctionType, tree: ast.FunctionDef) -> None:
        self.system, self.function, self.tree = system, function, tree
        outer = {
            name for node in _own(tree.body) if isinstance(node, (ast.Global, ast.Nonlocal)) for name in node.names
        }
        arguments = {argument.arg for argument in ast.walk(tree.args) if isinstance(argument, ast.arg)}
        self.everything = frozenset(_stored(tree.body) | arguments) - outer
        self.arguments = frozenset(arguments)
        self.loops = list[tuple[list[frozenset[str]], list[frozenset[str]]]]()  # what is known at breaks, continues

    def check(self) -> None:
        """Raise DeclarationError for a variable that may have no value, or for a loop that nothing leaves."""
        self._block(self.tree.body, self.arguments)

    def _block(self, statements: Sequence[ast.stmt], known: frozenset[str]) -> frozenset[str]:
        """What has a value behind statements; everything, if that is never reached. known: what has one ahead."""
        for statement in statements:
            known = self._statement(statement, known)
        return known

    def _statement(self, statement: Any, known: frozenset[str]) -> frozenset[str]:
        match statement:
            case ast.If():
                known = self._use([statement.test], known)
                return self._block(statement.body, known) & self._block(statement.orelse, known)
            case ast.For() | ast.While():
                return self._loop(statement, known)
            case ast.Try():
                after = self._block(statement.orelse, self._block(statement.body, known))
                handled = [self._block(each.body, known | {each.name or ""}) for each in statement.handlers]
                return self._block(statement.finalbody, after.intersection(*handled))
            case ast.With():
                return self._block(statement.body, self._use(statement.items, known) | _stored(statement.items))
            case ast.Match():
                ahead = self._use([statement.subject], known)
                cases = [self._block(each.body, ahead | _stored([each])) for each in statement.cases]
                return ahead.intersection(*cases) if cases else ahead
            case ast.Break() | ast.Continue():
                self.loops[-1][isinstance(statement, ast.Continue)].append(known)
                return self.everything
            case ast.Return() | ast.Raise():
                self._use([statement], known)
                return self.everything
            case ast.AugAssign(target=ast.Name(id=name)) if name in self.everything - known:
                self._refuse(name, statement)
        return self._use([statement], known) | _stored([statement])

    def _loop(self, loop: Any, known: frozenset[str]) -> frozenset[str]:
        ahead = self._use([loop.iter if isinstance(loop, ast.For) else loop.test], known)
        self.loops.append(([], []))
        end = self._block(loop.body, ahead | (_stored([loop.target]) if isinstance(loop, ast.For) else set()))
        breaks, continues = self.loops.pop()
        endless = isinstance(loop, ast.While) and isinstance(loop.test, ast.Constant) and bool(loop.test.value)
        if endless and not breaks and not any(isinstance(node, (ast.Return, ast.Raise)) for node in _own(loop.body)):
            raise DeclarationError(
                f"{self.system.label} ({place(self.function, loop.lineno)}): this loop never ends, and nothing "
                "interrupts machine code; leave it by break or return"
            )
        if endless:
            done = self.everything
        else:
            done = self._block(loop.orelse, end.intersection(*continues) if self._has_a_round(loop) else ahead)
        return done.intersection(*breaks)

    def _has_a_round(self, loop: Any) -> bool:
        """Whether a loop is over a range of constants that is not empty."""
        match loop:
            case ast.For(iter=ast.Call(func=ast.Name(id="range"), args=bounds)):
                known = dict(references(self.function))
                values: list[Any] = [
                    each.value if isinstance(each, ast.Constant) else known.get(ast.unparse(each)) for each in bounds
                ]
                return all(type(value) is int for value in values) and 0 not in values[2:] and len(range(*values)) > 0
        return False

    def _use(self, parts: Sequence[ast.AST], known: frozenset[str]) -> frozenset[str]:
        """Refuse variables without a value in expressions; what has one behind these."""
        known = known | {node.target.id for node in _own(parts) if isinstance(node, ast.NamedExpr)}
        for node in _own(parts):
            if isinstance(node, ast.Name) and not _is_stored(node) and node.id in self.everything - known:
                self._refuse(node.id, node)
        return known

    def _refuse(self, name: str, node: Any) -> NoReturn:
        raise DeclarationError(
            f"{self.system.label} ({place(self.function, node.lineno)}): on some path '{name}' has no value here, "
            f"where machine code takes 0 or what an earlier round left; give it one ahead of that, as in {name} = -1"
        )


def _is_stored(node: Any) -> bool:
    return isinstance(node.ctx, ast.Store) if hasattr(node, "ctx") else False


def _own(parts: Sequence[ast.AST]) -> list[ast.AST]:
    """All nodes of some statements or expressions, without those of functions and comprehensions in them."""
    nodes = [part for part in parts if not isinstance(part, SCOPES)]
    for node in nodes:  # grows meanwhile
        nodes += [child for child in ast.iter_child_nodes(node) if not isinstance(child, SCOPES)]
    return nodes


def _stored(parts: Sequence[ast.AST]) -> set[str]:
    """The names that some statements give a value."""
    names = {part.name for part in parts if isinstance(part, ast.FunctionDef)}
    for node in _own(parts):
        match node:
            case ast.Name(id=name) if _is_stored(node):
                names.add(name)
            case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)) | ast.ExceptHandler(name=str(name)):
                names.add(name)
        names |= {child.name for child in ast.iter_child_nodes(node) if isinstance(child, ast.FunctionDef)}
    return names
