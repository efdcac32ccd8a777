"""Errors of a mechanic that is being written: short, with the place, and soon."""

import os
import subprocess
import sys
import textwrap
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError

from outlast.ecs import DeclarationError, EngineError, Rows, Worlds, Write, kernel
from outlast.ecs.compilation.compile_errors import explained
from tests.conftest import COMPILED
from tests.helpers.toy_game import RESET, STEP, Place, Walkers, run, system_of

HOME = Path(__file__).name


def adds_text(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = join(place, e)


@kernel
def join(place: Any, e: int) -> Any:
    return place.x[e] + "s"


def makes_a_class(place: Write[Place]) -> None:
    class Empty:
        pass

    place.x[0] = Empty is None


class Gait(IntEnum):
    SLOW = 3


class Pair(NamedTuple):
    first: int
    second: int


def casts(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] = Gait.SLOW


@pytest.mark.skipif(not COMPILED, reason="about machine code")
def test_an_error_beyond_types_has_its_line() -> None:
    """Of "native lowering", which says where in another form."""
    line = casts.__code__.co_firstlineno + 2
    with pytest.raises(
        DeclarationError, match=rf"local\.casts \({HOME}, line {line}\) cannot be .*: Cannot cast IntEnum"
    ):
        run(Worlds([Walkers(), system_of(casts)], 1), RESET)


@pytest.mark.skipif(not COMPILED, reason="about machine code")
def test_numba_s_error_in_a_line() -> None:
    worlds = Worlds([Walkers(), system_of(adds_text)], 1)
    with pytest.raises(EngineError) as caught:
        run(worlds, RESET)
    first, second = str(caught.value).splitlines()
    lines = [function.__code__.co_firstlineno for function in (adds_text, join.py_func)]  # type: ignore[attr-defined]
    assert first.startswith(f"local.adds_text ({HOME}, line {lines[0] + 2}; {HOME}, line {lines[1] + 2}) cannot be co")
    assert "add(float32, Literal[str](s))" in first
    assert "NUMBA_DISABLE_JIT=1" in second
    assert type(caught.value.__cause__).__name__ == "TypingError"


def norms(place: Write[Place]) -> None:
    place.x[0] = np.linalg.norm(place.x)


def repeats(place: Write[Place]) -> None:
    place.x[0] = np.repeat(place.x, 2)[0]


def sets_a_field(place: Write[Place], rows: Rows[Place]) -> None:
    pair = Pair(1, 2)
    pair.first = rows[0]  # type: ignore[misc]


def clips(place: Write[Place]) -> None:
    place.x[0] = np.clip(place.x[0], 0.0, 1.0)


def chains(place: Write[Place]) -> None:
    if 0 < (x := place.x[0]) < 3:
        place.x[0] = x


def hides(place: Write[Place], max: Rows[Place]) -> None:  # noqa: A002
    place.x[0] = max(place.x[0], 3)  # type: ignore[operator]


def formats(place: Write[Place], rows: Rows[Place]) -> None:
    place.x[0] = len(f"{rows[0]:.2f}")


@pytest.mark.usefixtures("untried")
@pytest.mark.skipif(not COMPILED, reason="about machine code")
@pytest.mark.parametrize(
    ("function", "line", "sentence"),
    [
        (norms, 1, r"scipy .* \(ImportError\); install scipy, or write it out, as in math\.sqrt.*"),
        (repeats, 1, r"\(AssertionError\)"),
        (sets_a_field, 2, r"No definition for lowering Pair.* \(NotImplementedError\)"),
        (
            clips,
            1,
            r"No implementation of function clip .* clip\(float32, float64, float64\); .* np\.float32\(x\)",
        ),
        (chains, 0, r"the type of a part of this line cannot be determined; split the line .*\(:=\) goes ahead.*"),
        (hides, 1, r"something that is a readonly array\(int32, 1d, C\) is called .* hide that of a function, such.*"),
        (formats, 1, "format spec in f-strings not supported yet"),
    ],
)
def test_whatever_the_compiler_raises_has_the_system_the_line_and_a_sentence(
    function: Any, line: int, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors of numba, and those that its parts raise as ImportError, AssertionError and so on."""
    monkeypatch.setitem(sys.modules, "scipy", None)
    place = rf"local\.{function.__name__} \({HOME}, line {function.__code__.co_firstlineno + line}\)"
    with pytest.raises(DeclarationError, match=rf"^{place} cannot be compiled: {sentence}\ninterpret=.*$") as caught:
        run(Worlds([Walkers(), system_of(function)], 1), RESET)
    assert caught.value.__cause__ is not None


def test_colours_in_a_message_are_left_out() -> None:
    """Numba writes them if colorama is installed."""
    text = "\x1b[1m\x1b[1mFailed in nopython mode pipeline (step: frontend)\n\x1b[1mno \x1b[31msuch name\x1b[0m\n"
    text += f'\x1b[1m\nFile "{HOME}", line 3:\x1b[0m\nsource'
    (system,) = system_of(casts).systems()
    with pytest.raises(DeclarationError) as caught, explained(system):
        raise TypingError(text)
    assert str(caught.value).splitlines()[0] == f"local.casts ({HOME}, line 3) cannot be compiled: no such name"


def test_memory_that_is_lacking_is_not_an_error_of_the_system() -> None:
    (system,) = system_of(casts).systems()
    with pytest.raises(MemoryError), explained(system):
        raise MemoryError


def reads_far(place: Write[Place], rows: Rows[Place]) -> None:
    place.x[0] = place.x[rows[0] + 300]


@pytest.mark.usefixtures("untried")
@pytest.mark.skipif(not COMPILED, reason="about machine code")
def test_an_index_out_of_range_says_how_to_see_it() -> None:
    worlds = run(Worlds([Walkers(), system_of(reads_far)], 1), RESET)
    with pytest.raises(
        IndexError, match=r'; interpret=\("local\.reads_far",\) runs .* the line, the array and the index'
    ):
        run(worlds, STEP)


def test_syntax_that_numba_lacks_is_refused_where_it_would_be_compiled() -> None:
    Worlds([Walkers(), system_of(makes_a_class, compiled=False)], 1)
    if COMPILED:
        with pytest.raises(DeclarationError, match=r"local\.makes_a_class .* cannot be compiled: Use of unsupp"):
            run(Worlds([Walkers(), system_of(makes_a_class)], 1), RESET)


# ---- the loop of an edit and a run


MECHANIC = """
    import time
    from dataclasses import dataclass
    import numpy as np
    import outlast
    from outlast.components import Body, Phase, Side
    from outlast.ecs import Module, Rows, Write, number

    @dataclass(frozen=True)
    class Swamp(Module):
        drag: float = number(0.9)

    @Swamp.system(Phase.DRIVE, after="motors.drive")
    def wade(body: Write[Body], agents: Rows[Side], drag: float) -> None:
        for e in agents:
            body.velocity[e] *= drag

    scenario = outlast.variant("teams_3").with_(Swamp())
    start = time.process_time()
    try:
        outlast.make_vec(scenario, 4, seed=0).reset()
    except outlast.errors.DeclarationError as error:
        print(time.process_time() - start)
        print(error)
"""


def test_a_typo_is_reported_within_a_second(tmp_path: Path) -> None:
    """From an empty cache, where compiling would take ten seconds and more. Imports are not counted."""
    file = tmp_path / "mine.py"
    file.write_text(textwrap.dedent(MECHANIC))
    variables = os.environ | {"OUTLAST_CACHE_DIR": str(tmp_path / "cache")}
    output = subprocess.run([sys.executable, file], env=variables, capture_output=True, text=True, check=True).stdout
    seconds, message = output.splitlines()
    assert message.startswith("swamp.wade (mine.py, line 16): Body has no column 'velocity'; it has: x, y, ")
    assert float(seconds) < 1
