"""The one place where numba is configured.

Kernels are serial and release the GIL; threads belong to the runner. Division follows numpy (no exceptions
inside a kernel) and fast-math is never used: the same input must give the same bits.

The second half is for calling a C library from a kernel: its functions by symbol, and loads and stores at an
address. Nothing checks an address; only a bridge that has verified the library's layout may use them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import llvmlite.binding
import numba
from numba import types
from numba.extending import intrinsic

Function = TypeVar("Function", bound=Callable[..., object])


def kernel(function: Function, cache: bool = False, inner: bool = False) -> Function:
    """Compile `function` for the tick: arrays and scalars in, columns written in place.

    cache: keep machine code on disk. inner: never called from Python, so the wrappers for that are left out, which
    saves a tenth of the time to compile a tick.
    """
    return numba.njit(  # type: ignore[no-any-return]
        nogil=True, error_model="numpy", cache=cache, no_cpython_wrapper=inner, no_cfunc_wrapper=inner
    )(function)


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
