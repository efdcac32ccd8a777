"""What is too close to call: twins raise Unsure there, or note it and go on."""

import contextlib
from collections.abc import Callable, Iterator
from typing import TypeVar

from tests.twin_world import TOLERANCE

Answer = TypeVar("Answer")

_notes: list[list[str]] = []  # of those who are noting, the innermost last


class Unsure(Exception):
    """Too close to call in float32."""


@contextlib.contextmanager
def noting() -> Iterator[list[str]]:
    """Inside, nobody raises Unsure: what was too close to call is in this list, and was decided as if it were not."""
    _notes.append([])
    try:
        yield _notes[-1]
    finally:
        _notes.pop()


def doubt(what: str) -> None:
    """Raises Unsure, or notes it."""
    if not _notes:
        raise Unsure(what)
    _notes[-1].append(what)


def surely(ask: Callable[[float], Answer], hair: float = TOLERANCE) -> Answer:
    """The answer, if it is the same with everything a hair larger and a hair smaller."""
    answer = ask(0.0)
    if ask(hair) != answer or ask(-hair) != answer:
        doubt(getattr(ask, "__qualname__", "a test"))
    return answer


def within(a: float, b: float) -> bool:
    """a <= b; numbers that are equal to the bit are, others must not be too close."""
    return a == b or surely(lambda hair: a < b + hair)
