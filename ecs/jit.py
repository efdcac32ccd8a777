"""The configuration of numba, all in one place.

Kernels are serial and release the GIL; Worlds runs them on threads. Division follows numpy (no exceptions inside a
kernel) and fast-math is never used: the same input must give the same bits.

The second half is for calling a C library from a kernel: its functions by symbol, and loads and stores at an
address. Nothing checks an address; only a backend that has verified the library's layout may use them.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import llvmlite.binding
import numba
from numba import types
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

OPTIONS: Any = {"nogil": True, "error_model": "numpy"}
Function = TypeVar("Function", bound=Callable[..., object])


def is_engine_code(function: Any) -> bool:
    """Whether a function is outlast's own, or else from outside of it: a user's, whose kernels are checked more."""
    return str(function.__module__).partition(".")[0] == __name__.partition(".")[0]


def options_of(function: Any) -> dict[str, Any]:
    """Numba's options for a kernel. Outlast's own allocate no memory: without reference counts they compile faster."""
    return {**OPTIONS, "_nrt": False} if is_engine_code(function) else OPTIONS


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """A function that compiled functions call, without the wrappers for Python (a sixth of the time to compile).

    When Python calls it nevertheless, such as a test, it is compiled once more, with them.
    """

    def __call__(self, *arguments: Any) -> Any:
        return entry_point(self.py_func)(*arguments)


def kernel(function: Function, *, inline: bool = True) -> Function:
    """Compile `function` for the tick: arrays and scalars in, columns written in place.

    Args:
        function: A Python function in the subset that numba compiles.
        inline: Compile it into every kernel that calls it. A call that is not inlined takes some fifty instructions for
            each table among its arguments; inlined, only the columns that are used cost anything.

    Returns:
        The function; under NUMBA_DISABLE_JIT as it is.
    """
    options = {**options_of(function), "forceinline": inline, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    compiled = numba.njit(**options)(function)
    if compiled is not function:  # it is under NUMBA_DISABLE_JIT
        compiled.__class__ = _Kernel
    return compiled  # type: ignore[no-any-return]


def noinline_kernel(function: Function) -> Function:
    """A kernel that is not inlined: a large one with several callers, whose arguments are scalars, not tables."""
    return kernel(function, inline=False)


@functools.cache
def entry_point(function: Function) -> Function:
    """Compile `function` to be called from Python."""
    return numba.njit(**options_of(function), no_cfunc_wrapper=True)(function)  # type: ignore[no-any-return]


def compiled() -> bool:
    """False under NUMBA_DISABLE_JIT, when kernels run as plain Python and cannot call a C library."""
    return not numba.config.DISABLE_JIT


def load_library(file: str) -> None:
    """Let kernels link to the symbols that the shared library `file` exports; OSError if it cannot be loaded."""
    try:
        llvmlite.binding.load_library_permanently(file)
    except RuntimeError as error:
        raise OSError(str(error)) from error


def has_symbol(name: str) -> bool:
    """Whether a kernel that calls `name` would link."""
    return llvmlite.binding.address_of_symbol(name) is not None


def external(name: str, returns: str, *arguments: str) -> Any:
    """The C function `name` for use inside kernels; types are numba's names, pointers are "intp".

    Resolved by name when a kernel is linked, so kernels that call it can be cached on disk.
    """
    kinds = [getattr(types, argument) for argument in arguments]
    return types.ExternalFunction(name, getattr(types, returns)(*kinds))


def loader(kind: str) -> Any:
    """A function `(address) -> value` for kernels that reads one `kind` (numba's name, as "float32")."""
    value = getattr(types, kind)

    @intrinsic  # type: ignore[untyped-decorator]
    def load(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], context.get_data_type(value).as_pointer())
            return builder.load(pointer)

        return value(types.intp), generate

    return load


def storer(kind: str) -> Any:
    """A function `(address, value)` for kernels that writes one `kind`; the value is cast to it."""
    value = getattr(types, kind)

    @intrinsic  # type: ignore[untyped-decorator]
    def store(typing: Any, address: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            pointer = builder.inttoptr(arguments[0], context.get_data_type(value).as_pointer())
            builder.store(arguments[1], pointer)
            return context.get_dummy_value()

        return types.void(types.intp, value), generate

    return store
