"""Machine code: numba compiles functions to object files; later processes only need a loader to run them.

Numba finishes each function as if Python called it: it also optimises and translates the callees, although each caller
has its own, inlined copy of them. Here callees stay LLVM code (`Library`); only the requested function is linked with
them, optimised and translated. All symbols but its own are internal, so that objects of different versions of a game
can be loaded side by side.

Only this file uses the internal parts of numba that produce and load machine code. Other files use its representation
of functions, to check them, and its interface for extensions. These parts are those of the versions in pyproject.toml.
"""

import ctypes
import pickle
import sys
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import llvmlite.binding
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.codegen import JITCodeLibrary, RuntimeLinker
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import UnsupportedError
from numba.core.registry import cpu_target
from numba.extending import intrinsic

ADDRESS = "numba.dynamic.globals."  # prefix of numba's variables that hold an address of this process
ENVIRONMENTS: list[Any] = []  # numba's environments of loaded code, kept alive because the code has their addresses


class Code(NamedTuple):
    """A compiled function: its symbol, the object file, and its dependencies."""

    symbol: str
    image: bytes
    constants: dict[str, list[Any]]  # for its calls of Python (print), by symbol
    externals: list[str]  # symbols of the C functions that it calls
    portable: bool = True  # whether other processes can load it; not with addresses of it, as of a large array


class Library(JITCodeLibrary):  # type: ignore[misc]
    """One function as LLVM code, with the libraries of its callees."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.environments: dict[str, Any] = {}
        self._merged: Any = None
        self._machine_code: Any = None

    def finalize(self) -> None:
        """Do nothing: the function is finished together with its caller."""
        self._finalized = True

    @property
    def codegen(self) -> Any:
        """The object on which numba calls `set_env`: this one, which keeps the environments."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Keep the environment of the function."""
        self.environments[name] = environment
        if self._machine_code:
            self._codegen.set_env(name, environment)

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of the function, which is also translated since Python calls it; 0 if it is not here."""
        if not any(function.name == name for function in _defined(self._final_module)):
            return 0
        if self._machine_code is None:
            self._machine_code = JITCodeLibrary(self._codegen, self.name)
            self._machine_code.add_llvm_module(self._complete_module())
            self._machine_code.finalize()
        return int(self._machine_code.get_pointer_to_function(name))

    def _complete_module(self) -> Any:
        """Return the function with its callees, for translation."""
        module = self._get_module_for_linking().clone()
        for function in _defined(self._final_module):
            module.get_function(function.name).linkage = "external"  # otherwise it is left out, as nothing calls it
        return module

    def serialize_using_object_code(self) -> tuple[str, str, bytes]:
        """Return the content for numba's own cache, if a user's function requests that cache."""
        return self.name, "bitcode", self._complete_module().as_bitcode()

    @classmethod
    def _unserialize(cls, codegen: Any, state: Any) -> Any:
        """Load a function from numba's own cache: it is complete, so it becomes an ordinary library of numba."""
        codegen._library_class = JITCodeLibrary
        try:
            return JITCodeLibrary._unserialize(codegen, state)
        finally:
            codegen._library_class = cls

    def _get_module_for_linking(self) -> Any:
        """Return the function with all its callees, for numba's own libraries, which link only one level of callees."""
        if self._merged is None:
            self._merged = super()._get_module_for_linking().clone()
            for library in self._callees():
                self._merged.link_in(_own_module(library), preserve=True)
        return self._merged

    def _callees(self) -> list[JITCodeLibrary]:
        """Return the libraries of all callees, callers first: LLVM links only functions that are already called."""
        found, seen = list[JITCodeLibrary](), set[JITCodeLibrary]()

        def visit(library: JITCodeLibrary) -> None:
            seen.add(library)
            for each in library._linking_libraries if isinstance(library, Library) else ():
                if each not in seen:
                    visit(each)
            found.insert(0, library)

        visit(self)
        return found[1:]

    def emit(self, symbol: str) -> Code:
        """Link the function `symbol` with its callees, optimise and translate it."""
        callees = self._callees()
        for library in callees:
            self._final_module.link_in(_own_module(library), preserve=True)
        for value in self._final_module.global_variables:
            if value.name.startswith(RuntimeLinker.PREFIX):
                raise UnsupportedError("a function that it calls calls itself: write a loop")
        for function in _defined(self._final_module):
            if function.name != symbol:
                function.linkage = "internal"
        environments = dict[str, Any]()
        for library in (self, *callees):
            environments |= getattr(library, "environments", {})
        for value in self._final_module.global_variables:
            if value.name in environments:
                value.linkage = "linkonce_any"  # left out if unused by calls of Python
        for _ in range(2):  # the first pass inlines; the second vectorizes loops in inlined code
            self._optimize_final_module()
        constants: dict[str, list[Any]] = {}
        for value in self._final_module.global_variables:
            if value.name in environments:
                values = list(environments[value.name].consts)
                value.name = f"{symbol}.{len(constants)}"
                constants[value.name] = values
        # Functions that are not inlined may have lost arguments. Numba's own copy must have another name: the loader
        # uses a known symbol, even an internal one, for each later copy.
        for k, function in enumerate(each for each in _defined(self._final_module) if each.name != symbol):
            function.name = f"{symbol}:{k}"
        self._final_module.verify()
        declared = [function.name for function in self._final_module.functions if function.is_declaration]
        externals = [name for name in declared if not name.startswith("llvm.")]
        portable = not any(value.name.startswith(ADDRESS) for value in self._final_module.global_variables)
        return Code(symbol, self._codegen._tm.emit_object(self._final_module), constants, externals, portable)


def _defined(module: Any) -> list[Any]:
    """Return the functions that LLVM code defines."""
    return [function for function in module.functions if not function.is_declaration]


def _own_module(library: Any) -> Any:
    """Return the LLVM code of a library; of a Library, without that of its callees."""
    return JITCodeLibrary._get_module_for_linking(library)


def compile_function(function: Callable[..., None], options: dict[str, Any], *, python: bool = False) -> Code:
    """Compile a function of int64 arguments, with options of numba.njit. Raises errors of numba.

    python: whether Python calls it (see `as_python`), or other compiled code.
    """
    codegen = cpu_target.target_context.codegen()
    with global_compiler_lock:
        before, codegen._library_class = codegen._library_class, Library
        try:
            dispatcher = numba.njit(**options, no_cpython_wrapper=not python, no_cfunc_wrapper=True)(function)
            dispatcher.compile((types.int64,) * function.__code__.co_argcount)
            (overload,) = dispatcher.overloads.values()
            names = overload.fndesc
            code: Code = overload.library.emit(names.llvm_cpython_wrapper_name if python else names.llvm_func_name)
            return code
        finally:
            codegen._library_class = before


def load_code(codes: Iterable[Code]) -> list[int]:
    """Load compiled functions and return their addresses. OSError if this process lacks a C function they call."""
    codes = list(codes)
    engine = cpu_target.target_context.codegen()._engine
    with global_compiler_lock:
        if _missing(codes):
            cpu_target.target_context.refresh()  # adds numba's own C functions, such as those that allocate memory
        if missing := _missing(codes):
            raise OSError(f"compiled code calls C functions that are not loaded: {', '.join(missing)}")
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


def _missing(codes: Iterable[Code]) -> list[str]:
    """Return the C functions without a known address in this process; a call of them would be to address 0."""
    names = {name for code in codes for name in code.externals}
    return sorted(name for name in names if llvmlite.binding.address_of_symbol(name) is None)


def as_python(address: int) -> Any:
    """Return the function at `address`, compiled for Python; it runs without the GIL."""
    environment = numba._dynfunc.Environment({})
    return numba._dynfunc.make_function(sys.modules[__name__], "compiled", "", address, environment, ())


@intrinsic  # type: ignore[untyped-decorator]
def call_address(typing: Any, address: Any, arguments: Any, first: Any, last: Any, error: Any) -> Any:
    """Call the compiled function at `address` with the three int64 that follow, in compiled code.

    error: the address of an int64 that gets the address of the exception, if the function raises one. Returns its
    status: 0 and -2 mean success, all others an exception.
    """

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        word, pointer = ir.IntType(64), ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer, pointer, word, word, word])
        function = builder.inttoptr(values[0], kind.as_pointer())
        result = builder.bitcast(cgutils.alloca_once(builder, pointer), pointer)
        raised = builder.inttoptr(values[4], pointer)
        return builder.sext(builder.call(function, [result, raised, *values[1:4]]), word)

    return types.int64(*[types.int64] * 5), generate


@intrinsic  # type: ignore[untyped-decorator]
def prefetch(typing: Any, address: Any) -> Any:
    """Begin to load the cache line at an address into the second-level cache, in compiled code."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer, word = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, word, word, word])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [builder.inttoptr(values[0], pointer), *(word(each) for each in (0, 2, 1))])
        return context.get_dummy_value()

    return types.void(types.intp), generate


def exception_at(address: int) -> tuple[type[BaseException], tuple[Any, ...], str]:
    """Return the exception of a compiled function: type, arguments, file and line ("" if numba lost them).

    Arguments that are not constants are "...": only Python shows them. address: result of `call_address` at `error`.
    """
    data = ctypes.c_void_p.from_address(address).value
    size = ctypes.c_int32.from_address(address + ctypes.sizeof(ctypes.c_void_p)).value
    if not data:
        return RuntimeError, ("an exception of compiled code, of which nothing is known",), ""
    kind, arguments, place = pickle.loads(ctypes.string_at(data, size))
    arguments = tuple("..." if isinstance(each, ir.Constant) else each for each in arguments or ())
    return kind, arguments, f"{place[1]}, line {place[2]}" if place else ""


@intrinsic  # type: ignore[untyped-decorator]
def atomic_add(typing: Any, address: Any, number: Any) -> Any:
    """Add to the int64 at an address, and return its old value, in compiled code: atomic for all threads."""
    return types.int64(types.int64, types.int64), lambda context, builder, signature, values: builder.atomic_rmw(
        "add", _word(builder, values[0]), values[1], "seq_cst"
    )


@intrinsic  # type: ignore[untyped-decorator]
def atomic_load(typing: Any, address: Any) -> Any:
    """Read an int64 that other threads write, in compiled code."""
    return types.int64(types.int64), lambda context, builder, signature, values: builder.load_atomic(
        _word(builder, values[0]), "seq_cst", 8
    )


@intrinsic  # type: ignore[untyped-decorator]
def atomic_store(typing: Any, address: Any, number: Any) -> Any:
    """Write an int64 that other threads read, in compiled code."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        builder.store_atomic(values[1], _word(builder, values[0]), "seq_cst", 8)
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), generate


def _word(builder: Any, address: Any) -> Any:
    return builder.inttoptr(address, ir.IntType(64).as_pointer())
