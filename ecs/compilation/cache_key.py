"""The compile cache's key: a hash of everything that the machine code of a system depends on.

Numba's own key depends only on the file of the function: not on the files of kernels that it calls, on functions
without a file (in notebooks, in closures), on globals that are frozen into machine code, or on numba's flags. Here all
references are followed; one that cannot be followed is an error. Docstrings and line numbers do not count.
"""

import functools
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.config import reload_config
from numba.core.extending import _Intrinsic
from numba.core.registry import cpu_target

from ..kernels import array_types, jit, machine_code, simd
from ..kernels.errors import DeclarationError, place
from ..kernels.frozen_values import codes, described, read_code, references, refuse_random, root
from ..kernels.jit import OPTIONS, compiled
from . import arguments

# Packages and modules whose code is identified by a version that is part of the key
FOREIGN = ("numba", "llvmlite", "numpy", "math", "cmath", "operator", "builtins", "typing")
GENERATORS = (arguments, array_types, jit, machine_code, simd)  # modules that write code
SETTINGS = (  # of numba, in any of its versions: those that change machine code; of processors, see CacheKey
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
    "DEBUG_JIT",
    "DEBUG_NRT",
    "DEBUG_NRT_STACK_LIMIT",
    "EXTEND_VARIABLE_LIFETIMES",
    "LLVM_REFPRUNE_FLAGS",
    "LLVM_REFPRUNE_PASS",
    "LOOP_VECTORIZE",
    "NRT_STATS",
    "OPT",
    "SLP_VECTORIZE",
    "USE_LEGACY_TYPE_SYSTEM",
    "USING_SVML",
)


class CacheKey:
    """Kernels by the labels of systems, one or several each, and all their references, as hashes.

    DeclarationError if a system refers to a random generator, or to an object whose changes cannot be detected.
    """

    def __init__(self, kernels: Mapping[str, Any]) -> None:
        self._texts: dict[FunctionType, list[str]] = {}  # the code and the constants of each
        self._callees: dict[FunctionType, list[FunctionType]] = {}
        self._dispatchers: dict[FunctionType, Any] = {}  # numba's dispatchers of those that are kernels
        self._roots: dict[str, list[FunctionType]] = {}
        for self._label, found in kernels.items():
            called = found if isinstance(found, tuple) else (found,)
            self._roots[self._label] = [self._add(kernel) for kernel in called]

    def key(self, label: str, source: str) -> str:
        """Hash of a system's kernels, of its unit's source, and of the dependencies of all machine code."""
        return hashlib.sha256(f"{self._engine} {self._digest(self._roots[label])} {source}".encode()).hexdigest()[:24]

    @functools.cached_property
    def _engine(self) -> str:
        """Return the dependencies of all machine code: versions, options, settings of numba, and the processor."""
        reload_config()  # numba also rereads the environment before it compiles
        processor = cpu_target.target_context.codegen().magic_tuple()
        settings = [repr(getattr(numba.config, name, None)) for name in SETTINGS]
        return f"{_versions()} {sorted(OPTIONS.items())} {processor} {settings}"

    def size(self, label: str) -> int:
        """Return the size of the bytecode in bytes: compile time grows with it."""
        return sum(len(function.__code__.co_code) for function in self._closure(self._roots[label]))

    def kernel_digests(self) -> Iterator[tuple[Any, str]]:
        """Yield every kernel, and a hash of the dependencies of its own machine code."""
        for function, kernel in self._dispatchers.items():
            yield kernel, self._digest([function])

    def _digest(self, roots: Iterable[FunctionType]) -> str:
        digest = hashlib.sha256()
        for function in self._closure(roots):
            digest.update("\n".join(self._texts[function]).encode())
        return digest.hexdigest()

    def _closure(self, roots: Iterable[FunctionType]) -> Iterator[FunctionType]:
        """Yield the functions and all functions that they call, each once."""
        ahead, seen = list(roots), set()
        while ahead:
            function = ahead.pop()
            if function not in seen:
                seen.add(function)
                ahead += self._callees[function]
                yield function

    def _add(self, target: Any) -> FunctionType:
        """Add a function, an intrinsic's definition or a kernel, and its references. Return the Python function."""
        function: FunctionType = getattr(target, "py_func", target)
        if function is not target:
            self._dispatchers[function] = target
        if function in self._texts:
            return function
        text = self._texts[function] = [repr(sorted(getattr(target, "targetoptions", {}).items()))]
        self._callees[function] = []
        text.append(read_code(function.__code__)[0])
        for inner, value in references(function):
            refuse_random(self._label, inner, value)
            text.extend(described(inner, value, functools.partial(self._describe, function)))
        return function

    def _describe(self, function: FunctionType, name: str, value: Any) -> Iterator[str]:
        """Describe a value that is not a constant; functions that become or generate machine code are added."""
        if isinstance(value, numba.types.ExternalFunction):
            yield f"{name}={value.symbol}{value.sig}"
        elif isinstance(value, type) and issubclass(value, BaseException):
            yield f"{name}={value.__qualname__}"  # a kernel can only raise it
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            yield f"{name}={value.__qualname__}{value._fields}"
            defaults = tuple(vars(value)["_field_defaults"].values())
            yield from described(f"{name} by default", defaults, functools.partial(self._describe, function))
        elif isinstance(value, (_Intrinsic, FunctionType)) or hasattr(value, "py_func"):
            inner = value._defn if isinstance(value, _Intrinsic) else value
            own = root(inner) not in FOREIGN
            yield f"{name}={'' if own else inner.__module__}.{getattr(inner, '__qualname__', '')}"
            if own:
                if inner is value and isinstance(value, FunctionType) and compiled() and function in self._dispatchers:
                    raise self._refusal(name, value)
                self._callees[function].append(self._add(inner))
        elif isinstance(value, numba.types.Type):
            yield f"{name}={value!r}"
        elif isinstance(value, ModuleType) or root(value) not in FOREIGN or type(value).__module__.startswith("numba."):
            raise self._refusal(name, value)
        else:
            yield f"{name}={re.sub(' at 0x[0-9a-f]+', '', repr(value))}"

    def _refusal(self, name: str, value: Any) -> DeclarationError:
        if isinstance(value, ModuleType):
            cure = f"write out what is used of it, as in {name}.LIMIT"
        elif isinstance(value, FunctionType):
            cure = "put @outlast.ecs.kernel above it"
        else:
            cure = "take numbers, tuples and arrays of them, members of an Enum, or a number of the mechanic"
        code = getattr(value, "__code__", None)
        shown = place(value, code.co_firstlineno) if code else f"{re.sub(' at 0x[0-9a-f]+', '', repr(value)):.60}"
        return DeclarationError(
            f"{self._label} refers to {name}, {type(value).__name__} {shown}: machine code would keep it as it "
            f"is now, and a change of it would go unnoticed; {cure}"
        )


@functools.cache
def _versions() -> str:
    """Return the code of the modules that generate code; their files may be bytecode, or in an archive."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {np.__version__}".encode())
    module: Any
    for module in GENERATORS:
        for each in codes(module.__loader__.get_code(module.__name__)):  # `read_code` would take longer
            constants = [value for value in each.co_consts if not isinstance(value, CodeType)]
            plain = [sorted(map(repr, value)) if isinstance(value, frozenset) else value for value in constants]
            digest.update(repr((each.co_code, each.co_names, plain)).encode())
    return digest.hexdigest()
