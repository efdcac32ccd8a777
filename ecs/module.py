"""Modules: a mechanic is a frozen dataclass whose fields are its numbers; its systems are registered on it.

    @dataclass(frozen=True)
    class Poison(Module):
        dose: int = number(3, low=0)

    @Poison.system(Phase.ACT)
    def sicken(health: Write[Health], agents: Rows[Health, Venom], dose: int):
        ...

On and off means in the scenario's list of modules, or not.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

import numpy as np

from .access import Parameter, parameters
from .component import Component, Singleton
from .errors import DeclarationError, NumberError
from .jit import kernel
from .phase import Phase

if TYPE_CHECKING:
    from .layout import Layout

Function = TypeVar("Function", bound=Callable[..., Any])


def number(
    default: Any,
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float = -math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """A module's number with its range: low <= value <= high and value > above; or one of `choices`."""
    return field(default=default, metadata={"low": low, "high": high, "above": above, "choices": choices})


@dataclass(frozen=True)
class Archetype:
    """`count` entities of one kind and the birth values of their components.

    Several modules may speak of the same archetype: counts add up, components join. A count of 0 extends
    an archetype that another module declares.
    """

    name: str
    parts: tuple[Component, ...]
    count: int = 0
    alive: bool = True  # in the world right after reset


@dataclass(frozen=True)
class System:
    """One step of the tick: a kernel for ONE world, its phase, and what its parameter list declares."""

    module: str
    name: str
    phase: Phase
    function: Callable[..., Any]
    kernel: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    after: tuple[str, ...]
    before: tuple[str, ...]
    compiled: bool

    @property
    def label(self) -> str:
        """Its name everywhere: "module.system"."""
        return f"{self.module}.{self.name}"


@dataclass(frozen=True)
class Module:
    """Base of all mechanics. Checks its numbers when made; raises NumberError."""

    registered: ClassVar[list[System]] = []
    known: ClassVar[set[str]] = set()  # every system ever registered, to tell a typo from a mechanic left out
    cause: ClassVar[str] = ""  # the name of the harm this module does, if it does any

    def __init_subclass__(cls) -> None:
        cls.registered = []

    def __post_init__(self) -> None:
        for item in fields(self):
            if hasattr(Module, item.name):
                raise DeclarationError(
                    f"{self.name()} has a number '{item.name}', which hides Module.{item.name}; rename it"
                )
            value = _checked(f"{self.name()}.{item.name}", getattr(self, item.name), item.default, item.metadata)
            object.__setattr__(self, item.name, value)

    @classmethod
    def name(cls) -> str:
        """The module's name: the last part of the file it lives in, e.g. "zone"; its systems are "zone.burn"."""
        file = cls.__module__.rsplit(".", 1)[-1]
        return cls.__name__.lower() if file == "__main__" else file

    @classmethod
    def slot(cls) -> type["Module"]:
        """Modules of one slot exclude each other (free-for-all and teams, say). By default: the class itself."""
        return cls

    @classmethod
    def system(
        cls,
        phase: Phase,
        *,
        after: str | tuple[str, ...] = (),
        before: str | tuple[str, ...] = (),
        compiled: bool = True,
    ) -> Callable[[Function], Function]:
        """Register a function as a system of this module in `phase`; see ecs.access for its parameters.

        after, before: labels of systems of the same phase. compiled=False: stays Python and splits the tick there.
        """

        def register(function: Function) -> Function:
            inner = kernel(function) if compiled else function
            declared = parameters(function)
            system = System(
                cls.name(), function.__name__, phase, function, inner, declared, _names(after), _names(before), compiled
            )
            cls.registered.append(system)
            Module.known.add(system.label)
            return inner

        return register

    def systems(self) -> Iterable[System]:
        """The systems to schedule; a module may choose among its registered ones by its numbers."""
        return self.registered

    def archetypes(self) -> Iterable[Archetype]:
        """The entities this module brings or extends."""
        return ()

    def singletons(self) -> Iterable[Singleton]:
        """The per-world components this module brings."""
        return ()

    def dims(self) -> dict[str, int | str]:
        """Named dimensions; what several modules say of one name adds up. A name as value: as large as that one."""
        return {}

    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        """Memory for the Scratch parameter `name`: an array (any object for a Python system), made once a thread."""
        raise DeclarationError(f"{self.name()} has the Scratch parameter '{name}' but no scratch()")

    def check(self, layout: "Layout") -> None:
        """Refuse (NumberError) numbers that are impossible together with what the other modules bring."""

    def replace(self, **numbers: Any) -> Self:
        """A copy with other numbers; an unknown name is a NumberError that lists the known ones."""
        known = [item.name for item in fields(self)]
        for key in numbers:
            if key not in known:
                raise NumberError(f"{self.name()} has no number '{key}'; it has: {', '.join(known) or 'none'}")
        return type(self)(**{name: numbers.get(name, getattr(self, name)) for name in known})

    def value(self, name: str) -> Any:
        """The number `name` as kernels get it: a choice becomes its index."""
        for item in fields(self):
            if item.name == name:
                choices = item.metadata.get("choices")
                value = getattr(self, name)
                return choices.index(value) if choices else value
        raise DeclarationError(f"{self.name()} has no number '{name}', which one of its systems asks for")


def _names(names: str | tuple[str, ...]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else names


def _checked(name: str, value: Any, default: Any, rule: Any) -> Any:
    """`value` in the type of `default`, on which the compiled tick depends; NumberError unless it keeps to `rule`."""
    if rule.get("choices"):
        if not isinstance(value, str) or value not in rule["choices"]:
            raise NumberError(f"{name} = {value!r}: allowed are {', '.join(map(repr, rule['choices']))}")
        return value
    if isinstance(default, tuple):
        if not isinstance(value, (tuple, list)):
            raise NumberError(f"{name} = {value!r}: a tuple of numbers is needed")
        return tuple(_checked(f"{name}[{k}]", element, 0.0, rule) for k, element in enumerate(value))
    if isinstance(default, bool):
        if not isinstance(value, (bool, np.bool_)):
            raise NumberError(f"{name} = {value!r}: True or False is needed")
        return bool(value)
    whole = isinstance(default, int)
    limit = 2**31 - 1 if whole else 3e38  # what a column holds
    real = isinstance(value, (int, np.integer) if whole else (int, float, np.integer, np.floating))
    if not real or isinstance(value, bool) or not abs(value) <= limit:
        needed = "an integer below 2**31" if whole else "a finite number (below 3e38)"
        raise NumberError(f"{name} = {value!r}: {needed} is needed")
    low, high, above = (
        rule.get(key, end) for key, end in (("low", -math.inf), ("high", math.inf), ("above", -math.inf))
    )
    if not low <= value <= high or not value > above:
        least = f"> {above:g}" if math.isfinite(above) else f">= {low:g}"
        raise NumberError(f"{name} = {value!r}: must be {least}" + (f" and <= {high:g}" if math.isfinite(high) else ""))
    return int(value) if whole else float(value)
