"""The compile cache's key: a hash of everything that the machine code of a system depends on.

Numba's own key depends only on the file of the function: not on those of the kernels that it calls, on the bodies of
functions without a file (in notebooks, in closures), on globals that are frozen into machine code, or on numba's flags.
Here all references of every compiled system are followed, and a reference that cannot be followed is an error.
Docstrings and line numbers do not count.
"""

import functools
import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.config import reload_config
from numba.core.extending import _Intrinsic
from numba.core.registry import cpu_target

from ..kernels import array_check, array_types, jit, machine_code, simd
from ..kernels.errors import DeclarationError, place
from ..kernels.frozen_values import codes, references, refuse_random
from ..kernels.jit import OPTIONS, compiled
from . import arguments

# Packages and modules whose code is identified by a version that is part of the key
FOREIGN = ("numba", "llvmlite", "numpy", "math", "cmath", "operator", "builtins", "typing")
SCALARS = (int, float, complex, str, bytes, np.generic)
PLAIN = (range, np.dtype, numba.types.Type, type(None))
GENERATORS = (arguments, array_check, array_types, jit, machine_code, simd)  # modules that write or check code
SETTINGS = (  # of numba, in any of its versions: those that change machine code; of processors, see _engine
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
    """The kernels that some systems compile to machine code, and all that they refer to, as hashes.

    Args:
        kernels: By the labels of systems, their kernel, or all kernels that their units call.

    Raises:
        DeclarationError: A system refers to something whose changes could not be noticed, such as an instance of a
            user's class, or to a random generator.
    """

    def __init__(self, kernels: Mapping[str, Any]) -> None:
        self._texts: dict[FunctionType, list[str]] = {}  # the code and the constants of each
        self._callees: dict[FunctionType, list[FunctionType]] = {}
        self._dispatchers: dict[FunctionType, Any] = {}  # numba's dispatchers of those that are kernels
        self._roots: dict[str, list[FunctionType]] = {}
        for self._label, found in kernels.items():
            called = found if isinstance(found, tuple) else (found,)
            self._roots[self._label] = [self._add(kernel, self._label) for kernel in called]

    def key(self, label: str, source: str) -> str:
        """Hash of a system's kernel, its unit's source, the engine, the processor, versions and numba's flags."""
        return hashlib.sha256(f"{self._engine} {self._digest(self._roots[label])} {source}".encode()).hexdigest()[:24]

    @functools.cached_property
    def _engine(self) -> str:
        return _engine()

    def size(self, label: str) -> int:
        """Bytes of the bytecode that the machine code is made from: the more, the longer compiling takes."""
        return sum(
            len(code.co_code) for function in self._closure(self._roots[label]) for code in codes(function.__code__)
        )

    def kernel_digests(self) -> Iterator[tuple[Any, str]]:
        """Every kernel, and a hash of what its own machine code depends on."""
        for function, kernel in self._dispatchers.items():
            yield kernel, self._digest([function])

    def _digest(self, roots: Iterable[FunctionType]) -> str:
        digest = hashlib.sha256()
        for function in self._closure(roots):
            digest.update("\n".join(self._texts[function]).encode())
        return digest.hexdigest()

    def _closure(self, roots: Iterable[FunctionType]) -> Iterator[FunctionType]:
        """The functions and all that they call, each once."""
        ahead, seen = list(roots), set()
        while ahead:
            function = ahead.pop()
            if function not in seen:
                seen.add(function)
                ahead += self._callees[function]
                yield function

    def _add(self, target: Any, name: str) -> FunctionType:
        """Add a function, an intrinsic's definition or a kernel, and its references; returns the Python function."""
        function: FunctionType = getattr(target, "py_func", target)
        if function is not target:
            self._dispatchers[function] = target
        if function in self._texts:
            return function
        text = self._texts[function] = [f"{name} {sorted(getattr(target, 'targetoptions', {}).items())}"]
        self._callees[function] = []
        text.append(_code_text(function.__code__, function.__doc__))
        for inner, value in references(function):
            refuse_random(self._label, inner, value)
            text.extend(self._describe(inner, value, function))
        return function

    def _describe(self, name: str, value: Any, function: FunctionType) -> Iterator[str]:
        """A constant as text; a function is added, and described by its name."""
        if isinstance(value, Enum):
            yield f"{name}={type(value).__qualname__}.{value.name}"
            yield from self._describe(name, value.value, function)
        elif isinstance(value, numba.types.ExternalFunction):
            yield f"{name}={value.symbol}{value.sig}"
        elif isinstance(value, SCALARS):
            yield f"{name}={_exact(value)}"
        elif isinstance(value, PLAIN):
            yield f"{name}={value!r}"
        elif isinstance(value, slice):
            yield from self._describe(f"slice {name}", [value.start, value.stop, value.step], function)
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            yield f"{name}={value.dtype!r}{value.shape}{value.strides}{value.tobytes().hex()}"
        elif isinstance(value, (tuple, list)):
            yield f"{name}={type(value).__qualname__}{len(value)}{getattr(value, '_fields', '')}"
            for k, element in enumerate(value):
                yield from self._describe(f"{name}[{k}]", element, function)
        elif isinstance(value, type) and issubclass(value, BaseException):
            yield f"{name}={value.__qualname__}"  # a kernel may raise it, and does nothing else with it
        elif isinstance(value, type) and issubclass(value, Enum):
            for member in value:
                yield from self._describe(f"{name}.{member.name}", member, function)
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            yield f"{name}={value.__qualname__}{value._fields}"
            yield from self._describe(f"{name} by default", [*vars(value)["_field_defaults"].values()], function)
        elif isinstance(value, (_Intrinsic, FunctionType)) or hasattr(value, "py_func"):
            yield from self._describe_function(name, value, function)
        elif isinstance(value, ModuleType) or not _is_foreign(value) or type(value).__module__.startswith("numba."):
            raise self._refusal(name, value)
        else:
            yield f"{name}={re.sub(' at 0x[0-9a-f]+', '', repr(value))}"

    def _describe_function(self, name: str, value: Any, function: FunctionType) -> Iterator[str]:
        """A function that becomes part of the machine code, or generates a part of it (an intrinsic's)."""
        inner = value._defn if isinstance(value, _Intrinsic) else value
        if _is_foreign(inner):
            plain = getattr(inner, "py_func", inner)
            yield f"{name}={plain.__module__}.{getattr(plain, '__qualname__', '')}"
            return
        if inner is value and isinstance(value, FunctionType) and compiled() and function in self._dispatchers:
            raise self._refusal(name, value)
        yield f"{name}={inner.__qualname__}"
        self._callees[function].append(self._add(inner, name))

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


@functools.lru_cache(maxsize=4096)
def _code_text(code: CodeType, docstring: str | None) -> str:
    """The code of a function and of those nested in it as text, without its docstring."""
    lines = []
    for each in codes(code):
        described = each is code and each.co_consts[:1] == (docstring,)
        plain = [value for value in each.co_consts[described:] if not isinstance(value, CodeType)]
        constants = [sorted(map(repr, value)) if isinstance(value, frozenset) else repr(value) for value in plain]
        arguments = each.co_varnames[: each.co_argcount + each.co_kwonlyargcount]  # by which callers may name them
        handlers = each.co_exceptiontable.hex()
        lines.append(f"{each.co_qualname}{arguments}{each.co_names}{each.co_code.hex()}{handlers}{constants}")
    return "\n".join(lines)


def _exact(value: Any) -> str:
    """A scalar as text with its type and all its bits, however numpy or a class of the user's prints it."""
    if isinstance(value, np.generic):
        return f"{value.dtype!r} {value.tobytes().hex()}"
    if isinstance(value, int):
        text = hex(value)
    elif isinstance(value, (str, bytes)):
        text = (str if isinstance(value, str) else bytes).__repr__(value)
    else:
        text = np.complex128(value).tobytes().hex()
    return f"{type(value).__module__}.{type(value).__qualname__} {text}"


def _engine() -> str:
    """Hash of what all machine code depends on: versions, options, settings of numba, and the processor it is for."""
    reload_config()  # numba, too, reads the variables of the environment anew before it compiles
    processor = cpu_target.target_context.codegen().magic_tuple()
    settings = [repr(getattr(numba.config, name, None)) for name in SETTINGS]
    return hashlib.sha256(f"{_versions()} {sorted(OPTIONS.items())} {processor} {settings}".encode()).hexdigest()


@functools.cache
def _versions() -> str:
    """The code of the modules that generate code, without their files, which may be bytecode or in an archive."""
    digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {np.__version__}".encode())
    module: Any
    for module in GENERATORS:
        digest.update(_code_text(module.__loader__.get_code(module.__name__), module.__doc__).encode())
    return digest.hexdigest()


def _is_foreign(target: Any) -> bool:
    target = getattr(target, "py_func", target)
    module = getattr(target, "__module__", None) or type(getattr(target, "__self__", target)).__module__
    return str(module).partition(".")[0] in FOREIGN
