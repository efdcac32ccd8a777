"""What is too close to call: there, the naive forms raise Ambiguous, or list it and go on."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

from tests.helpers.naive_world import TOLERANCE

Answer = TypeVar("Answer")

_notes: list[list[str]] = []  # one list for each `collecting` that is open, the innermost last


class Ambiguous(Exception):
    """Too close to call in float32."""


@contextlib.contextmanager
def collecting() -> Iterator[list[str]]:
    """A context in which nothing raises Ambiguous: what is too close to call is decided all the same, and listed."""
    _notes.append([])
    try:
        yield _notes[-1]
    finally:
        _notes.pop()


def ambiguous(what: str) -> None:
    """Raise Ambiguous, or list it."""
    if not _notes:
        raise Ambiguous(what)
    _notes[-1].append(what)


def unambiguous(ask: Callable[[float], Answer], offset: float = TOLERANCE) -> Answer:
    """The answer, which must be the same if everything is larger or smaller by `offset`; else see `ambiguous`."""
    answer = ask(0.0)
    if ask(offset) != answer or ask(-offset) != answer:
        ambiguous(getattr(ask, "__qualname__", "a test"))
    return answer


def within(a: float, b: float) -> bool:
    """Whether a <= b: it is if they are equal to the bit; all other numbers must not be too close."""
    return a == b or unambiguous(lambda offset: a < b + offset)
