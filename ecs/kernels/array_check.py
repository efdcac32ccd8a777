"""A check of users' kernels, once numba knows the types, for what it compiles although it cannot be meant.

Every access to an array must be one that checks its indices. Numba checks neither those of flat iterators and of memory
that is addressed by pointers or strides, nor whether arrays fit where a function writes into a given one. Where no path
has given a variable a value, machine code takes 0 or what an earlier round of a loop left; and a loop that nothing
leaves cannot be interrupted.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import types
from numba.core import ir
from numba.core.analysis import compute_cfg_from_blocks
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.errors import NumbaTypeError
from numba.core.typed_passes import NopythonTypeInference

from .frozen_values import is_outside

UNCHECKED = "nothing checks"  # a part of all these errors
UNCHECKED_TYPES: dict[Any, str] = {  # by numba's type: what the code takes, and the cure
    types.NumpyFlatType: f"takes .flat of an array, whose indices {UNCHECKED}; index the array, or its .ravel()",
    types.ArrayCTypes: f"takes .ctypes of an array, an address that {UNCHECKED}; index the array",
    types.RawPointer: f"takes an address, which {UNCHECKED}; index an array",
    types.CPointer: f"takes an address, which {UNCHECKED}; index an array",
}
UNCHECKED_CALLS: dict[Any, str] = {
    np.lib.stride_tricks.as_strided: f"calls as_strided, whose shape {UNCHECKED}; take slices, or reshape",
    np.delete: f"calls np.delete, whose indices {UNCHECKED}; take what is to stay, as in a[stays]",
}
ENDLESS = "this loop never ends, and nothing interrupts machine code; leave it by break or return"
AS_LEFT = "has no value here, where machine code takes 0 or what an earlier round left; give it one ahead of that"
NO_VALUE = "on some path '{0}' " + AS_LEFT + ", as in {0} = -1"
INPUTS = {np.outer: 2}  # functions that pass on a further argument to a ufunc as its output


class CheckedCompiler(CompilerBase):  # type: ignore[misc]
    """Numba's compiler, with the check."""

    def define_pipelines(self) -> list[Any]:
        """Return numba's usual passes, and the check behind type inference."""
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_Check, NopythonTypeInference)
        passes.finalize()
        return [passes]


@register_pass(mutates_CFG=False, analysis_only=True)
class _Check(AnalysisPass):  # type: ignore[misc]
    _name = "outlast_array_check"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        _refuse(state.func_ir.blocks, state.typemap, state.calltypes, set())
        return False


def _refuse(blocks: dict[int, Any], typemap: Any, calltypes: Any, seen: set[Any]) -> None:
    """Raise NumbaTypeError at the first statement that is refused, also in the user's numba functions that are called.

    seen: the compiled functions that are checked already.
    """
    loops = compute_cfg_from_blocks(blocks).loops()
    for loop in loops.values():
        if not loop.exits:
            raise NumbaTypeError(ENDLESS, loc=blocks[loop.header].loc)
    for label, block in blocks.items():
        for statement in block.find_insts(ir.Assign):
            what, value = _unchecked(statement, typemap, calltypes), statement.value
            if isinstance(value, ir.Expr) and value.op == "phi" and ir.UNDEFINED in value.incoming_values:
                rounds = _has_a_round(loops.get(label), statement.target, blocks, typemap)
                what = "" if rounds else NO_VALUE.format(statement.target.unversioned_name)
            if what:
                raise NumbaTypeError(what, loc=statement.loc)
            for annotation in _compiled(statement, typemap, calltypes):
                if annotation not in seen:
                    seen.add(annotation)
                    _refuse(annotation.blocks, annotation.typemap, annotation.calltypes, seen)


def _has_a_round(loop: Any, variable: Any, blocks: dict[int, Any], typemap: Any) -> bool:
    """Whether a variable is used only behind a loop that gives it a value, over a range of constants, not empty."""
    inside = [each for label in loop.body for each in blocks[label].body] if loop else []
    if sum(variable.name in [used.name for used in each.list_vars()] for each in inside) != 1:  # its own assignment
        return False
    values = {each.target.name: each.value for block in blocks.values() for each in block.find_insts(ir.Assign)}
    ahead = [each.value for each in blocks[loop.header].find_insts(ir.Assign)]
    source: Any = next((each for each in ahead if getattr(each, "op", "") == "iternext"), None)
    while isinstance(source, ir.Var) or getattr(source, "op", "") in ("iternext", "getiter"):
        source = values[source.name if isinstance(source, ir.Var) else source.value.name]
    if getattr(source, "op", "") != "call" or getattr(typemap[source.func.name], "typing_key", None) is not range:
        return False
    bounds: list[Any] = [getattr(typemap[each.name], "literal_value", None) for each in source.args]
    return None not in bounds and 0 not in bounds[2:] and len(range(*bounds)) > 0


def _unchecked(statement: Any, typemap: Any, calltypes: Any) -> str:
    """What a statement does that is refused, and what to do instead; "" for nothing."""
    kind, value = typemap[statement.target.name], statement.value
    for refused, what in UNCHECKED_TYPES.items():
        if isinstance(kind, refused):
            return what
    key = getattr(kind, "typing_key", None)
    if what := next((what for function, what in UNCHECKED_CALLS.items() if function is key), ""):
        return what
    if isinstance(value, ir.Expr) and value.op == "call":
        called: Any = getattr(typemap[value.func.name], "typing_key", None)
        most = next((most for function, most in INPUTS.items() if function is called), getattr(called, "nin", None))
        if most is not None and len(value.args) > most:
            name = called.__name__
            return f"lets {name} write into an array, whose shape {UNCHECKED}; write a[...] = {name}(...)"
    sides = (value.lhs, value.rhs) if isinstance(value, ir.Expr) and value.op == "inplace_binop" else ()
    if sides and all(isinstance(typemap[each.name], types.Array) for each in sides):
        name = value.immutable_fn.__name__
        return f"changes an array by another one, whose shape {UNCHECKED} ({name}); write a[...] = a + b"
    return ""


def _compiled(statement: Any, typemap: Any, calltypes: Any) -> Iterator[Any]:
    """What numba keeps of the function that a statement calls, if the user has compiled it."""
    value = statement.value
    if isinstance(value, ir.Expr) and value.op == "call":
        kind, signature = typemap[value.func.name], calltypes[value]
        called = kind.dispatcher if isinstance(kind, types.Dispatcher) else None
        if called and is_outside(called.py_func) and signature.args in called.overloads:
            annotation = called.overloads[signature.args].type_annotation
            if hasattr(annotation, "typemap"):  # one that numba's own cache has loaded has none
                yield annotation
