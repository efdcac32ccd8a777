"""A check that every variable of a function has a value wherever it is used.

Where one has none, Python raises UnboundLocalError. Machine code raises nothing: the variable is 0 there, or holds what
an earlier round of a loop left in it.
"""

from typing import Any

from numba.core import ir
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.ir_utils import find_const, get_definition, guard

from .abstract_values import rounds


def first_unassigned(code: Any) -> tuple[str, int] | None:
    """Find a variable that is used although on some path to that line nothing was assigned to it.

    Args:
        code: The intermediate representation of a function, numba's FunctionIR.

    Returns:
        Its name and the line of the first such use; None if there is none.
    """
    blocks = code.blocks
    graph = compute_cfg_from_blocks(blocks)
    certain = {label: block.terminator.falsebr for label, block in blocks.items() if guard(_has_a_round, code, block)}
    loops = graph.loops()
    assigned = {label: _assigned(block) for label, block in blocks.items()}
    everything = set[str]().union(*assigned.values())
    before = {label: set(everything) for label in graph.nodes()}
    before[graph.entry_point()] = set()

    def after(label: int, following: int) -> set[str]:
        """What has a value behind a block, on the way to another one."""
        known = before[label]
        if certain.get(label) == following and label in loops:  # a round is behind that way
            known = set.intersection(
                *(before[each] | assigned[each] for each, _ in graph.predecessors(label) if each in loops[label].body)
            )
        return known | assigned[label]

    changed = True
    while changed:
        changed = False
        for label in graph.nodes() - {graph.entry_point()}:
            known = set.intersection(*(after(each, label) for each, _ in graph.predecessors(label)))
            changed |= known != before[label]
            before[label] = known
    uses = [use for label in graph.nodes() for use in _unassigned(blocks[label], before[label])]
    return min(uses, key=lambda use: use[1], default=None)


def _has_a_round(code: Any, block: Any) -> bool:
    """Whether a block is the head of a loop over a range of constants that is not empty."""
    found = block.terminator.cond if isinstance(block.terminator, ir.Branch) else None
    for operation in ("pair_second", "iternext", "getiter"):
        found = get_definition(code, found)
        if not isinstance(found, ir.Expr) or found.op != operation:
            return False
        found = found.value
    call = get_definition(code, found)
    if not isinstance(call, ir.Expr) or call.op != "call" or find_const(code, call.func) is not range or call.kws:
        return False
    return bool(rounds([find_const(code, each) for each in call.args]))


def _assigned(block: Any) -> set[str]:
    return {statement.target.name for statement in block.body if isinstance(statement, ir.Assign)}


def _unassigned(block: Any, known: set[str]) -> list[tuple[str, int]]:
    """Name and line of each use of a variable without a value in a block. known: names with a value ahead of it."""
    known, found = set(known), list[tuple[str, int]]()
    for statement in block.body:
        if isinstance(statement, ir.Del):
            continue
        used = statement.value if isinstance(statement, ir.Assign) else statement
        variables = [used] if isinstance(used, ir.Var) else used.list_vars() if hasattr(used, "list_vars") else []
        found += [
            (each.unversioned_name, statement.loc.line)
            for each in variables
            if each.name not in known and not each.is_temp
        ]
        if isinstance(statement, ir.Assign):
            known.add(statement.target.name)
    return found
