"""outlast completion: a script with which a shell completes commands, options and their values."""

import argparse
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from ..rollout.policies import POLICIES
from ..scenarios.floor_plan import GENERATORS
from ..scenarios.imports import installed
from ..scenarios.variants import VARIANTS
from .grammar import Parser, summaries

FILES = {"FILE", "FOLDER", "PATH", "RUN"}  # metavars of what is a file
HINT = {
    "bash": "outlast completion bash > ~/.local/share/bash-completion/completions/outlast",
    "fish": "outlast completion fish > ~/.config/fish/completions/outlast.fish",
    "zsh": "outlast completion zsh > ~/.zsh/_outlast",
}


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "print a script that makes your shell complete commands and options"
    examples = [
        ("completion bash", "print it; for this shell only: source <(outlast completion bash)"),
        ("completion fish", "the same for fish"),
    ]
    where = "\n".join(f"  {line}" for line in HINT.values())
    description = (
        "Print a script with which your shell completes commands, options and their values. To install it, write it "
        f"where your shell looks for it:\n{where}\n"
        "For zsh, put fpath=(~/.zsh $fpath) ahead of compinit in ~/.zshrc, too."
    )
    command = commands.add_parser("completion", help=text, description=description, examples=examples)
    command.add_argument("shell", choices=sorted(SCRIPTS), help="the shell that the script is for")
    command.set_defaults(run=lambda options: run(options, commands))


def run(options: argparse.Namespace, commands: Any) -> int:
    """Print the script."""
    print(SCRIPTS[options.shell](commands), end="")
    return 0


def values(action: argparse.Action) -> tuple[list[str], bool]:
    """Return what an argument or the value of an option can be: words, and whether a file, too."""
    if action.choices is not None:
        return [str(choice) for choice in action.choices], False
    if action.dest == "variant":
        return [*VARIANTS, *installed()], True
    if action.dest in ("policy", "policies", "others", "opponents"):
        return list(POLICIES), True
    if action.dest == "layout":
        return list(GENERATORS), True
    return [], action.metavar in FILES or action.dest in ("file", "out")


def options(command: Parser) -> Iterator[tuple[str, argparse.Action]]:
    """Yield every option of a command, by each of its names."""
    for _, actions in command.groups():
        for action in actions:
            yield from ((name, action) for name in action.option_strings)


def positional(command: Parser) -> list[argparse.Action]:
    """Return the arguments of a command that are not options."""
    return [action for _, actions in command.groups() for action in actions if not action.option_strings]


def bash(commands: Any) -> str:
    """Write bash's cases of an option's value, then of an option or an argument."""
    cases = []
    for name, command in commands.choices.items():
        takers = [(option, values(action)) for option, action in options(command) if takes_value(action)]
        cases += [f"    {name}:{option}) reply {int(files)} {_quoted(words)} ;;" for option, (words, files) in takers]
        names, (words, files) = [option for option, _ in options(command)], _arguments(command)
        cases.append(f"    {name}:*) either {_quoted(names)} {int(files)} {_quoted(words)} ;;")
    return BASH.format(commands=" ".join(commands.choices), cases="\n".join(cases))


def takes_value(action: argparse.Action) -> bool:
    """Return whether a value must follow an option."""
    return action.nargs not in (0, "?")


def _arguments(command: Parser) -> tuple[list[str], bool]:
    found = [values(action) for action in positional(command)]
    return list(dict.fromkeys(word for words, _ in found for word in words)), any(files for _, files in found)


def _quoted(words: Sequence[str]) -> str:
    return shlex.quote(" ".join(words))


def zsh(commands: Any) -> str:
    """Write what zsh's _arguments needs of each command."""
    about, cases = summaries(commands), []
    for name, command in commands.choices.items():
        specs = [_zsh_option(option, action) for option, action in options(command)]
        words, files = _arguments(command)
        specs += [f"*:argument:{_zsh_values(words, files)}"] if words or files else []
        cases.append(f"    {name}) _arguments {' '.join(map(shlex.quote, specs))} ;;")
    listed = " ".join(shlex.quote(f"{name}:{about[name]}") for name in commands.choices)
    return ZSH.format(commands=listed, cases="\n".join(cases))


def _zsh_option(option: str, action: argparse.Action) -> str:
    about = re.sub(r"([][:\\])", r"\\\1", (action.help or "").replace("%%", "%"))
    many = "*" if isinstance(action, argparse._AppendAction) else ""
    return f"{many}{option}[{about}]" + (f":value:{_zsh_values(*values(action))}" if takes_value(action) else "")


def _zsh_values(words: Sequence[str], files: bool) -> str:
    listed = " ".join(words)
    if words and files:
        return f" _outlast_words_and_files {listed}"
    return f"({listed})" if words else "_files" if files else " "


def fish(commands: Any) -> str:
    """Write fish's line for each command, option and argument."""
    about, lines = summaries(commands), ["complete -c outlast -f"]
    for name, command in commands.choices.items():
        lines.append(f"complete -c outlast -n __fish_use_subcommand -a {name} -d {_fished(about[name])}")
        here = f"complete -c outlast -n '__fish_seen_subcommand_from {name}'"
        for option, action in options(command):
            form = f"-l {option[2:]}" if option.startswith("--") else f"-s {option[1:]}"
            taken = f" -r{_fish_values(*values(action))}" if takes_value(action) else ""
            lines.append(f"{here} {form}{taken} -d {_fished(action.help or '')}")
        for action in positional(command):
            lines.append(f"{here}{_fish_values(*values(action))}")
    return "\n".join(lines) + "\n"


def _fish_values(words: Sequence[str], files: bool) -> str:
    return (" -F" if files else " -f") + (f" -a {_fished(' '.join(words))}" if words else "")


def _fished(text: str) -> str:
    return "'" + text.replace("%%", "%").replace("\\", "\\\\").replace("'", "\\'") + "'"


SCRIPTS: dict[str, Callable[[Any], str]] = {"bash": bash, "zsh": zsh, "fish": fish}
BASH = """\
# Completion of outlast; made by `outlast completion bash`
_outlast() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}"
  reply() {{ # whether files, words
    local IFS=$' \\n'
    local found="$(compgen -W "$2" -- "$current"; [[ $1 == 0 ]] || compgen -f -- "$current")"
    IFS=$'\\n'
    COMPREPLY=($found)
  }}
  either() {{ # options, whether files, words
    if [[ $current == -* ]]; then reply 0 "$1"; else reply "$2" "$3"; fi
  }}
  if [[ $COMP_CWORD -eq 1 ]]; then
    reply 0 "{commands} --help --version"
    return
  fi
  case "${{COMP_WORDS[1]}}:$before" in
{cases}
  esac
}}
complete -o filenames -F _outlast outlast
"""
ZSH = """\
#compdef outlast
# Completion of outlast; made by `outlast completion zsh`
_outlast_words_and_files() {{
  compadd -- "$@"
  _files
}}
_outlast() {{
  if (( CURRENT == 2 )); then
    local -a commands=({commands})
    _describe command commands
    return
  fi
  local command=$words[2]
  shift words
  (( CURRENT-- ))
  case $command in
{cases}
  esac
}}
if [[ $funcstack[1] == _outlast ]]; then _outlast "$@"; else compdef _outlast outlast; fi
"""
