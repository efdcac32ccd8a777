"""Errors of the engine. Each message contains the fault, what was expected and the cure."""

import difflib
from collections.abc import Collection, Iterable
from pathlib import PurePath
from types import FunctionType


def did_you_mean(
    name: object, known: Iterable[object], *, before: str = "", after: str = "", count: int = 2, cutoff: float = 0.6
) -> str:
    """Return the part of an error message that suggests known names for a misspelt one; "" if none is close.

    Args:
        name: The unknown name.
        known: The existing names.
        before: Text before the question, if any, such as "; ".
        after: Text after it, such as " ".
        count: Maximum number of suggestions, the closest first.
        cutoff: The least similarity of the names, from 0 to 1; see `difflib.get_close_matches`.
    """
    close = difflib.get_close_matches(str(name), list(dict.fromkeys(map(str, known))), count, cutoff)
    return f"{before}did you mean {' or '.join(close)}?{after}" if close else ""


def meant(name: object, known: Collection[str], beside: Iterable[str] = ()) -> str:
    """Return the hint for an unknown name, such as that of a number: similar names, or otherwise all known names.

    beside: further candidates, which are not listed.
    """
    return did_you_mean(name, [*beside, *known]) or f"known: {', '.join(known)}"


def place(function: FunctionType, line: int) -> str:
    """Return a line of a function in the form for messages: "mine.py, line 12"."""
    return f"{PurePath(function.__code__.co_filename).name}, line {line}"


class OutlastError(Exception):
    """The base of all errors that outlast raises; see outlast.errors."""


class EngineError(OutlastError, ValueError):
    """The base of the errors of the engine."""


class DeclarationError(EngineError):
    """A component, module or system has an invalid declaration."""


class CapacityError(EngineError):
    """A tick had more events than the capacity of their list."""


class AbsentError(EngineError):
    """A system made an entity alive that is not in this episode, where the number of entities varies between worlds."""


class RangeError(EngineError):
    """A system wrote an integer that its column does not allow, such as a row that does not exist."""


class ScheduleError(EngineError):
    """The order of systems is ambiguous or contradictory, or has an unknown name."""


class NumberError(EngineError):
    """A number of a module is unknown, or has an impossible value."""
