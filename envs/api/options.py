"""Options, each declared once as a field of a dataclass: checks, flags and help follow from that."""

import functools
import inspect
import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any

from ..core.validation import check_choice, check_count, check_flags

MILLION = 10**6
GAME, PLAY, OUTPUT, MACHINE = "game", "what is played", "output", "machine"  # titles of groups of options


@dataclass(frozen=True)
class Option:
    """Properties of an option beside its name, its type and its default."""

    group: str  # title of its group in the help of commands; "" if it is for Python only, and has no flag
    # description with unit, without a full stop; for a bool, its effect, as in "show no progress"; "": what is in the
    # docstring of the function `described` of the dataclass about the argument of this name
    text: str
    python: str = ""  # values or facts for Python only, as a sentence
    flag: str = ""  # its flag, if that is not its name; of a bool that is usually True, one that begins with --no-
    metavar: str | None = None  # name of its value in help
    least: int | None = None  # the lowest integer that is allowed; None if it is not an integer
    most: int = 2**62 - 1
    choices: tuple[str | None, ...] = ()  # allowed values, texts or None; () for other types
    many: bool = False  # whether the flag can be repeated, with a text each time
    takes: str = ""  # type and default in the signatures of functions, if these are not those of the field


def option(default: Any, group: str, text: str = "", **more: Any) -> Any:
    """Return the field of an option: see Option. A default that is a function is called for each object."""
    given = {"default_factory" if callable(default) else "default": default}
    return field(**given, metadata={"option": Option(group, text, **more)})


def options_of(kind: Any) -> dict[str, Option]:
    """Return the options that a dataclass declares, by name."""
    found = {each.name: each.metadata["option"] for each in fields(kind) if "option" in each.metadata}
    missing = {name: _argument(kind.described, name) for name, own in found.items() if not own.text}
    return found | {name: replace(found[name], text=text) for name, text in missing.items()}


@functools.cache
def _argument(function: Any, name: str) -> str:
    """Return the first sentence of a docstring about an argument, in the form of Option.text."""
    entry = re.search(rf"^    {name}: (.*(?:\n        .*)*)", inspect.getdoc(function) or "", re.MULTILINE)
    text = " ".join(entry[1].split()) if entry else ""
    text = text.partition(". ")[0].removesuffix(".").removeprefix("Whether to ")
    return text[:1].lower() + text[1:]


def flag_of(name: str, own: Option) -> str:
    """Return the flag of an option."""
    return own.flag or f"--{name.replace('_', '-')}"


def default_of(kind: Any, name: str) -> Any:
    """Return the default of an option."""
    (found,) = (each for each in fields(kind) if each.name == name)
    return found.default_factory() if found.default_factory is not MISSING else found.default


def check_options(kind: Any, given: Mapping[str, Any]) -> None:
    """Check the given options that are flags, integers or choices. Raises ValueError."""
    for name, each in options_of(kind).items():
        if name not in given:
            continue
        value, usual = given[name], default_of(kind, name)
        if isinstance(usual, bool):
            check_flags(**{name: value})
        elif each.least is not None and not (value is usual is None):
            check_count(name, value, each.least, each.most)
        elif each.choices:
            check_choice(name, value, each.choices)


def help_of(kind: Any, name: str) -> str:
    """Return the help of an option's flag: its text, with the default unless that is obvious."""
    own, usual = options_of(kind)[name], default_of(kind, name)
    if own.many:
        return f"{own.text} (can be repeated)"
    if usual is True:
        return f"do not {own.text}"
    if usual is False or usual in (None, "", ()) or "default" in own.text:
        return own.text
    short = f"{usual // MILLION}e6" if isinstance(usual, int) and usual and not usual % MILLION else usual
    return f"{own.text} (default {short})"
