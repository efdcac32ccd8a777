"""outlast completion: a script with which a shell completes commands, options and their values."""

import argparse
from collections.abc import Collection
from typing import Any

from ..rollout.policies import POLICIES
from ..scenarios.floor_plan import GENERATORS
from ..scenarios.imports import installed
from ..scenarios.variants import VARIANTS
from .grammar import summaries

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
    command.add_argument("shell", choices=sorted(HINT), help="the shell that the script is for")
    command.set_defaults(run=lambda options: run(options, commands))


def run(options: argparse.Namespace, commands: Any) -> int:
    """Print the script."""
    import shtab  # here, as no other command needs it

    commands.help = ""  # shtab leaves out what help does
    for name, about in summaries(commands).items():
        command = commands.choices[name]
        command.description = about  # which shells show in a line
        for action in command._actions:
            if words := words_of(action):
                action.complete = words_or_files(words)
            elif action.choices is None and (action.metavar in FILES or action.dest in ("file", "out")):
                action.complete = shtab.FILE
    print(shtab.complete(commands.top, options.shell))
    return 0


def words_of(action: argparse.Action) -> Collection[str]:
    """Return the words that an argument or the value of an option can be where it can also be a file; () for others."""
    if action.dest == "variant":
        return [*VARIANTS, *installed()]
    if action.dest in ("policy", "policies", "others", "opponents"):
        return POLICIES
    return GENERATORS if action.dest == "layout" else ()


def words_or_files(words: Collection[str]) -> dict[str, Any]:
    """Return what shtab takes as the attribute `complete` of an action: what completes words and files, by shell."""
    listed = " ".join(words)
    function = f"_outlast_files_or_{next(iter(words))}"
    return {
        "bash": function,
        "fish": f"{listed} (__fish_complete_path (commandline -ct))",
        "zsh": f"{{compadd -- {listed}; _files}}",
        "preamble": {"bash": f'{function}() {{ compgen -W "{listed}" -- "$1"; compgen -f -- "$1"; }}'},
    }
