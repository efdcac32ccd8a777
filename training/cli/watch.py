"""outlast watch: a page on which the newest checkpoint of a running training plays, beside its numbers."""

import argparse
import sys
import threading
from pathlib import Path
from typing import Any

from outlast.envs.api.play import PageOptions
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import add_import, add_options, import_files, printable
from outlast.envs.errors import needed

from ..base import policy_file
from ..base.errors import TrainingError

LISTED = 5  # runs listed in a message


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "watch", run)
    text = "folder of a run of `outlast train`, which may still be training"
    command.add_argument("run_folder", type=Path, metavar="RUN", help=text)
    add_import(command, "the run uses")
    add_options(command, PageOptions)


def run(options: argparse.Namespace) -> None:
    """See the newest policy of a run play in the browser.

    Serve a web page on which the newest policy of a run plays, beside the numbers of the run. During training, newer
    policies replace it. Ctrl-C ends the page.

    Examples:
        watch runs/ffa_2-fast-0  # the newest policy of this run plays, beside its numbers
    """
    with needed("train", "watching needs {}", TrainingError):
        import torch  # noqa: F401, which policies need, before anything is served

        from ..runs.watch import RunWatcher
    from outlast.envs.web.gate import Site, announce
    from outlast.envs.web.server import serving

    folder = _run_in(options.run_folder)
    import_files(options)
    site = Site(options.port, options.host, tuple(options.allow_host))
    name, watcher, stop = printable(str(folder)), RunWatcher(folder), threading.Event()
    recorder = threading.Thread(target=watcher.record, args=(stop,), daemon=True)
    recorder.start()
    try:
        sources = {"status": watcher.status, "episode": watcher.episode}
        with serving(printable(str(folder.resolve().name)), sources, site) as address:
            announce(
                f"{name}: its newest policy plays at {address}\nCtrl-C ends this.", address, not options.no_browser
            )
            while not stop.wait(1):  # on Windows, Ctrl-C does not end a longer wait
                pass
    except KeyboardInterrupt:
        print(file=sys.stderr)  # after the ^C
    finally:
        stop.set()
        recorder.join()


def _run_in(folder: Path) -> Path:
    """Return the folder, or the only run in it. TrainingError if it has several. A run may lack a checkpoint yet."""
    if not folder.is_dir():
        raise TrainingError(f"folder {folder} does not exist: give the folder that `outlast train` printed")
    if not (folder / policy_file.RUN_JSON).exists() and not any(folder.glob("*.zip")):
        runs = sorted(path.parent for path in folder.glob(f"*/{policy_file.RUN_JSON}"))
        if len(runs) == 1:
            return runs[0]
        if runs:
            more = ", ..." if len(runs) > LISTED else ""
            listed = ", ".join(str(path) for path in runs[:LISTED])
            raise TrainingError(f"{folder} holds several runs; choose one: {listed}{more}")
    return folder
