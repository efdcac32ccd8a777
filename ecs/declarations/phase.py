"""Phases: the ordered stages of a tick. A game lists its phases in a subclass of PhaseBase.

class Phase(ecs.PhaseBase):
    SPAWN = When.RESET, "every body stands on a cell of its own"
    MOVE = When.STEP, "bodies have moved, contacts are resolved"
    OBSERVE = When.ALWAYS, "observations show the world as it is"
"""

from enum import Enum


class When(Enum):
    """The worlds that run a phase: those being reset, those being stepped, or both."""

    RESET = "reset"
    STEP = "step"
    ALWAYS = "reset, step"


class PhaseBase(Enum):
    """One stage of the tick: when it runs, and the postcondition of its end. Members are in order of time."""

    def __init__(self, when: When, postcondition: str) -> None:
        self.when = when
        self.postcondition = postcondition

    @property
    def position(self) -> int:
        """The position of the phase in the tick, from 0."""
        return list(type(self)).index(self)
