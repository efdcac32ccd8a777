"""Errors of the engine: each message names the thing, what was expected and the cure."""

import difflib
from collections.abc import Iterable


def did_you_mean(
    name: object, known: Iterable[object], *, before: str = "", after: str = "", count: int = 2, cutoff: float = 0.6
) -> str:
    """What a misspelt name may have been meant to be: the part of a message that asks.

    Args:
        name: What was given.
        known: What there is.
        before: What stands before the question, as "; ", if there is one.
        after: What stands behind it, as " ".
        count: How many names are offered at most, the closest first.
        cutoff: How alike the two are at least, from 0 to 1, see `difflib.get_close_matches`.

    Returns:
        The question, or "" if nothing is close.
    """
    close = difflib.get_close_matches(str(name), list(dict.fromkeys(map(str, known))), count, cutoff)
    return f"{before}did you mean {' or '.join(close)}?{after}" if close else ""


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
