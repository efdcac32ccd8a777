"""The configuration of numba, all in one place.

Kernels are serial and release the GIL; Worlds runs them on threads. Division follows numpy (no exceptions inside a
kernel) and fast-math is never used: the same input must give the same bits.

Kernels from outside outlast check every index: an index out of range raises IndexError, and might crash otherwise. The
checks take time; OUTLAST_BOUNDSCHECK=0 in the environment switches them off.

The second half is for calling a C library from a kernel: functions by symbol, and loads and stores at an address.
Addresses are unchecked; only a backend that has verified the library's layout may use them.
"""

import ctypes
import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Literal, TypeAlias, TypeVar

import llvmlite.binding
import numba
import numpy as np
from numba import types
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.extending import _Intrinsic
from numba.core.lowering import Lower
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.typed_passes import NativeLowering
from numba.extending import models, register_model

from .errors import DeclarationError
from .frozen_values import is_outside

Array: TypeAlias = Any
"""A column in kernels: the numpy array of ONE world, shape (capacity, ...) or (...)."""

Real: TypeAlias = Any
"""A float32 scalar in kernels."""

OPTIONS: Any = {"nogil": True, "error_model": "numpy"}
NUMPY_AS_COMPILED: Any = {"over": "ignore", "invalid": "ignore", "divide": "ignore"}  # for np.errstate
BOUNDS_CHECKS = os.environ.get("OUTLAST_BOUNDSCHECK", "1") != "0"  # in kernels from outside of outlast
Function = TypeVar("Function", bound=Callable[..., object])
_INTERPRETED: ContextVar[bool] = ContextVar("interpreted", default=False)


@contextmanager
def interpreted() -> Iterator[None]:
    """Run the kernels that Python calls in this thread, and all that they call, as plain Python."""
    token = _INTERPRETED.set(True)
    try:
        with np.errstate(**NUMPY_AS_COMPILED):
            yield
    finally:
        _INTERPRETED.reset(token)


def options_of(function: Any) -> dict[str, Any]:
    """Return numba's options for a kernel.

    Outlast's own kernels do not allocate memory, and compile faster without reference counts; but an array that a
    kernel returns must be counted, since callers may count it. Kernels from outside check their indices.
    """
    if is_outside(function):
        return {**OPTIONS, "boundscheck": BOUNDS_CHECKS or None}  # None: by numba's setting
    returned = str(function.__annotations__.get("return", Any))
    return OPTIONS if "Any" in returned else {**OPTIONS, "_nrt": False}  # arrays are annotated with Any


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function for compiled functions to call, without wrappers for Python, which saves a sixth of the compile time.

    If Python calls it anyway, as in tests, it is compiled again with wrappers, or runs as `interpreted`.
    """

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        function = self.py_func if _INTERPRETED.get() else entry_point(self.py_func)
        return function(*arguments, **named)

    @global_compiler_lock  # type: ignore[untyped-decorator]
    def compile(self, sig: Any) -> Any:
        """Compile it for arguments of these types. Indices of arrays that are not columns are checked.

        Only systems from outside, which may create arrays, and Python pass such arrays to outlast's own kernels.
        """
        usual = self.targetoptions["boundscheck"]
        arguments, _ = normalize_signature(sig)
        self.targetoptions["boundscheck"] = (BOUNDS_CHECKS and _has_plain_arrays(arguments)) or usual
        try:
            return super().compile(sig)
        finally:
            self.targetoptions["boundscheck"] = usual


def _has_plain_arrays(kinds: Any) -> bool:
    """Return whether the types of arguments, or of tuples in them, contain an array that is not a column."""
    return any(
        type(each) is types.Array or (isinstance(each, types.BaseTuple) and _has_plain_arrays(each)) for each in kinds
    )


class _NotInlined(Lower):  # type: ignore[misc]
    def setup_function(self, fndesc: Any) -> None:
        super().setup_function(fndesc)
        self.function.attributes.add("noinline")  # otherwise LLVM inlines a function with one caller, however large


@register_pass(mutates_CFG=True, analysis_only=False)
class _LoweringOfCalls(NativeLowering):  # type: ignore[misc]
    _name = "outlast_lowering_of_calls"
    lowering_class = _NotInlined


class _CompilerOfCalls(CompilerBase):  # type: ignore[misc]
    """Numba's compiler for functions that are always called."""

    def define_pipelines(self) -> list[Any]:
        usual, passes = DefaultPassBuilder.define_nopython_pipeline(self.state), PassManager("outlast_calls")
        for each, what in usual.passes:
            passes.add_pass(_LoweringOfCalls if each is NativeLowering else each, what)
        passes.finalize()
        return [passes]


def kernel(function: Function, *, inline: Literal["always", "may", "never"] = "always") -> Function:
    """Compile `function` for the tick: it takes arrays and scalars, and writes columns in place.

    Args:
        function: A Python function in the subset of Python that numba compiles.
        inline: Whether it is compiled into every kernel that calls it; with "may", LLVM decides. A call that is not
            inlined takes about fifty instructions for each table among its arguments; inlined, only the columns used
            have a cost.
    """
    options = {**options_of(function), "forceinline": inline == "always"}
    options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    if inline == "never":
        options["pipeline_class"] = _CompilerOfCalls
    compiled = numba.njit(**options)(function)
    if compiled is not function:  # under NUMBA_DISABLE_JIT, numba returns the function
        compiled.__class__ = _Kernel
    return compiled  # type: ignore[no-any-return]


def noinline_kernel(function: Function) -> Function:
    """Compile a kernel that may be called: a large one with several callers, and scalars, not tables, as arguments."""
    return kernel(function, inline="may")


def called_kernel(function: Function) -> Function:
    """Compile a kernel that is always called: a large one that is seldom needed and would slow down other code."""
    return kernel(function, inline="never")


@functools.cache
def entry_point(function: Function) -> Function:
    """Compile `function` to be called from Python."""
    return numba.njit(**options_of(function), no_cfunc_wrapper=True)(function)  # type: ignore[no-any-return]


def compiled() -> bool:
    """Return False under NUMBA_DISABLE_JIT, when kernels run as plain Python and cannot call a C library."""
    return not numba.config.DISABLE_JIT


def load_library(file: str) -> None:
    """Let kernels link to the symbols that the shared library `file` exports. OSError if it cannot be loaded."""
    try:
        llvmlite.binding.load_library_permanently(file)
    except RuntimeError as error:
        raise OSError(str(error)) from error


def has_symbol(name: str) -> bool:
    """Return whether a kernel that calls `name` can be linked."""
    return llvmlite.binding.address_of_symbol(name) is not None


class External(types.ExternalFunction):  # type: ignore[misc]
    """A C function that kernels call. cure: what users can do if Python has to call it."""

    cure = ""

    @property
    def refusal(self) -> str:
        """The reason why Python cannot call it, with the cure."""
        return f"only machine code can call the C function {self.symbol}; {self.cure}"

    def __call__(self, *arguments: Any) -> Any:
        """Raise DeclarationError."""
        raise DeclarationError(self.refusal)


register_model(External)(models.OpaqueModel)


def external(name: str, returns: str, *arguments: str, cure: str) -> Any:
    """Return the C function `name` for use inside kernels.

    It is resolved by name when a kernel is linked, so kernels that call it can be cached on disk. Types have numba's
    names; a pointer is "intp". cure: what the user can do if the kernel has to run as Python, for the error.
    """
    kinds = [getattr(types, argument) for argument in arguments]
    function = External(name, getattr(types, returns)(*kinds))
    function.cure = cure
    return function


def callback(function: Any, *arguments: str) -> int:
    """Compile a function without result for a C library, and return its address, which stays valid.

    arguments: Numba's names of their types; a pointer is "intp".
    """
    made = numba.cfunc(types.void(*(getattr(types, each) for each in arguments)), error_model="numpy")(function)
    _CALLBACKS.append(made)
    return int(made.address)


_CALLBACKS: list[Any] = []  # kept alive


class Intrinsic(_Intrinsic):  # type: ignore[misc]
    """A function with handwritten machine code for kernels, and a plain form for Python, `python` of its definition."""

    def __call__(self, *arguments: Any) -> Any:
        """Call the plain form."""
        return self._defn.python(*arguments)  # type: ignore[attr-defined]


def intrinsic(python: Function) -> Callable[[Callable[..., Any]], Function]:
    """Decorate the definition of an intrinsic (numba's term): a function that kernels and Python can call.

    python: Its plain form, used alone under NUMBA_DISABLE_JIT.
    """

    def define(definition: Any) -> Any:
        if not compiled():
            return python
        definition.python = python
        result = Intrinsic(definition.__name__, definition)
        result._register()
        return result

    return define


def loader(kind: str) -> Any:
    """Return a function `(address) -> value` for kernels that reads one `kind` (numba's name, such as "float32")."""
    value = getattr(types, kind)

    @intrinsic(lambda address: _memory(address, kind)[()])
    def load(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], context.get_data_type(value).as_pointer())
            return builder.load(pointer)

        return value(types.intp), generate

    return load


def storer(kind: str) -> Any:
    """Return a function `(address, value)` for kernels that writes one `kind`, to which the value is cast."""
    value = getattr(types, kind)

    @intrinsic(lambda address, number: _memory(address, kind).fill(number))
    def store(typing: Any, address: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], context.get_data_type(value).as_pointer())
            builder.store(arguments[1], pointer)
            return context.get_dummy_value()

        return types.void(types.intp, value), generate

    return store


def _memory(address: int, kind: str) -> Any:
    """Return one `kind` at an address, as an array without dimensions."""
    dtype = np.dtype(kind)
    memory: Any = (ctypes.c_char * dtype.itemsize).from_address(int(address))
    return np.ndarray((), dtype, memory)
