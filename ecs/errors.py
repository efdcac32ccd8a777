"""Errors of the engine: each message names the thing, what was expected and the cure."""


class OutlastError(Exception):
    """Base of all errors that outlast raises; see outlast.errors."""


class EngineError(OutlastError, ValueError):
    """Base of everything the engine refuses."""


class DeclarationError(EngineError):
    """A component, module or system is declared in a way that cannot work."""


class CapacityError(EngineError):
    """More happened in a tick than the list of an event has room for."""


class AbsentError(EngineError):
    """A system made an entity alive that the episode leaves out, as its number varies from world to world."""


class RangeError(EngineError):
    """A system wrote an integer that its column cannot hold, as a row that there is not."""


class ScheduleError(EngineError):
    """The order of systems is ambiguous, contradictory, or names something unknown."""


class NumberError(EngineError):
    """A module's number is outside of what is possible."""
