"""Runs of `outlast train` as processes, some of them at a time. Needs no PyTorch."""

import logging
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tqdm import tqdm

from outlast.envs.cli.options import SIGNALLED, STOPPED

from . import log_file
from .live_view import LiveView

POLL = 0.5  # seconds
RESUME = "stopped: go on with --resume"
logger = logging.getLogger("outlast")


class ChildRun:
    """A run in a process of its own, and in a process group of its own, so that Ctrl-C reaches it once: from here.

    It stops and saves, too, when this process ends without a word: see outlast.training.job.

    Attributes:
        folder: Of the run; its name is what the run is called.
        words: Of the command line that trains it.
    """

    def __init__(self, folder: Path, words: Sequence[str], *, resume: bool) -> None:
        """Say what to train.

        Args:
            folder: Of the run.
            words: Arguments and options of `outlast train` for this run, but --out, --resume and --quiet.
            resume: Whether to go on with what is in the folder; a run that had not begun begins.
        """
        self.folder = folder
        self.words = [sys.executable, "-m", "outlast.training.job", "train", *words, "--out", str(folder), "--quiet"]
        self.words += ["--resume"] * (resume and folder.exists())

    @property
    def name(self) -> str:
        """What it is called in messages."""
        return self.folder.name

    def start(self) -> None:
        """Begin, or go on."""
        pipe, out = subprocess.PIPE, subprocess.STDOUT
        self.process = subprocess.Popen(
            self.words, start_new_session=True, stdin=pipe, stdout=pipe, stderr=out, text=True
        )

    def stop(self) -> None:
        """Let it save and end."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def steps(self) -> int:
        """Agent-steps done, by its log."""
        return log_file.last_step(self.folder / log_file.NAME)

    def report(self) -> int:
        """Print the last line of its output; its exit status, as a shell has it: 128 and the signal that ended it."""
        with self.process as process:  # `communicate` would close its input first, which interrupts it
            output = process.stdout.read().strip().splitlines() if process.stdout else []
            code = process.wait()
        last = (output or ["ended without a word"])[-1]
        tqdm.write(f"{self.name}: {last if code >= 0 else f'ended by signal {-code}: {last}'}")
        return code if code >= 0 else SIGNALLED - code


def side_by_side(
    runs: Sequence[ChildRun], at_once: int, view: LiveView, done: Callable[[], int], cure: str = RESUME
) -> int:
    """Train all runs. One that fails is reported, and the others go on; Ctrl-C lets all that have begun save.

    Args:
        runs: In the order in which they begin.
        at_once: How many go on at a time.
        view: Shows what is done, every POLL seconds; it is closed at the end.
        done: How much of the view's total is done.
        cure: Said after Ctrl-C.

    Returns:
        The exit status: 0 if all went well, 130 if they were stopped, else the highest of the runs.
    """
    waiting, running, statuses = list(runs), list[ChildRun](), list[int]()
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                running.append(waiting.pop(0))
                running[-1].start()
            time.sleep(POLL)
            for run in [run for run in running if run.process.poll() is not None]:
                running.remove(run)
                statuses.append(run.report())
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
