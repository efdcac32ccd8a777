"""Errors of a mechanic that is being written: short, and with the place."""

import sys
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.np import arrayobj

from outlast.ecs import DeclarationError, EngineError, Rows, Worlds, Write, kernel
from outlast.ecs.compilation.compile_errors import explained, of_numba
from tests.conftest import COMPILED, compiled_only
from tests.helpers.mechanics import written
from tests.helpers.toy_game import RESET, STEP, Place, Walkers, run, system_of

HOME = Path(__file__).name
USED = np, Rows, Write  # by lines of systems


def adds_text(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = join(place, e)


@kernel
def join(place: Any, e: int) -> Any:
    return place.x[e] + "s"


class Gait(IntEnum):
    SLOW = 3


class Pair(NamedTuple):
    first: int
    second: int


def lines(*body: str, rows: str = "rows") -> Callable[..., None]:
    """A system of these lines, from the second one of mine.py on."""
    text = "\n    ".join([f"def act(place: Write[Place], {rows}: Rows[Place]) -> None:", *body])
    act: Callable[..., None] = written(text, globals())
    return act


@compiled_only
def test_numba_s_error_in_a_line() -> None:
    with pytest.raises(EngineError) as caught:
        run(Worlds([Walkers(), system_of(adds_text)], 1), RESET)
    first, second = str(caught.value).splitlines()
    lines = [function.__code__.co_firstlineno for function in (adds_text, join.py_func)]
    assert first.startswith(f"local.adds_text ({HOME}, line {lines[0] + 2}; {HOME}, line {lines[1] + 2}) cannot be co")
    assert "add(float32, Literal[str](s))" in first
    assert "NUMBA_DISABLE_JIT=1" in second
    assert type(caught.value.__cause__).__name__ == "TypingError"


@kernel
def factorial(n: int) -> int:
    return 1 if n < 2 else n * factorial(n - 1)


@pytest.mark.usefixtures("untried")
@compiled_only
@pytest.mark.parametrize(
    ("function", "line", "sentence"),
    [
        (lines("place.x[0] = np.linalg.norm(place.x)"), 2, r"scipy .* \(ImportError\); install scipy, or write.*"),
        (lines("place.x[0] = np.repeat(place.x, 2)[0]"), 2, r"\(AssertionError\)"),
        (lines("Pair(1, 2).first = 3"), 2, r"No definition for lowering Pair.* \(NotImplementedError\)"),
        (lines("for e in rows:", "    place.x[e] = Gait.SLOW"), 3, "Cannot cast IntEnum.*"),  # of "native lowering"
        (lines("place.x[0] = np.clip(place.x[0], 0.0, 1.0)"), 2, r"No .* clip\(float32, float64, float64\); .* np\..*"),
        (lines("place.x[0] = 1 if 0 < (x := place.x[0]) < 3 else x"), 1, r"the type of .*; split .*\(:=\) goes .*"),
        (lines("place.x[0] = max(place.x[0], 3)", rows="max"), 2, "something that is .* is called .* hide that of .*"),
        (lines('place.x[0] = len(f"{place.x[0]:.2f}")'), 2, "format spec in f-strings not supported yet"),
        (lines("place.x[0] = factorial(5)"), 1, ".* calls itself: write a loop.*"),
    ],
)
def test_whatever_the_compiler_raises_has_the_system_the_line_and_a_sentence(
    function: Any, line: int, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of numba, and those that its parts raise as ImportError, AssertionError and so on."""
    monkeypatch.setitem(sys.modules, "scipy", None)
    place = rf"local\.act \(mine\.py, line {line}.*\)"
    with pytest.raises(DeclarationError, match=rf"^{place} cannot be compiled: {sentence}\ninterpret=.*$") as caught:
        run(Worlds([Walkers(), system_of(function)], 1), RESET)
    assert caught.value.__cause__ is not None


def test_colours_in_a_message_are_left_out() -> None:
    """Numba writes them if colorama is installed."""
    text = "\x1b[1m\x1b[1mFailed in nopython mode pipeline (step: frontend)\n\x1b[1mno \x1b[31msuch name\x1b[0m\n"
    text += f'\x1b[1m\nFile "{HOME}", line 3:\x1b[0m\nsource'
    (system,) = system_of(adds_text).systems()
    with pytest.raises(DeclarationError) as caught, explained(system):
        raise TypingError(text)
    assert str(caught.value).splitlines()[0] == f"local.adds_text ({HOME}, line 3) cannot be compiled: no such name"


def test_memory_that_is_lacking_is_not_an_error_of_the_system() -> None:
    (system,) = system_of(adds_text).systems()
    with pytest.raises(MemoryError), explained(system):
        raise MemoryError


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize(
    ("line", "error", "words"),
    [
        ("place.x[0] = place.x[rows[0] + 300]", IndexError, r'; interpret=\("local\.act",\) runs .* the line, the'),
        ("if place.x > 0: place.x[0] = 1", ValueError, r"^(local\.act: )?The truth value of an array with more"),
        ('if rows[0] == 0: raise ValueError("row", rows[0])', ValueError, r"local\.act \(mine\.py, line 2\): row .*"),
    ],
)
@compiled_only
def test_what_machine_code_raises_names_the_system_and_a_line_of_its_own(
    line: str, error: type[Exception], words: str
) -> None:
    worlds = run(Worlds([Walkers(), system_of(lines(line))], 1), RESET)
    with pytest.raises(error, match=words):
        run(worlds, STEP)


@pytest.mark.parametrize(
    ("file", "own"),
    [
        (arrayobj.__file__, True),
        ("/another/venv/lib/site-packages/numba/np/arrayobj.py", True),  # that has compiled what is in the cache
        ("/home/me/numba/game.py", False),
        ("/home/me/numba", False),
    ],
)
def test_files_of_numba_are_known_wherever_it_is_installed(file: str, own: bool) -> None:
    assert of_numba(file) is own


def test_syntax_that_numba_lacks_is_refused_where_it_would_be_compiled() -> None:
    makes_a_class = lines("class Empty: pass", "place.x[0] = Empty is None")
    Worlds([Walkers(), system_of(makes_a_class, compiled=False)], 1)
    if COMPILED:
        with pytest.raises(DeclarationError, match=r"local\.act .* cannot be compiled: Use of unsupp"):
            run(Worlds([Walkers(), system_of(makes_a_class)], 1), RESET)
