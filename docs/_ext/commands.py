"""The page of commands, made from the commands' parsers."""

import re
from collections.abc import Iterator
from typing import Any

from sources import code, grid

from outlast.envs.cli.grammar import Parser, sections, summaries
from outlast.envs.cli.main import parser


def commands() -> str:
    """Every command with what it does, its arguments and options by group, and examples."""
    (found,) = (action for action in parser()._actions if isinstance(action.choices, dict))
    about = summaries(found)
    names = [name for listed in sections(found).values() for name in listed]
    rows = [[f"[`outlast {name}`](#outlast-{name})", about[name]] for name in names]
    parts = [grid(["command", "does"], rows), *(_command(name, found.choices[name]) for name in names)]
    return "\n\n".join(parts)


def _command(name: str, command: Parser) -> str:
    usage = command.format_usage().removeprefix("usage: ").strip()
    description = _prose(command.description or "").replace("\n  ", "\n\n    ")
    parts = [f"### outlast {name}", description, f"```text\n{usage}\n```", *_options(command)]
    lines = [line for text, says in command.examples for line in (f"# {says}", f"outlast {text}")]
    return "\n\n".join([*parts, "```text\n" + "\n".join(lines) + "\n```"])


def _options(command: Parser) -> Iterator[str]:
    """Yield a list of options for each group, without --help, which the page mentions once for all commands."""
    for title, actions in command.groups():
        shown = [action for action in actions if "--help" not in action.option_strings]
        if shown:
            yield f"*{title}*"
            yield "\n".join(f"- {code(_form(command, action))}: {_prose(action.help or '')}" for action in shown)


def _prose(text: str) -> str:
    """Return a help text with its options as code; otherwise their hyphens would become dashes."""
    parts = text.replace("%%", "%").split("`")
    parts[::2] = [re.sub(r"--[a-z][a-z-]*", r"`\g<0>`", part) for part in parts[::2]]
    return "`".join(parts)


def _form(command: Parser, action: Any) -> str:
    """Return an option with the form of its value, or an argument."""
    formatter = command._get_formatter()
    if not action.option_strings:
        return formatter._format_args(action, formatter._get_default_metavar_for_positional(action))
    value = (
        "" if action.nargs == 0 else formatter._format_args(action, formatter._get_default_metavar_for_optional(action))
    )
    return f"{action.option_strings[-1]} {value}".strip()
