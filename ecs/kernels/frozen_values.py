"""Values that code refers to: values that numba freezes into machine code, and that distinguish games."""

import dis
import functools
import hashlib
import inspect
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from .errors import DeclarationError

NAMES = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF")
MEMBERS = ("LOAD_ATTR", "LOAD_METHOD")
ARRAYS = ("Array", "Any")  # the last part of an annotation by the alias `Array`: as text, and resolved
NDARRAYS = ("numpy.ndarray", "np.ndarray", "<class 'numpy.ndarray'>")
RANDOM = ("random.", "numpy.random.")  # prefixes of modules with random generators that have a state
LIBRARIES = frozenset({*sys.stdlib_module_names, "llvmlite", "numba", "numpy"})  # identified by their versions
Other = Callable[[str, Any], Iterator[str]]


def references(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """(name as it is written, value) of everything that `function` and the functions nested in it refer to.

    Names are globals, variables of enclosing functions and defaults of parameters. For modules and classes, they are
    the members that the code accesses, at any depth ("package.module.LIMIT", "Color.RED"). Names that are not (yet)
    defined are left out.
    """
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    for chain in read_code(function.__code__)[1]:
        try:
            value = cells[chain[0]].cell_contents if chain[0] in cells else function.__globals__[chain[0]]
        except (KeyError, ValueError):  # a builtin, a variable of the function's own, or an empty cell
            continue
        depth = 1
        while depth < len(chain) and isinstance(value, (ModuleType, type)) and hasattr(value, chain[depth]):
            value = getattr(value, chain[depth])
            depth += 1
        yield ".".join(chain[:depth]), value
    defaults = (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values())
    yield from ((f"default {k} of {function.__name__}", value) for k, value in enumerate(defaults))


def root(target: Any) -> str:
    """Return the top-level package of a function, a class or an instance."""
    module = getattr(target, "__module__", None) or type(getattr(target, "__self__", target)).__module__
    return str(module).partition(".")[0]


def is_outside(target: Any) -> bool:
    """Return whether a function or class is from outside this package: part of a user's mechanic."""
    return root(target) != root(is_outside)


def is_library(target: Any) -> bool:
    """Return whether an object is from a library, whose code is not followed."""
    return root(target) in LIBRARIES


def annotated(cls: type) -> list[str]:
    """Return the names that a class itself annotates, except ClassVars."""
    return [name for name, kind in inspect.get_annotations(cls).items() if "ClassVar" not in str(kind)]


def annotated_arrays(cls: type) -> list[str]:
    """Return the names that a class itself annotates as `Array`, like columns, or as an array of numpy."""
    texts = {name: str(kind) for name, kind in inspect.get_annotations(cls).items()}
    return [name for name, text in texts.items() if text.rpartition(".")[2] in ARRAYS or text.startswith(NDARRAYS)]


def codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object and those of the functions, lambdas and comprehensions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def reachable(function: FunctionType, follow: Callable[[FunctionType], bool]) -> Iterator[FunctionType]:
    """Yield a function and all Python functions that it refers to, directly or through others.

    follow: returns whether a function is followed.
    """
    ahead, seen = [function], {function}
    while ahead:
        yield (one := ahead.pop())
        for _, value in references(one):
            inner = getattr(value, "py_func", value)
            if isinstance(inner, FunctionType) and inner not in seen and follow(inner):
                seen.add(inner)
                ahead.append(inner)


def check_random(function: Callable[..., Any], label: str) -> None:
    """Raise DeclarationError if the system `label` draws from a random generator that has a state."""
    if isinstance(function, FunctionType):
        for each in reachable(function, lambda inner: root(inner) == root(function)):
            for name, value in references(each):
                refuse_random(label, name, value)


def refuse_random(label: str, name: str, value: Any) -> None:
    """Raise DeclarationError if `value`, which `label` refers to by `name`, is Python's or numpy's random generator."""
    if isinstance(value, ModuleType):
        homes = [value.__name__]
    else:
        homes = [str(getattr(value, "__module__", "")), type(value).__module__]
        homes += [type(getattr(value, "__self__", None)).__module__]
    if any(f"{home}.".startswith(RANDOM) for home in homes):
        raise DeclarationError(
            f"{label} refers to {name}, a random generator whose state depends on what ran before: the same seed would "
            "not give the same episodes. Take a parameter annotated Random and draw with outlast.ecs.kernels.random"
        )


def described(name: str, value: Any, other: Other) -> Iterator[str]:
    """Describe a constant exactly, independently of how numpy or a user's class prints it.

    other: describes values that are not constants, such as functions.
    """
    if isinstance(value, Enum):
        yield f"{name}={type(value).__qualname__}.{value.name}"
        yield from described(name, value.value, other)
    elif isinstance(value, type) and issubclass(value, Enum):
        for member in value:
            yield from described(f"{name}.{member.name}", member, other)
    elif isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:  # float64 is also a float
        yield f"{name}={type(value).__name__} {value.dtype!r}{value.shape}{value.strides}{value.tobytes().hex()}"
    elif isinstance(value, (int, float, complex, str, bytes)):
        yield f"{name}={type(value).__module__}.{type(value).__qualname__} {_exact(value)}"
    elif isinstance(value, (range, np.dtype, type(None))):
        yield f"{name}={value!r}"
    elif isinstance(value, slice):
        yield from described(f"slice {name}", (value.start, value.stop, value.step), other)
    elif isinstance(value, (tuple, list)):
        yield f"{name}={type(value).__qualname__}{len(value)}{getattr(value, '_fields', '')}"
        for k, element in enumerate(value):
            yield from described(f"{name}[{k}]", element, other)
    else:
        yield from other(name, value)


def _exact(value: complex | str | bytes) -> str:
    if isinstance(value, int):
        return hex(value)
    if isinstance(value, (str, bytes)):
        return (str if isinstance(value, str) else bytes).__repr__(value)
    return np.complex128(value).tobytes().hex()


@functools.lru_cache(maxsize=4096)
def read_code(code: CodeType) -> tuple[str, tuple[tuple[str, ...], ...]]:
    """Read the code of a function and of those nested in it.

    Returns:
        A hash of its instructions with names and constants, but without docstrings and line numbers; and all names that
        it loads from outside, with their attributes: ("package", "module", "LIMIT").
    """
    parts, found = list[Any](), dict[tuple[str, ...], None]()
    for each in codes(code):
        parts.append((each.co_varnames[: each.co_argcount + each.co_kwonlyargcount], each.co_exceptiontable))
        chain: tuple[str, ...] = ()
        for instruction in dis.get_instructions(each):
            name, value = instruction.opname, instruction.argval
            if name == "EXTENDED_ARG":
                continue
            if name in MEMBERS and chain:
                chain = (*chain, value)
            else:
                found[chain] = None
                chain = (value,) if name in NAMES else ()
            if type(value) is CodeType:  # also comes as one of `codes`
                value = value.co_name
            elif type(value) is frozenset:
                value = sorted(map(repr, value))
            parts.append((name, value))
        found[chain] = None
    found.pop((), None)
    return hashlib.sha256(repr(parts).encode()).hexdigest(), tuple(found)
