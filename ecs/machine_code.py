"""Machine code: functions compiled by numba to object files, and the loader that later processes need in its place.

Numba finishes each function as if Python called it: its callees get optimised and translated, too, although each of
their callers has its own, inlined copy. Here callees stay LLVM code (`Library`); only a function that is asked for is
linked with them, optimised and translated. All symbols but its own are internal, so that objects of different versions
of a game can be loaded side by side.

This file is the only one that relies on the inner workings of numba (of the versions that pyproject.toml allows).
"""

import ctypes
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import llvmlite.binding
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic

ENVIRONMENTS: list[Any] = []  # of loaded code, which refers to them


class Code(NamedTuple):
    """A compiled function: its symbol, the object file, and the constants that its Python calls (print) need."""

    symbol: str
    image: bytes
    constants: dict[str, list[Any]]


class Library(JITCodeLibrary):  # type: ignore[misc]
    """One function as LLVM code, with the libraries of its callees."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.environments: dict[str, Any] = {}
        self._merged: Any = None
        self._machine_code: Any = None

    def finalize(self) -> None:
        """Nothing: it is finished where a caller is."""
        self._finalized = True

    @property
    def codegen(self) -> Any:
        """Where numba sets environments; here they are kept."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Keep the environment of the function."""
        self.environments[name] = environment
        if self._machine_code:
            self._codegen.set_env(name, environment)

    def get_pointer_to_function(self, name: str) -> int:
        """Translate it after all, for a function that Python calls, too."""
        if not any(function.name == name and not function.is_declaration for function in self._final_module.functions):
            return 0
        if self._machine_code is None:
            self._machine_code = JITCodeLibrary(self._codegen, self.name)
            self._machine_code.add_llvm_module(self._get_module_for_linking().clone())
            self._machine_code.finalize()
        return int(self._machine_code.get_pointer_to_function(name))

    def _get_module_for_linking(self) -> Any:
        """The function with its callees, for numba's own libraries, which link no more than one level."""
        if self._merged is None:
            self._merged = super()._get_module_for_linking().clone()
            for library in self._callees():
                self._merged.link_in(_own_module(library), preserve=True)
        return self._merged

    def _callees(self) -> list[JITCodeLibrary]:
        found: dict[int, JITCodeLibrary] = {id(self): self}
        ahead = [self]
        while ahead:
            for library in ahead.pop()._linking_libraries:
                if id(library) not in found:
                    found[id(library)] = library
                    if isinstance(library, Library):
                        ahead.append(library)
        return list(found.values())[1:]

    def emit(self, symbol: str) -> Code:
        """Link, optimise and translate it."""
        callees = self._callees()
        for library in callees:
            self._final_module.link_in(_own_module(library), preserve=True)
        for function in self._final_module.functions:
            if not function.is_declaration and function.name != symbol:
                function.linkage = "internal"
        environments = {
            name: environment
            for library in (self, *callees)
            for name, environment in getattr(library, "environments", {}).items()
        }
        for value in self._final_module.global_variables:
            if value.name in environments:
                value.linkage = "linkonce_any"  # left out where no Python call needs it
        for _ in range(2):  # the first inlines; loops of what it inlined are vectorized by the second
            self._optimize_final_module()
        constants: dict[str, list[Any]] = {}
        for value in self._final_module.global_variables:
            if value.name in environments:
                values = list(environments[value.name].consts)
                value.name = f"{symbol}.{len(constants)}"
                constants[value.name] = values
        self._final_module.verify()
        return Code(symbol, self._codegen._tm.emit_object(self._final_module), constants)


def _own_module(library: Any) -> Any:
    """The LLVM code of a library, which a Library has without that of its callees."""
    return JITCodeLibrary._get_module_for_linking(library)


@contextmanager
def _unfinished_callees() -> Iterator[None]:
    codegen = cpu_target.target_context.codegen()
    before = codegen._library_class
    codegen._library_class = Library
    try:
        yield
    finally:
        codegen._library_class = before


def compile_function(function: Callable[..., None], options: dict[str, Any], *, python: bool = False) -> Code:
    """Compile a function of int64 arguments. Raises what numba raises.

    Args:
        function: The function.
        options: Numba's.
        python: Whether it is for Python (see `as_python`) or for other compiled code.
    """
    with global_compiler_lock, _unfinished_callees():
        dispatcher = numba.njit(**options, no_cpython_wrapper=not python, no_cfunc_wrapper=True)(function)
        dispatcher.compile((types.int64,) * function.__code__.co_argcount)
        (overload,) = dispatcher.overloads.values()
        names = overload.fndesc
        code: Code = overload.library.emit(names.llvm_cpython_wrapper_name if python else names.llvm_func_name)
        return code


def load_code(codes: Iterable[Code]) -> list[int]:
    """The addresses of compiled functions."""
    codes = list(codes)
    engine = cpu_target.target_context.codegen()._engine
    with global_compiler_lock:
        for code in codes:
            engine._ee.add_object_file(llvmlite.binding.ObjectFileRef.from_data(code.image))
        engine.finalize_object()
        for code in codes:
            for name, values in code.constants.items():
                if address := engine.get_global_value_address(name):
                    environment = numba._dynfunc.Environment({})
                    environment.consts.extend(values)
                    ENVIRONMENTS.append(environment)
                    ctypes.c_void_p.from_address(address).value = id(environment)
        return [engine.get_function_address(code.symbol) for code in codes]


def as_python(address: int) -> Any:
    """The function at `address`, compiled for Python; it runs without the GIL."""
    environment = numba._dynfunc.Environment({})
    return numba._dynfunc.make_function(sys.modules[__name__], "compiled", "", address, environment, ())


@intrinsic  # type: ignore[untyped-decorator]
def call_address(typing: Any, address: Any, arguments: Any, first: Any, last: Any, error: Any) -> Any:
    """In compiled code, call a compiled function of three arguments.

    error: the address of an int64 that gets the address of its exception, if it raises one.

    Returns:
        Its status: 0 and -2 are success, others are those of exceptions.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        word, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer, pointer, word, word, word])
        function = builder.inttoptr(values[0], kind.as_pointer())
        result = builder.bitcast(cgutils.alloca_once(builder, pointer), pointer)
        raised = builder.inttoptr(values[4], pointer)
        return builder.sext(builder.call(function, [result, raised, *values[1:4]]), word)

    return types.int64(*[types.int64] * 5), generate


def exception_at(address: int) -> tuple[type[BaseException], tuple[Any, ...], str]:
    """The exception that a compiled function raised: type, arguments, and the file and line, where numba kept them."""
    data = ctypes.c_void_p.from_address(address).value
    size = ctypes.c_int32.from_address(address + ctypes.sizeof(ctypes.c_void_p)).value
    if not data:
        return RuntimeError, ("an exception of compiled code, of which nothing is known",), ""
    kind, arguments, place = pickle.loads(ctypes.string_at(data, size))
    return kind, tuple(arguments or ()), f"{place[1]}, line {place[2]}" if place else ""
