"""Errors of compiling a system, in one or two lines: place, problem and cure."""

import contextlib
import re
import traceback
from collections.abc import Iterator
from pathlib import Path, PurePath
from types import FunctionType
from typing import cast

import numba
from numba.core.errors import NumbaError, UnsupportedBytecodeError
from numba.core.ir import Loc

from ..declarations.system import System
from ..kernels.array_types import CUT
from ..kernels.errors import DeclarationError, EngineError, ScheduleError, place

AS_PYTHON = "interpret=(label,), or NUMBA_DISABLE_JIT=1 for all, runs systems as Python, where print and debuggers work"
PLACE = re.compile(
    r'^(?:File "|During: lowering ".*" at |.*Raised from )(.+?)(?:", line | \()(\d+)(?::|\)$)', re.MULTILINE
)
GENERATED = "<outlast unit "  # see compilation.tick.Unit
COLOURS = re.compile(r"\x1b\[[0-9;]*m")  # numba colours its messages if colorama is installed
NOISE = [  # patterns in numba's sentences, and their replacements
    (r"Function\(<.*?(\w+)(?: at 0x[0-9a-f]+)?['>]*\)", r"\1"),
    (r"Checked(array|readonly)", r"\1"),
    (r"Type of variable '\$\S+' cannot be determined.*", "the type of a part of this line cannot be determined"),
    (
        r"Invalid use of ((?:float|u?int|bool|readonly|array).*) with parameters .*",
        r"something that is a \1 is called like a function; does its name hide that of a function, such as max?",
    ),
    (r"\.? ?Raised from .*$", ""),
]
CURES = {  # by the beginning of numba's sentence
    "No implementation of function": "take other types or another function; numbers can be cast, as in np.float32(x)",
    "the type of a part": "split the line into several; an assignment (:=) goes ahead of a chain of comparisons",
    "liveness info missing": "does a loop in it never end?",
    "scipy": "install scipy, or write it out, as in math.sqrt(x * x + y * y) for a norm",
}


@contextlib.contextmanager
def explained(system: System | None) -> Iterator[None]:
    """Turn errors of any type while `system` is compiled into an EngineError, with the original error as its cause."""
    try:
        yield
    except (EngineError, MemoryError):
        raise
    except Exception as error:
        if system is None:  # the engine's own
            raise
        text, function = _text(error), cast("FunctionType", system.function)
        lines = [f"{file}, line {line}" for file, line in reversed(places(error))]
        where = f"{system.label} ({'; '.join(lines) or place(function, function.__code__.co_firstlineno)})"
        if "Cannot modify readonly array" in text:
            what = "writes an array that its parameter list declares as Read; declare it Write"
            raise ScheduleError(f"{where} {what}") from error
        if CUT in text:  # running it as Python would not help: it is wrong there, too
            raise DeclarationError(f"{where} {first_sentence(error)}") from error
        raise DeclarationError(f"{where} cannot be compiled: {first_sentence(error)}\n{AS_PYTHON}") from error


def first_sentence(error: BaseException) -> str:
    """Return the first sentence of numba's message, without the candidates tried and the calls that led there.

    For errors of other packages, the name of the type follows. A cure from CURES is added.
    """
    lines = [line.strip() for line in _text(error).splitlines()]
    lines = [line for line in lines if line and not line.startswith("Failed in ")]
    first = lines[0] if lines else ""
    if first.endswith(":") and len(lines) > 1:  # as in "... found for signature:"
        first += " " + lines[1].removeprefix(">>> ")
    if not isinstance(error, (NumbaError, UnsupportedBytecodeError)) or not first:
        first = f"{first} ({type(error).__name__})".removeprefix(" ")
    for pattern, plain in NOISE:
        first = re.sub(pattern, plain, first)
    return "; ".join([first, *(cure for start, cure in CURES.items() if first.startswith(start))])


def places(error: BaseException) -> list[tuple[str, int]]:
    """Return file and line of the calls that led to an error, innermost first, as far as numba recorded them."""
    found = [each for each in PLACE.findall(_text(error)) if each[0] != "unknown location"]
    if not found:  # not an error message of numba: take the line that its code was processing
        owners = (frame.f_locals.get("self") for frame, _ in traceback.walk_tb(error.__traceback__))
        locations = [loc for loc in (getattr(owner, "loc", None) for owner in owners) if isinstance(loc, Loc)]
        found = [(loc.filename, loc.line) for loc in reversed(locations)]
    shown = [(PurePath(file).name, int(line)) for file, line in found if not of_numba(file)]
    return [each for each in dict.fromkeys(shown) if not each[0].startswith(GENERATED)]


def of_numba(file: str) -> bool:
    """Return whether a file belongs to numba, also to the installation that compiled the cached code."""
    folder, parts = Path(numba.__file__).parent, Path(file).parts
    return any(part == "numba" and folder.joinpath(*parts[k:]).is_file() for k, part in enumerate(parts, 1))


def _text(error: BaseException) -> str:
    return COLOURS.sub("", str(error))
