"""Systems: the functions of a mechanic that are registered on its module."""

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, TypeAlias

from ..kernels.errors import DeclarationError
from ..kernels.frozen_values import is_outside
from .access import Parameter
from .component import Component
from .phase import PhaseBase

Neighbour: TypeAlias = str | type[Component]
"""An element of after= or before=: a system's label, a mechanic's name, or a component."""


@dataclass(frozen=True)
class System:
    """One step of the tick: a kernel for one world, its phase, and the declarations of its parameters."""

    module: str
    name: str
    phase: PhaseBase
    function: Callable[..., Any]
    kernel: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    after: tuple[Neighbour, ...]
    before: tuple[Neighbour, ...]
    compiled: bool
    stream: str  # its random stream: its mechanic's stream, a dot and its own name
    slot: type  # its mechanic's slot: see Module.slot
    needs: tuple[type[Component], ...] = ()  # it is not scheduled unless the scenario has all of these
    aliases: tuple[str, ...] = ()  # its labels in the modules that it is inherited from

    @property
    def label(self) -> str:
        """Its name in schedules, messages and after/before: "module.system"."""
        return f"{self.module}.{self.name}"

    @property
    def outside(self) -> bool:
        """Return whether its function is from outside this package: part of a user's mechanic."""
        return is_outside(self.function)

    def among(self, brings: Callable[[Parameter], bool]) -> "System":
        """Return the system in a scenario: `brings` returns whether a parameter has its component there.

        Optional parameters without it get None.
        """
        found = tuple(each.among(brings) for each in self.parameters)
        return self if found == self.parameters else dataclasses.replace(self, parameters=found)

    @functools.cached_property
    def access(self) -> tuple[Parameter, ...]:
        """Its parameters, and those of its services."""
        return tuple(each for parameter in self.parameters for each in parameter.with_parts())

    def touches(self, component: type[Component], *kinds: str) -> bool:
        """Return whether it has a parameter of one of these kinds ("read", "write", "add") for the component."""
        return any(component in p.components and p.kind in kinds for p in self.access)

    def offsets(self) -> dict[tuple[type[Component], str], set[str]]:
        """Return the names of its Offsets, by component and column of the observation that has their fields."""
        owners = {
            column.key or name: (component, name)
            for parameter in self.parameters
            for component in parameter.components
            for name, column in component.columns.items()
            if column.fields
        }
        found: dict[tuple[type[Component], str], set[str]] = {}
        for name in (parameter.name for parameter in self.parameters if parameter.kind == "offset"):
            if key := max((key for key in owners if name.startswith(f"{key}_")), key=len, default=""):
                found.setdefault(owners[key], set()).add(name)
        return found

    def instead_of(self, other: "System | None") -> "System":
        """Return the system with the labels of `other` as further ones: the system of a base class that it replaces."""
        if other is None:
            return self
        return dataclasses.replace(self, aliases=tuple(dict.fromkeys((*self.aliases, other.label, *other.aliases))))

    def inherited(self, subclass: str) -> "System":
        """Return the same system as one of the mechanic `subclass`, in the same order among its own systems."""

        def renamed(neighbours: tuple[Neighbour, ...]) -> tuple[Neighbour, ...]:
            return tuple(
                f"{subclass}.{each.removeprefix(own)}" if isinstance(each, str) and each.startswith(own) else each
                for each in neighbours
            )

        own = f"{self.module}."

        return dataclasses.replace(
            self,
            module=subclass,
            after=renamed(self.after),
            before=renamed(self.before),
            aliases=tuple(dict.fromkeys((self.label, *self.aliases))),
        )


# ---- checks of the arguments of Module.system


def components(label: str, given: Any) -> tuple[type[Component], ...]:
    """Return `needs` as a tuple. DeclarationError if a part of it is not a component."""
    needed = given if isinstance(given, tuple) else (given,)
    for each in needed:
        if not isinstance(each, type) or not issubclass(each, Component):
            raise DeclarationError(
                f"{label} has needs={each!r:.60}: the class of a component is needed, or a tuple of them, as in "
                "needs=Health"
            )
    return needed


def redefines(new: Callable[..., Any], old: Callable[..., Any]) -> bool:
    """Return whether both functions come from one definition, run twice. Nested functions never count."""
    same = all(getattr(new, name) == getattr(old, name) for name in ("__module__", "__qualname__", "__name__"))
    return same and "<locals>" not in new.__qualname__


def check_twice(label: str, new: Callable[..., Any], old: Callable[..., Any], same: bool) -> None:
    """Raise DeclarationError if a file has two functions of the same name: the second would replace the first.

    The same function cannot be registered for two phases either. same: whether both are for the same phase.
    """
    if new is old and not same:
        raise DeclarationError(f"{label} is registered for two phases: write a function for each")
    one, two = old.__code__, new.__code__
    if redefines(new, old) and one.co_filename == two.co_filename and one.co_firstlineno < two.co_firstlineno:
        raise DeclarationError(
            f"{label} occurs twice, in lines {one.co_firstlineno} and {two.co_firstlineno} of "
            f"{PurePath(one.co_filename).name}: rename one of the functions"
        )


def neighbours(label: str, keyword: str, given: Any) -> tuple[Neighbour, ...]:
    """Return `after` or `before` as a tuple. DeclarationError unless it consists of texts and components."""
    neighbours = given if isinstance(given, tuple) else (given,)
    for each in neighbours:
        if not isinstance(each, str) and not (isinstance(each, type) and issubclass(each, Component)):
            raise DeclarationError(
                f"{label} has {keyword}={each!r:.60}: a system's label, a mechanic's name or the class of a component "
                f'is needed, or a tuple of them, as in {keyword}="motors" or {keyword}=Health'
            )
    return neighbours
