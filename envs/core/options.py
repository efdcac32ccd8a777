"""Options, each declared once as a field of a dataclass: checks, flags and help follow from that.

`python -m tests.options --write` writes signatures and docstrings of functions from the same fields.
"""

import contextlib
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any

from gymnasium.vector import AutoresetMode

from ..rendering.rgb import RENDER_MODES
from .validation import MAX_WORLDS, check_choice, check_count, check_flags

MILLION = 10**6
GAME, PLAY, OUTPUT, MACHINE = "game", "what is played", "output", "machine"  # titles of groups of options


class ChoicesBySide(tuple[str, ...]):
    """Choices that can differ by side: a text such as "fast,seeker:paper" is also in them."""

    def __contains__(self, text: object) -> bool:
        with contextlib.suppress(ValueError):
            return all(super(ChoicesBySide, self).__contains__(each) for each in by_side(str(text)).values())
        return False


def by_side(text: str) -> dict[str, str]:
    """Return the choices in a text such as "fast,seeker:paper": by side, and that of all others under "", first.

    Raises ValueError: none is for all others, or a side has two.
    """
    found = {"": ""}
    for part in text.split(","):
        side, _, choice = part.rpartition(":")
        if found.get(side):
            raise ValueError(f"{text}: {side or 'all others'} cannot have both {found[side]} and {choice}")
        found[side] = choice
    if not found[""]:
        raise ValueError(f"{text}: one for all other sides is needed, too, as in fast,{text}")
    return found


@dataclass(frozen=True)
class Option:
    """Properties of an option beside its name, its type and its default.

    Attributes:
        group: The title of its group in the help of commands; "" if it is for Python only, and has no flag.
        text: Description with unit, without a full stop; for a bool, its effect, as in "show no progress".
        python: Values or facts for Python only, as a sentence.
        flag: Its flag, if that is not its name; of a bool that is usually True, one that begins with --no-.
        metavar: Name of its value in help.
        least: The lowest integer that is allowed; None if it is not an integer.
        most: The highest integer.
        choices: Allowed values, texts or None; () for other types. ChoicesBySide: may differ by side.
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
    choices: tuple[str | None, ...] = ()
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


@dataclass(frozen=True)
class WorldOptions:
    """Options of environments: of `outlast.make_vec`, and some of each adapter."""

    seed: int | None = option(
        None,
        "",
        "what keys the random numbers of world i, by (seed, first_world + i); None: a seed from the operating system",
    )
    threads: int = option(1, "", "threads among which a step divides the worlds, with the same results", least=1)
    max_episode_steps: int | None = option(
        None, "", "ticks after which a world is truncated; it sets the scenario's ending_limit", least=1
    )
    autoreset_mode: AutoresetMode | str = option(  # noqa: RUF009, a field
        AutoresetMode.NEXT_STEP,
        "",
        "when a world that ended begins its next episode: NEXT_STEP, SAME_STEP or DISABLED of "
        'gymnasium.vector.AutoresetMode, or their values, such as "NextStep"',
    )
    copy: bool = option(
        True,
        "",
        "return observations in new arrays; if not, which is faster, they are read-only views, and the next call "
        "overwrites them, and any tensors that share their memory, such as those from jax.device_put",
    )
    check_actions: bool = option(
        True,
        "",
        "check the range of actions; if not, an action out of range has an unspecified effect, but does no harm",
    )
    first_world: int = option(
        0,
        "",
        "number of the first world, for batches that each hold a part of the worlds of one seed",
        least=0,
        most=MAX_WORLDS,
    )
    render_mode: str | None = option(None, "", '"rgb_array", "ansi" or None', choices=(None, *RENDER_MODES))
    actions: str = option(
        "multi",
        "",
        '"multi", an integer for each action; "joint", one integer for all actions of an agent, 0 to 215 in the '
        'paper; or "continuous", a float from -1 to 1 for each action, whose values share that range equally',
    )
    observations: str = option("dict", "", '"dict", arrays by key, or "flat", one array that joins those of all keys')
    scaled: bool = option(
        False,
        "",
        "divide observations, and `state`, by the scales of their fields to about -1 to 1, with angles wrapped; "
        "columns without bounds are clipped to -10 to 10",
    )
    action_masks: bool = option(False, "", 'put "action_mask" into info, int8: what `action_masks` returns')
    specialize: bool = option(
        False,
        "",
        "compile for this scenario alone: steps then take 15 to 25 % less time, but new mechanics or sizes take some "
        "ten seconds to compile, once; otherwise, scenarios share their compiled code",
    )
    interpret: Collection[str] = option(
        (), "", 'labels of systems ("melee.aim") to run as Python, for breakpoints and print; slow'
    )


def world_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of an environment by name, out of the local variables of a factory.

    max_episode_steps is not among them: it is a number of the scenario.
    """
    return {name: given[name] for name in options_of(WorldOptions) if name in given and name != "max_episode_steps"}
