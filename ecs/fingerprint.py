"""What machine code depends on, as one number: the name of the folder in which a tick's code is kept.

numba's own key knows the generated file of the tick only; not the files of the kernels it calls, nor the bodies of
functions that have no file (a notebook's, a closure's), nor the globals that it freezes, nor its own flags. Here
everything that a compiled system refers to is followed, and what cannot be followed is refused.
"""

import functools
import hashlib
import re
from collections.abc import Iterable, Iterator
from enum import Enum
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.extending import _Intrinsic

from .errors import DeclarationError
from .jit import compiled
from .references import codes, references, refuse_random
from .system import System

# Packages and modules whose versions stand for them
FOREIGN = ("numba", "llvmlite", "numpy", "math", "cmath", "operator", "builtins", "typing")
PLAIN = (bool, int, float, complex, str, bytes, range, slice, np.generic, np.dtype, numba.types.Type, type(None))
FLAGS_ASIDE = ("NUM_THREADS", "NUMBA_NUM_THREADS", "NUMBA_DEFAULT_NUM_THREADS", "CACHE_DIR")  # change no machine code


class Code:
    """All that some systems compile to machine code: their functions, and what those refer to.

    Args:
        systems: Systems of a schedule. Those that stay Python are left out.

    Raises:
        DeclarationError: A system refers to something whose changes nobody would notice, such as an object of a class
            of one's own, or to a random generator.
    """

    def __init__(self, systems: Iterable[System]) -> None:
        self.texts: dict[FunctionType, list[str]] = {}
        self.calls: dict[FunctionType, list[FunctionType]] = {}
        self.kernels: dict[FunctionType, Any] = {}  # as numba compiles them
        self.roots: list[FunctionType] = []
        for system in systems:
            if system.compiled:
                self._label = system.label
                self.roots.append(self._follow(system.kernel, system.label))

    @functools.cached_property
    def fingerprint(self) -> str:
        """Hash of all of it, of the engine's and the game's sources, of versions and of numba's flags."""
        package = Path(__file__).parent.parent
        digest = hashlib.sha256(f"{numba.__version__} {llvmlite.__version__} {np.__version__}".encode())
        for name, value in sorted(vars(numba.config).items()):
            if name.isupper() and name not in FLAGS_ASIDE and isinstance(value, (bool, int, float, str)):
                digest.update(f"{name}={value}".encode())
        for path in sorted(
            path for folder in ("ecs", "components", "systems") for path in (package / folder).rglob("*.py")
        ):
            digest.update(path.name.encode() + path.read_bytes())
        digest.update(self._digest(self.roots).encode())
        return digest.hexdigest()[:16]

    def stamps(self) -> Iterator[tuple[Any, str]]:
        """Every kernel, and a hash of all that its own machine code depends on."""
        for function, kernel in self.kernels.items():
            yield kernel, self._digest([function])

    def _digest(self, roots: Iterable[FunctionType]) -> str:
        digest, ahead, seen = hashlib.sha256(), list(roots), set()
        while ahead:
            function = ahead.pop()
            if function not in seen:
                seen.add(function)
                ahead += self.calls[function]
                digest.update("\n".join(self.texts[function]).encode())
        return digest.hexdigest()

    def _follow(self, thing: Any, name: str) -> FunctionType:
        """Take up a function, an intrinsic's definition or a kernel; returns the Python function."""
        function: FunctionType = getattr(thing, "py_func", thing)
        if function is not thing:
            self.kernels[function] = thing
        if function in self.texts:
            return function
        text = self.texts[function] = [f"{name} {sorted(getattr(thing, 'targetoptions', {}).items())}"]
        self.calls[function] = []
        for code in codes(function.__code__):
            plain = [constant for constant in code.co_consts if not isinstance(constant, CodeType)]
            constants = [sorted(map(repr, each)) if isinstance(each, frozenset) else repr(each) for each in plain]
            text.append(f"{code.co_qualname}{code.co_names}{code.co_code.hex()}{constants}")
        for inner, value in references(function):
            refuse_random(self._label, inner, value)
            text.extend(self._described(inner, value, function))
        return function

    def _described(self, name: str, value: Any, function: FunctionType) -> Iterator[str]:
        """A constant by its value; what is compiled, too, is taken up and stands here by its name."""
        if isinstance(value, Enum):
            yield f"{name}={type(value).__qualname__}.{value.name}"
            yield from self._described(name, value.value, function)
        elif isinstance(value, numba.types.ExternalFunction):
            yield f"{name}={value.symbol}{value.sig}"
        elif isinstance(value, PLAIN):
            yield f"{name}={value!r}"
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            yield f"{name}={value.dtype}{value.shape}{value.tobytes().hex()}"
        elif isinstance(value, (tuple, list)):
            yield f"{name}={type(value).__qualname__}{len(value)}"
            for k, element in enumerate(value):
                yield from self._described(f"{name}[{k}]", element, function)
        elif isinstance(value, type) and issubclass(value, BaseException):
            yield f"{name}={value.__qualname__}"  # a kernel may raise it, and does nothing else with it
        elif isinstance(value, type) and issubclass(value, Enum):
            yield f"{name}={[(member.name, member.value) for member in value]}"
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            yield f"{name}={value.__qualname__}{value._fields}"
            yield from self._described(f"{name} by default", [*vars(value)["_field_defaults"].values()], function)
        elif isinstance(value, (_Intrinsic, FunctionType)) or hasattr(value, "py_func"):
            yield from self._compiled(name, value, function)
        elif isinstance(value, ModuleType) or not _is_foreign(value) or type(value).__module__.startswith("numba."):
            raise self._refusal(name, value)
        else:
            yield f"{name}={re.sub(' at 0x[0-9a-f]+', '', repr(value))}"

    def _compiled(self, name: str, value: Any, function: FunctionType) -> Iterator[str]:
        """A function that becomes part of the machine code, or that writes a part of it (an intrinsic's)."""
        inner = value._defn if isinstance(value, _Intrinsic) else value
        if _is_foreign(inner):
            yield name
            return
        if inner is value and isinstance(value, FunctionType) and compiled() and function in self.kernels:
            raise self._refusal(name, value)
        yield f"{name}={inner.__qualname__}"
        self.calls[function].append(self._follow(inner, name))

    def _refusal(self, name: str, value: Any) -> DeclarationError:
        if isinstance(value, ModuleType):
            cure = f"write out what is used of it, as in {name}.LIMIT"
        elif isinstance(value, FunctionType):
            cure = "put @outlast.ecs.kernel above it"
        else:
            cure = "take numbers, tuples and arrays of them, members of an Enum, or a number of the mechanic"
        return DeclarationError(
            f"{self._label} refers to {name}, {type(value).__name__} {value!r:.60}: machine code would keep it as it "
            f"is now, and a change of it would go unnoticed; {cure}"
        )


def _is_foreign(thing: Any) -> bool:
    thing = getattr(thing, "py_func", thing)
    module = getattr(thing, "__module__", None) or type(getattr(thing, "__self__", thing)).__module__
    return str(module).partition(".")[0] in FOREIGN
