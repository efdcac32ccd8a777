"""Phases: the ordered stages of a tick. A game lists its phases in a subclass of PhaseBase.

class Phase(ecs.PhaseBase):
    SPAWN = When.RESET, "every body stands on a cell of its own"
    MOVE = When.STEP, "bodies have moved, contacts are resolved"
    OBSERVE = When.ALWAYS, "observations show the world as it is"
"""

from collections.abc import Sequence
from enum import Enum, EnumType
from typing import Any, NoReturn


class When(Enum):
    """The worlds that go through a phase: those being reset, those being stepped, or both."""

    RESET = "reset"
    STEP = "step"
    ALWAYS = "reset, step"


class _Phases(EnumType):
    """The metaclass of phases. Its error for an unknown phase says which enumeration has one of that name."""

    def __getattr__(cls, name: str) -> NoReturn:
        if name.startswith("_"):
            raise AttributeError(name)
        if members := list[Any](cls):
            known = ", ".join(member.name for member in members)
            raise AttributeError(f"{cls.__module__}.{cls.__qualname__} has no phase {name}; it has: {known}")
        kinds: Sequence[type[Enum]] = cls.__subclasses__()
        found = [f"{kind.__module__}.{kind.__qualname__}" for kind in kinds if name in kind.__members__]
        raise AttributeError(
            f"{cls.__module__}.{cls.__qualname__} is the base class of phases and has none itself. "
            + (f"{' and '.join(found)} has {name}" if found else "")
            + ("; for" if found else "For")
            + f' a game of your own, list its phases: class Phase(ecs.PhaseBase): {name} = When.STEP, "all have moved"'
        )


class PhaseBase(Enum, metaclass=_Phases):
    """One stage of the tick: when it runs and what is true when it ends. Members are in order of time."""

    def __init__(self, when: When, postcondition: str) -> None:
        self.when = when
        self.postcondition = postcondition

    @property
    def position(self) -> int:
        """The position of the phase in the tick, from 0."""
        return list(type(self)).index(self)
