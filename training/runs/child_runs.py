"""Runs of `outlast train` in their own processes, a few at a time. Does not need PyTorch.

As a program, it is such a process: `python -m` and the words of the command. It saves and ends when its parent ends.
"""

import _thread
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from outlast.envs.cli.options import SIGNALLED, STOPPED
from outlast.envs.progress import above_bars
from outlast.envs.storage.interrupts import ignored, save_requests

from ..base import curves
from ..base.quantities import LiveView

POLL = 0.5  # seconds
MAIN = "outlast.training.runs.child_runs"  # the program of a run: this file
RESUME = "stopped: continue with --resume"
logger = logging.getLogger("outlast")


class ChildRun:
    """A run in its own process and process group, so that Ctrl-C reaches it only once, from this process."""

    def __init__(self, folder: Path, words: Sequence[str], *, resume: bool) -> None:
        """Prepare the run. words: Of `outlast train`, without --out, --resume and --quiet."""
        self.folder, self.name = folder, folder.name
        self.words = [sys.executable, "-m", MAIN, "train", *words, "--out", str(folder), "--quiet"]
        self.words += ["--resume"] * (resume and folder.exists())

    def start(self) -> None:
        """Start the process."""
        self._output = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115, as it is read in `report`
        with ignored("SIGUSR1"):  # until the run can handle the signal
            self.process = subprocess.Popen(
                self.words, start_new_session=True, stdin=subprocess.PIPE, stdout=self._output, stderr=subprocess.STDOUT
            )

    def stop(self) -> None:
        """Interrupt the run, so that it saves and ends."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def save(self) -> None:
        """Make the run write a checkpoint and continue."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGUSR1)

    def steps(self) -> int:
        """Return agent-steps done, according to the run's log."""
        return curves.last_step(self.folder / curves.LOG)

    def report(self) -> int:
        """Print the run's last line of output. Return its exit status as shells do: 128 + N if signal N ended it."""
        with self.process as process, self._output:  # `communicate` would close the run's input, which interrupts it
            code = process.wait()
            self._output.seek(0)
            last = [line.strip() for line in ("ended without output", *self._output) if line.strip()][-1]
        with above_bars(sys.stdout):
            print(f"{self.name}: {last if code >= 0 else f'ended by signal {-code}: {last}'}")
        return code if code >= 0 else SIGNALLED - code


def side_by_side(
    runs: Sequence[ChildRun], at_once: int, view: LiveView, done: Callable[[], int], cure: str = RESUME
) -> int:
    """Train all runs. A run that fails is reported, and the others continue. On Ctrl-C, all begun ones save and stop.

    Returns the exit status: 0 for success, 130 if they were stopped, otherwise the highest status of the runs.

    at_once: How many run at a time. view: Shows the progress. done: Returns how much is done. cure: Logged at Ctrl-C.
    """
    waiting, running, statuses = list(runs), list[ChildRun](), list[int]()
    try:
        with save_requests() as asked:
            while waiting or running:
                while waiting and len(running) < at_once:
                    running.append(waiting.pop(0))
                    running[-1].start()
                time.sleep(POLL)
                for run in [run for run in running if run.process.poll() is not None]:
                    running.remove(run)
                    statuses.append(run.report())
                if asked:
                    asked.clear()
                    for run in running:
                        run.save()
                view.update(done(), view.total, {})
                view.now(f"{len(running)} running, {len(waiting)} waiting")
    except KeyboardInterrupt:
        for run in running:
            run.stop()
        statuses += [STOPPED, *(run.report() for run in running)]
        logger.warning(cure)
    finally:
        view.close()
    return STOPPED if STOPPED in statuses else max(statuses, default=0)


def end_with_parent() -> None:
    """Interrupt this process, as Ctrl-C does, when the parent ends for any reason: standard input, its pipe, closes.

    Background commands of shells and their children ignore SIGINT; it is handled again.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def watch() -> None:
        while os.read(sys.stdin.fileno(), 1024):  # sys.stdin.read would hold a lock that aborts Python's exit
            pass
        _thread.interrupt_main()

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    from outlast.envs.cli.main import main

    end_with_parent()
    sys.exit(main())
