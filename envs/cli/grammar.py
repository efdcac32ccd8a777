"""The grammar of the command line: help with groups and examples, mistakes in one line with a hint, an overview."""

import argparse
import inspect
import re
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, NoReturn

from outlast.ecs.kernels.errors import did_you_mean

WIDEST = 110  # columns of help: longer lines are hard to read
MINUS = re.compile(r"-[^-\d]")  # a value such as -ids, which is not an option or a number

SECTIONS = {
    "games": ("variants", "numbers", "new", "layout", "schedule", "check"),
    "play and look": ("rollout", "frames", "play", "replay"),
    "train and compare": ("train", "watch", "models", "evaluate", "plot", "benchmark"),
    "help": ("help", "completion"),
}  # in the order of first use; what is in none of them comes behind


class Parser(argparse.ArgumentParser):
    """A parser of a command, or of all.

    Args:
        examples: Pairs of a command line without its first word, "rollout ffa_2 --steps 300", and what it does. They
            stand ahead of the epilog.
        run: The function (options) that runs the command, and returns its exit status.
        **settings: As argparse's own.
    """

    def __init__(self, *, examples: Sequence[tuple[str, str]] = (), run: Any = None, **settings: Any) -> None:
        super().__init__(**{**settings, "formatter_class": Help})
        if run is not None:
            self.set_defaults(run=run)
        self.examples = tuple(examples)
        if examples:
            program = self.prog.rpartition(" ")[0]
            # lines that help leaves as they are; each sentence stands above its command
            lines = [line for text, about in examples for line in (f"  # {about}", f"  {program} {text}")]
            self.epilog = "\n".join(["examples:", *lines, *(["", self.epilog] if self.epilog else [])])

    def group(self, title: str) -> Any:
        """Return the group of options of that title, made when it is first asked for."""
        found = [group for group in self._action_groups if group.title == title]
        return found[0] if found else self.add_argument_group(title)

    def groups(self) -> list[tuple[str, list[argparse.Action]]]:
        """Return the titles of the groups that are not empty, with the arguments and options to show in each."""
        found: dict[str, list[argparse.Action]] = {}
        for group in self._action_groups:
            for action in group._group_actions:
                if action.help != argparse.SUPPRESS:
                    found.setdefault(group.title or "", []).append(action)
        made = [group.title or "" for group in self._action_groups if group.title != "options"]
        return [(title, found[title]) for title in dict.fromkeys([*made, *found]) if title in found]

    def words(self, options: argparse.Namespace, leave_out: Collection[str] = ()) -> list[str]:
        """Return the words of a command line that give these options, as far as they are not as usual; no arguments.

        Args:
            options: What was parsed. The `str` of each value is parsed to the same value.
            leave_out: Options that are not wanted, by their `dest`.
        """
        found: list[str] = []
        for action in self._actions:
            value = getattr(options, action.dest, action.default)
            if action.option_strings and action.dest not in leave_out and value != action.default:
                flag = action.option_strings[-1]
                for each in value if isinstance(value, list) else [value]:
                    found += [flag] if action.nargs in (0, "?") and each == action.const else [f"{flag}={each}"]
        return found

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Parse as argparse does, but refuse what is unknown, in the name of the command that got it."""
        found, unknown = super().parse_known_args(self._joined(sys.argv[1:] if args is None else args), namespace)
        if unknown:
            self.error(self._unknown(unknown[0]))
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Print in one line what is wrong, and end with status 2."""
        text = " ".join(message.removeprefix("argument ").split())
        self.exit(2, f"{self.prog}: {text} (see {self.prog} --help)\n")

    def format_usage(self) -> str:
        """Return the command with what it needs."""
        return f"usage: {self._usage()}\n"

    def format_help(self) -> str:
        """Write usage, description, arguments and options by group, and examples."""
        formatter = self._get_formatter()
        formatter.add_usage(self._usage().replace("%", "%%"), (), ())
        formatter.add_text(self.description)
        for title, actions in self.groups():
            formatter.start_section(title)
            formatter.add_arguments(actions)
            formatter.end_section()
        formatter.add_text(self.epilog)
        return formatter.format_help()

    def _usage(self) -> str:
        formatter, words = self._get_formatter(), [self.prog]
        for action in self._actions:
            form = formatter._format_args(action, formatter._get_default_metavar_for_positional(action))
            if not action.option_strings:
                words.append(form)
            elif action.required:
                words += [action.option_strings[-1], form]
        return " ".join([*words, "[options]"])

    def _joined(self, words: Iterable[str]) -> list[str]:
        """Join values that begin with a minus to their options: --views -ids becomes --views=-ids."""
        joined: list[str] = []
        for word in words:
            option = self._option_string_actions.get(joined[-1]) if joined else None
            if option and option.nargs is None and MINUS.match(word) and word not in self._option_string_actions:
                joined[-1] += f"={word}"
            else:
                joined.append(word)
        return joined

    def _unknown(self, word: str) -> str:
        name = word.partition("=")[0]
        if not name.startswith("-"):
            return f"{word} is one word too many; put what belongs together in a row, ahead of the options"
        return f"unknown option {name}{did_you_mean(name, self._option_string_actions, before=': ', count=1)}"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            hint, known = did_you_mean(value, action.choices, before=": ", count=1), ", ".join(map(str, action.choices))
            raise argparse.ArgumentError(action, f"{value}{hint}; known: {known}")


class Help(argparse.HelpFormatter):
    """Paragraphs are filled; lines that are indented stay as they are."""

    def __init__(self, prog: str) -> None:
        width = min(WIDEST, shutil.get_terminal_size().columns) - 2
        super().__init__(prog, max_help_position=28, width=width)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        fill = super()._fill_text
        return "\n".join(line if line[:1] in ("", " ") else fill(line, width, indent) for line in text.splitlines())


def add_command(commands: Any, name: str, run: Callable[[argparse.Namespace], int | None]) -> Parser:
    """Add a command, and return its parser.

    Args:
        commands: Of argparse's add_subparsers.
        name: The command's name.
        run: The function that runs it, and returns its exit status or None for 0. Its docstring is the help: a line,
            the description, and examples, each a command line without its first word, a # and what it does.
    """
    text, _, listed = (inspect.getdoc(run) or "").partition("\n\nExamples:\n")
    text = re.sub(r"^(\S.*)\n(?=\S)", r"\1 ", text, flags=re.MULTILINE)  # a line for each paragraph
    short, _, description = text.partition("\n\n")
    lines = [line.strip().partition("  # ") for line in listed.replace(f"\n{' ' * 8}", "  ").splitlines()]
    examples = [(words, about) for words, _, about in lines]
    short = f"{short[:1].lower()}{short[1:].rstrip('.')}"
    parser: Parser = commands.add_parser(name, help=short, description=description, examples=examples, run=run)
    return parser


def overview(program: str, commands: Any) -> str:
    """Return each command with what it does and an example, in sections. commands: of argparse's add_subparsers."""
    about, listed = summaries(commands), []
    for title, names in sections(commands).items():
        listed += ["", f"{title}:"]
        for name in names:
            listed.append(f"  {name:<11} {about[name]}")
            listed += [f"  {'':<11}   {program} {text}" for text, _ in commands.choices[name].examples[:1]]
    return "\n".join([*listed[1:], "", f"`{program} help COMMAND` shows the options of a command."])


def sections(commands: Any) -> dict[str, list[str]]:
    """Return the names of the commands that there are, by section."""
    known = {name for names in SECTIONS.values() for name in names}
    more = {"more": [name for name in commands.choices if name not in known]}
    found = {title: [name for name in names if name in commands.choices] for title, names in SECTIONS.items()} | more
    return {title: names for title, names in found.items() if names}


def summaries(commands: Any) -> dict[str, str]:
    """Return the line about each command, by name."""
    return {choice.dest: choice.help or "" for choice in commands._choices_actions}
