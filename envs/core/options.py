"""Options, each declared once as a field of a dataclass: checks, flags and help follow from that.

`python -m tests.options --write` writes signatures and docstrings of functions from the same fields.
"""

from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from outlast.ecs.kernels.integers import as_whole, is_whole

MILLION = 10**6


@dataclass(frozen=True)
class Option:
    """What there is to say of an option beside its name, its type and its default.

    Attributes:
        group: The title of its group in the help of commands; "" if it is for Python only, and has no flag.
        text: What it is, with its unit, without a full stop; of a bool, what it does, as in "show no progress".
        python: What only Python takes or needs to know, as a sentence.
        flag: Its flag, if that is not its name.
        metavar: What help calls its value.
        least: The lowest integer that is allowed; None if it is not an integer.
        most: The highest integer.
        choices: The texts that are allowed; () if others are.
        many: Whether the flag can be repeated, with a text each time.
        takes: Type and default in the signatures of functions, if these are not those of the field.
    """

    group: str
    text: str
    python: str = ""
    flag: str = ""
    metavar: str | None = None
    least: int | None = None
    most: int = 2**62 - 1
    choices: tuple[str, ...] = ()
    many: bool = False
    takes: str = ""


def option(default: Any, group: str, text: str, **more: Any) -> Any:
    """Return the field of an option: see Option. A default that is a function is called for each object."""
    given = {"default_factory" if callable(default) else "default": default}
    return field(**given, metadata={"option": Option(group, text, **more)})


def options_of(kind: Any) -> dict[str, Option]:
    """Return the options that a dataclass declares, by name."""
    return {each.name: each.metadata["option"] for each in fields(kind) if "option" in each.metadata}


def flag_of(name: str, own: Option) -> str:
    """Return the flag of an option."""
    return own.flag or f"--{name.replace('_', '-')}"


def default_of(kind: Any, name: str) -> Any:
    """Return the default of an option."""
    (found,) = (each for each in fields(kind) if each.name == name)
    return found.default_factory() if found.default_factory is not MISSING else found.default


def check_options(given: Any, error: Callable[[str], Exception]) -> None:
    """Check the options of an object that are integers or choices; whole floats become integers. Raises `error`."""
    for name, each in options_of(given).items():
        value = getattr(given, name)
        if each.choices and value not in each.choices:
            raise error(f"{name} = {value!r}: allowed are {', '.join(map(repr, each.choices))}")
        if each.least is not None:
            if not is_whole(value := as_whole(value), each.least, each.most):
                up_to = f" to {each.most}" if each.most < Option.most else ""
                raise error(f"{name} = {value!r}: a whole number from {each.least}{up_to} is needed")
            object.__setattr__(given, name, int(value))


def help_of(kind: Any, name: str) -> str:
    """Return the help of an option's flag: its text, with the default unless that goes without saying."""
    own, usual = options_of(kind)[name], default_of(kind, name)
    if own.many:
        return f"{own.text} (can be repeated)"
    if usual in (None, False, "") or "default" in own.text:
        return own.text
    short = f"{usual // MILLION}e6" if isinstance(usual, int) and usual and not usual % MILLION else usual
    return f"{own.text} (default {short})"


def argument_of(kind: Any, name: str) -> str:
    """Return what a docstring says of an option, as a sentence."""
    own = options_of(kind)[name]
    text = f"whether to {own.text}" if isinstance(default_of(kind, name), bool) else own.text
    return f"{text[:1].upper()}{text[1:]}. {own.python}".strip()
