"""Errors of the engine. Each message says what is wrong, what was expected and how to correct it."""

import difflib
from collections.abc import Collection, Iterable
from pathlib import PurePath
from types import FunctionType


def did_you_mean(
    name: object, known: Iterable[object], *, before: str = "", after: str = "", count: int = 2, cutoff: float = 0.6
) -> str:
    """Return the part of an error message that asks whether a misspelt name was meant to be a known one; "" if none is.

    Args:
        name: The name that was given.
        known: The names that exist.
        before: What comes before the question, if there is one, such as "; ".
        after: What comes after it, such as " ".
        count: How many names are suggested at most, the closest first.
        cutoff: The least similarity of the names, from 0 to 1; see `difflib.get_close_matches`.
    """
    close = difflib.get_close_matches(str(name), list(dict.fromkeys(map(str, known))), count, cutoff)
    return f"{before}did you mean {' or '.join(close)}?{after}" if close else ""


def meant(name: object, known: Collection[str], beside: Iterable[str] = ()) -> str:
    """Return the hint for an unknown name, such as that of a number: the near misses, or else all known names.

    beside: further names that may have been meant, but are not listed.
    """
    return did_you_mean(name, [*beside, *known]) or f"known: {', '.join(known)}"


def place(function: FunctionType, line: int) -> str:
    """Return a line of a function as messages name it: "mine.py, line 12"."""
    return f"{PurePath(function.__code__.co_filename).name}, line {line}"


class OutlastError(Exception):
    """The base of all errors that outlast raises; see outlast.errors."""


class EngineError(OutlastError, ValueError):
    """The base of all errors by which the engine refuses something."""


class DeclarationError(EngineError):
    """A component, module or system is declared in a way that cannot work."""


class CapacityError(EngineError):
    """More events happened in a tick than their list has room for."""


class AbsentError(EngineError):
    """A system made an entity alive that is not in this episode, as the number of entities varies between worlds."""


class RangeError(EngineError):
    """A system wrote an integer that its column does not allow, such as a row that does not exist."""


class ScheduleError(EngineError):
    """The order of systems is ambiguous or contradictory, or names something unknown."""


class NumberError(EngineError):
    """A number of a module is unknown, or has a value that is not possible."""
