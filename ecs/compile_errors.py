"""Numba's errors when it cannot compile a system, in a line or two: where, what, and what to do about it."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import PurePath

from numba.core.errors import NumbaError, UnsupportedBytecodeError

from .columns import CUT
from .errors import DeclarationError, EngineError, ScheduleError
from .system import System

AS_PYTHON = "interpret=(label,), or NUMBA_DISABLE_JIT=1 for all, runs systems as Python, where print and debuggers work"
PLACE = re.compile(r'^(?:File "|During: lowering ".*" at )(.+?)(?:", line | \()(\d+)(?::|\)$)', re.MULTILINE)
GENERATED = "<outlast unit "  # see ecs.tick.Unit


@contextlib.contextmanager
def explained(system: System | None) -> Iterator[None]:
    """Turn numba's errors while `system` is compiled into an EngineError, with the original error as its cause."""
    try:
        yield
    except (NumbaError, UnsupportedBytecodeError) as error:
        if system is None:  # the engine's own
            raise
        raise _explanation(error, system) from error
    except Exception as error:  # of any type, for example if numba lacks a package
        if system is not None:
            error.add_note(f"Raised while {system.label} was compiled. {AS_PYTHON}")
        raise


def first_sentence(error: BaseException) -> str:
    """The first sentence of numba's message, without the candidates that it tried and the calls that led there."""
    lines = [line.strip() for line in str(error).splitlines()]
    lines = [line for line in lines if line and not line.startswith("Failed in ")]
    first = lines[0] if lines else type(error).__name__
    if first.endswith(":") and len(lines) > 1:  # as in "... found for signature:"
        first += " " + lines[1].removeprefix(">>> ")
    return first.removesuffix(". Raised from None")


def _explanation(error: BaseException, system: System) -> EngineError:
    text, label = str(error), system.label
    places = [(PurePath(file).name, line) for file, line in PLACE.findall(text)]
    places = [place for place in dict.fromkeys(places) if not place[0].startswith(GENERATED)]
    where = "; ".join(f"{file}, line {line}" for file, line in reversed(places))
    label += f" ({where})" if where else ""
    if "Cannot modify readonly array" in text:
        return ScheduleError(f"{label} writes an array that its parameter list declares as Read; declare it Write")
    if CUT in text:  # no advice to run it as Python, which would cut it off, too
        return DeclarationError(f"{label} {first_sentence(error)}")
    return DeclarationError(f"{label} cannot be compiled: {first_sentence(error)}\n{AS_PYTHON}")
