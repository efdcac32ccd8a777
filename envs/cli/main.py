"""The command line: its commands, those that other packages add (see PLUGINS), and how they are run and completed."""

import argparse
import contextlib
import errno
import io
import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import partial
from importlib.metadata import entry_points
from typing import Any, TextIO

from outlast.ecs.kernels.errors import OutlastError

from ..progress import CLOSED, Messages
from ..rollout.policies import POLICIES
from ..scenarios.floor_plan import GENERATORS
from ..scenarios.parse import installed
from ..scenarios.variants import VARIANTS
from ..storage.interrupts import children_awaited, save_requests, stops_as_ctrl_c
from . import games, playing
from .grammar import Parser, add_command, overview, summaries
from .options import SIGNALLED, STOPPED, check_files, messages_shown, printable, save_scenario

PLUGINS = "outlast.commands"  # entry points of this group are modules with a function `add`; training has some
FILES = {"FILE", "FOLDER", "PATH", "RUN"}  # metavars of what is a file
# the errors of a stream whose reader is gone: a pipe, also that of Windows, or the terminal of a lost connection
GONE = (errno.EPIPE, errno.EIO, *([errno.EINVAL] if os.name == "nt" else []))


def main(arguments: Sequence[str] | None = None, made: Callable[[], Parser] | None = None) -> int:
    """Run a command of `outlast`, or of another program that `program` makes; returns the exit status.

    Errors of use are one line on stderr and status 2. Ctrl-C is 130, SIGTERM 143, SIGHUP 129.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # for PyTorch, which is not loaded yet: its threads wait asleep
    with standard_streams(), children_awaited(), save_requests(), stops_as_ctrl_c() as came:
        try:
            try:
                status = _run(list(sys.argv[1:] if arguments is None else arguments), made or parser)
            finally:  # before Python ends; also after --help, which exits
                sys.stdout.flush()
        except OSError as error:  # a full disk
            status = _refused_by_system(error)
    return SIGNALLED + came[0] if status == STOPPED and came else status


def _run(words: list[str], made: Callable[[], Parser]) -> int:
    if words[:1] == ["help"]:
        words = [*words[1:], "--help"]
    options = made().parse_args(words if words and words != ["--"] else ["--help"])
    try:
        with messages_shown():
            check_files(options)
            status = int(options.run(options) or 0)
            save_scenario(options)
            return status
    except OutlastError as error:  # a mistake in use: no traceback
        return _refused(str(error))
    except MemoryError as error:
        return _refused(f"there is not enough memory, take fewer --worlds: {error}")
    except OSError as error:
        return _refused_by_system(error)
    except KeyboardInterrupt:  # for commands without a report of their progress
        print("stopped", file=sys.stderr)
        return STOPPED


def _refused_by_system(error: OSError) -> int:
    where = f"{printable(os.fsdecode(error.filename))}: " if isinstance(error.filename, (str, bytes)) else ""
    return _refused(f"{where}{error.strerror or error}")


def _refused(text: str) -> int:
    print(f"outlast: {text}", file=sys.stderr)
    return 2


def parser() -> Parser:
    """Return the grammar of `outlast`."""
    import outlast  # here, as the package imports the environments

    added = [plugin.load().add for plugin in entry_points(group=PLUGINS)]
    about = "Multi-agent survival worlds, thousands at a time."
    top = program("outlast", about, (games.add, playing.add, _add_completion, *added))
    top.add_argument("--version", action="version", version=f"outlast {outlast.__version__}", help="print the version")
    return top


def program(name: str, description: str, adds: Iterable[Callable[[Any], None]]) -> Parser:
    """Return the grammar of a program. adds: Functions that add commands to those of argparse's add_subparsers."""
    top = Parser(prog=name, description=description)
    commands: Any = top.add_subparsers(metavar="COMMAND", help=argparse.SUPPRESS)
    commands.top = top
    for add in adds:
        add(commands)
    text = "show all commands, or how one of them is used"
    examples = [("help", "all commands"), (f"help {[*commands.choices][-1]}", "the options of one command")]
    about = "Show all commands, or how one of them is used."
    asked = commands.add_parser("help", help=text, description=about, examples=examples)
    text = "name of the command (default: a short list of all commands)"
    asked.add_argument("command", nargs="?", choices=list(commands.choices), metavar="COMMAND", help=text)
    top.epilog = overview(name, commands)
    return top


def _add_completion(commands: Any) -> None:
    command = add_command(commands, "completion", complete)
    command.add_argument("shell", choices=["bash", "fish", "zsh"], help="the shell that the script is for")
    command.set_defaults(run=partial(complete, commands=commands))


def complete(options: argparse.Namespace, commands: Any = None) -> None:
    """Print a script that makes your shell complete commands and options.

    Print a script with which your shell completes commands, options and their values. To install it, write it where
    your shell looks for it:
      outlast completion bash > ~/.local/share/bash-completion/completions/outlast
      outlast completion fish > ~/.config/fish/completions/outlast.fish
      outlast completion zsh > ~/.zsh/_outlast
    For zsh, put fpath=(~/.zsh $fpath) ahead of compinit in ~/.zshrc, too.

    Examples:
        completion bash  # print it; for this shell only: source <(outlast completion bash)
        completion fish  # the same for fish
    """
    import shtab  # here, as no other command needs it

    words: dict[str, Collection[str]] = {"variant": [*VARIANTS, *installed()], "layout": GENERATORS}
    words |= dict.fromkeys(("policy", "policies", "others", "opponents"), POLICIES)
    commands.help = ""  # shtab leaves out what help does
    for name, about in summaries(commands).items():
        command = commands.choices[name]
        command.description = about  # which shells show in a line
        for action in command._actions:
            if action.dest in words:  # it can also be a file
                action.complete = _words_or_files(words[action.dest])
            elif action.choices is None and (action.metavar in FILES or action.dest in ("file", "out")):
                action.complete = shtab.FILE
    print(shtab.complete(commands.top, options.shell))


def _words_or_files(words: Collection[str]) -> dict[str, Any]:
    """Return what shtab takes as the attribute `complete` of an action: what completes words and files, by shell."""
    listed = " ".join(words)
    function = f"_outlast_files_or_{next(iter(words))}"
    return {
        "bash": function,
        "fish": f"{listed} (__fish_complete_path (commandline -ct))",
        "zsh": f"{{compadd -- {listed}; _files}}",
        "preamble": {"bash": f'{function}() {{ compgen -W "{listed}" -- "$1"; compgen -f -- "$1"; }}'},
    }


@contextlib.contextmanager
def standard_streams() -> Iterator[None]:
    """Yield a context in which no reader of standard output or standard error can stop a command by going away.

    The command does its work and returns its status, and the rest of its text is dropped. Text for standard error is
    also dropped after any other error; what cannot be written to standard output for another reason, such as a full
    disk, raises OSError with the file name "stdout".
    """
    for fd, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:  # closed, as by 2>&-: the next file would else get its number
            setattr(sys, name, open(os.devnull, "w" if fd else "r", encoding="utf-8"))  # noqa: SIM115
            try:
                os.fstat(fd)
            except OSError:
                _plug(fd)
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    out: Any = _Standard(sys.stdout, raises=True)
    err: Any = _Standard(sys.stderr)
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        yield


class _Standard(Messages):
    """A standard stream. raises: whether errors other than those in GONE are raised."""

    def __init__(self, stream: TextIO, raises: bool = False) -> None:
        super().__init__(stream)
        self.raises = raises

    def attempt(self, name: str, *arguments: str) -> Any:
        try:
            return getattr(self.stream, name)(*arguments)
        except CLOSED as error:
            with contextlib.suppress(*CLOSED):  # it is not a file
                _plug(self.stream.fileno())
            if self.raises and isinstance(error, OSError) and error.errno not in GONE:
                self.raises = False  # once is enough
                raise OSError(error.errno, error.strerror, "stdout") from error


def _plug(fd: int) -> None:
    """Let a descriptor lead nowhere, so that nothing is tried again, in another language or when Python ends."""
    null = os.open(os.devnull, os.O_RDWR)
    if null != fd:
        os.dup2(null, fd)
        os.close(null)


if __name__ == "__main__":
    sys.exit(main())
