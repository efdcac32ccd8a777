"""The outside references of a function's code: the values that numba freezes into machine code."""

import dis
import functools
import inspect
from collections.abc import Callable, Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

from .errors import DeclarationError

NAMES = ("LOAD_GLOBAL", "LOAD_NAME", "LOAD_DEREF", "LOAD_CLASSDEREF")
MEMBERS = ("LOAD_ATTR", "LOAD_METHOD")
ARRAYS = ("Array", "Any")  # the last part of an annotation by the alias `Array`: as text, and what the alias stands for
NDARRAYS = ("numpy.ndarray", "np.ndarray", "<class 'numpy.ndarray'>")
RANDOM = ("random.", "numpy.random.")  # prefixes of modules with random generators that have a state


def references(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """(name as it is written, value) of everything that `function` and the functions nested in it refer to.

    Names are globals, variables of enclosing functions and defaults of parameters. For modules and classes, they are
    the members that the code accesses, at any depth ("package.module.LIMIT", "Color.RED"). Names that are not defined
    (yet) are left out.
    """
    cells = dict(zip(function.__code__.co_freevars, function.__closure__ or (), strict=True))
    for chain in _chains(function.__code__):
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


def is_outside(target: Any) -> bool:
    """Whether a function or class is from outside of this package: part of a user's mechanic."""
    return str(target.__module__).partition(".")[0] != __name__.partition(".")[0]


def annotated(cls: type) -> list[str]:
    """The names that a class itself annotates, except ClassVars."""
    return [name for name, kind in inspect.get_annotations(cls).items() if "ClassVar" not in str(kind)]


def annotated_arrays(cls: type) -> list[str]:
    """The names that a class itself annotates as `Array`, like columns, or as an array of numpy."""
    texts = {name: str(kind) for name, kind in inspect.get_annotations(cls).items()}
    return [name for name, text in texts.items() if text.rpartition(".")[2] in ARRAYS or text.startswith(NDARRAYS)]


def codes(code: CodeType) -> Iterator[CodeType]:
    """A code object and those of the functions, lambdas and comprehensions in it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from codes(constant)


def reachable(function: FunctionType, follow: Callable[[FunctionType], bool]) -> Iterator[FunctionType]:
    """A function and all Python functions that it refers to, directly or through others. follow: which ones count."""
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
    root = function.__module__.partition(".")[0]
    if isinstance(function, FunctionType):
        for each in reachable(function, lambda inner: inner.__module__.partition(".")[0] == root):
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


@functools.lru_cache(maxsize=4096)
def _chains(code: CodeType) -> tuple[tuple[str, ...], ...]:
    """All names that the code loads from outside, with their attributes: ("package", "module", "LIMIT")."""
    found: dict[tuple[str, ...], None] = {}
    for each in codes(code):
        chain: tuple[str, ...] = ()
        for instruction in dis.get_instructions(each):
            if instruction.opname in MEMBERS and chain:
                chain = (*chain, instruction.argval)
            elif instruction.opname != "EXTENDED_ARG":
                found[chain] = None
                chain = (instruction.argval,) if instruction.opname in NAMES else ()
        found[chain] = None
    found.pop((), None)
    return tuple(found)
