"""Checks of what a system is registered with: see Module.system."""

from collections.abc import Callable
from pathlib import PurePath
from typing import Any

from ..declarations.component import Component
from ..declarations.system import Neighbour
from ..kernels.errors import DeclarationError


def components(label: str, given: Any) -> tuple[type[Component], ...]:
    """What was given as `needs`, as a tuple. DeclarationError if a part of it is no component."""
    needed = given if isinstance(given, tuple) else (given,)
    for each in needed:
        if not isinstance(each, type) or not issubclass(each, Component):
            raise DeclarationError(
                f"{label} has needs={each!r:.60}: the class of a component is needed, or a tuple of them, as in "
                "needs=Health"
            )
    return needed


def redefines(new: Callable[..., Any], old: Callable[..., Any]) -> bool:
    """Whether both functions come from one definition, run twice. Functions within functions never count as such."""
    same = all(getattr(new, name) == getattr(old, name) for name in ("__module__", "__qualname__", "__name__"))
    return same and "<locals>" not in new.__qualname__


def check_twice(label: str, new: Callable[..., Any], old: Callable[..., Any], same: bool) -> None:
    """Raise DeclarationError if a file has two functions of the same name, as the second would replace the first.

    The same function cannot be registered for two phases either. same: whether both are for the same phase.
    """
    if new is old and not same:
        raise DeclarationError(f"{label} is registered for two phases: write a function for each")
    one, two = old.__code__, new.__code__
    if redefines(new, old) and one.co_filename == two.co_filename and one.co_firstlineno < two.co_firstlineno:
        raise DeclarationError(
            f"{label} is there twice, in lines {one.co_firstlineno} and {two.co_firstlineno} of "
            f"{PurePath(one.co_filename).name}: call one of the functions otherwise"
        )


def neighbours(label: str, keyword: str, given: Any) -> tuple[Neighbour, ...]:
    """What was given as `after` or `before`, as a tuple. DeclarationError if a part is neither text nor component."""
    neighbours = given if isinstance(given, tuple) else (given,)
    for each in neighbours:
        if not isinstance(each, str) and not (isinstance(each, type) and issubclass(each, Component)):
            raise DeclarationError(
                f"{label} has {keyword}={each!r:.60}: a system's label, a mechanic's name or the class of a component "
                f'is needed, or a tuple of them, as in {keyword}="motors" or {keyword}=Health'
            )
    return neighbours
