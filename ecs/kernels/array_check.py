"""A check of users' kernels, once numba knows the types: every access to an array must be one that checks its indices.

Numba checks indices of arrays. It checks neither those of flat iterators and of memory that is addressed by pointers
or strides, nor whether arrays fit where a function writes into a given one: these are refused.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numba import types
from numba.core import ir
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
        _refuse(state.func_ir.blocks.values(), state.typemap, state.calltypes, set())
        return False


def _refuse(blocks: Iterable[Any], typemap: Any, calltypes: Any, seen: set[Any]) -> None:
    """Raise NumbaTypeError at the first statement that is refused, also in the user's numba functions that are called.

    seen: the compiled functions that are checked already.
    """
    for statement in (each for block in blocks for each in block.find_insts(ir.Assign)):
        if what := _unchecked(statement, typemap, calltypes):
            raise NumbaTypeError(what, loc=statement.loc)
        for annotation in _compiled(statement, typemap, calltypes):
            if annotation not in seen:
                seen.add(annotation)
                _refuse(annotation.blocks.values(), annotation.typemap, annotation.calltypes, seen)


def _unchecked(statement: Any, typemap: Any, calltypes: Any) -> str:
    """Return what a statement does that is refused, and what to do instead; "" for nothing."""
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
    """Return what numba keeps of the function that a statement calls, if the user has compiled it."""
    value = statement.value
    if isinstance(value, ir.Expr) and value.op == "call":
        kind, signature = typemap[value.func.name], calltypes[value]
        called = kind.dispatcher if isinstance(kind, types.Dispatcher) else None
        if called and is_outside(called.py_func) and signature.args in called.overloads:
            annotation = called.overloads[signature.args].type_annotation
            if hasattr(annotation, "typemap"):  # one that numba's own cache has loaded has none
                yield annotation
