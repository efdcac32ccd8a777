"""Several runs side by side: a process each, as many at a time as there are cores. Says what became of each."""

import argparse
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tqdm import tqdm

from outlast.envs.errors import TrainingError

LOG = "log.csv"
ONCE = ("preset", "steps", "worlds", "rollout", "dead", "device", "every")  # options with one value each
OFTEN = ("set", "ppo")
POLL = 0.5  # seconds
STOPPED = 130  # the exit status after Ctrl-C


class Job:
    """One run. Its process has a group of its own, so that Ctrl-C reaches it once: from us."""

    def __init__(self, options: argparse.Namespace, variant: str, seed: int) -> None:
        self.name = f"{variant}-{options.preset}-{seed}"
        self.folder = (options.out or Path("runs")) / self.name
        self.words = [sys.executable, "-m", "outlast", "train", variant, "--quiet", "--out", str(self.folder)]
        self.words += ["--seed", str(seed), "--threads", str(options.threads or 1)]
        for name in ONCE:
            self.words += [f"--{name}", str(getattr(options, name))]
        for name in OFTEN:
            self.words += [word for text in getattr(options, name) for word in (f"--{name}", text)]
        if options.resume and self.folder.exists():  # one that had not begun begins
            self.words.append("--resume")

    def start(self) -> None:
        """Begin, or go on."""
        pipe, out = subprocess.PIPE, subprocess.STDOUT
        self.process = subprocess.Popen(self.words, start_new_session=True, stdout=pipe, stderr=out, text=True)

    def stop(self) -> None:
        """Let it save and end."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def steps(self) -> int:
        """Agent-steps done, by its log."""
        try:
            lines = (self.folder / LOG).read_text().rpartition("\n")[0].splitlines()
            return int(lines[-1].split(",")[1]) if len(lines) > 1 else 0
        except (OSError, ValueError, IndexError):
            return 0

    def report(self) -> int:
        """Say what it said; its exit status."""
        said = self.process.communicate()[0].strip().splitlines() or ["ended without a word"]
        tqdm.write(f"{self.name}: {said[-1]}")
        return int(self.process.returncode)


def train(options: argparse.Namespace, variants: Sequence[str]) -> int:
    """Train every variant with every seed; the exit status: 0 if all went well, 130 if they were stopped.

    A run that fails is told of, and the others go on. Ctrl-C lets all of them save; `--resume` goes on with them, and
    begins those that had not begun. Raises TrainingError, before anything begins, if two runs would be the same.
    """
    waiting = [Job(options, variant, seed) for variant, seed in itertools.product(variants, options.seed)]
    if len({job.name for job in waiting}) < len(waiting):
        raise TrainingError(f"{', '.join(job.name for job in waiting)}: name each variant and each seed once")
    total, at_once, running = len(waiting) * options.steps, options.jobs or os.cpu_count() or 1, list[Job]()
    bar = tqdm(total=total, unit="agent-step", unit_scale=True, disable=options.quiet)
    done, statuses = 0, []
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                running.append(waiting.pop(0))
                running[-1].start()
            time.sleep(POLL)
            for job in ended(running):
                running.remove(job)
                done += min(job.steps(), options.steps)
                statuses.append(job.report())
            bar.update(done + sum(job.steps() for job in running) - bar.n)
    except KeyboardInterrupt:
        for job in running:
            job.stop()
        statuses += [STOPPED, *(job.report() for job in running)]
        print("stopped: go on with --resume", file=sys.stderr)
    finally:
        bar.close()
    return STOPPED if STOPPED in statuses else max(statuses, default=0)


def ended(running: list[Job]) -> Iterator[Job]:
    """Those whose process is over."""
    yield from [job for job in running if job.process.poll() is not None]
