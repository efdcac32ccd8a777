"""Crash safety: kill commands that write files, and check what is left.

    python -m tests.killing [WRITER ...] [--times N] [--seed N]

A writer is a command of `outlast` in a process of its own; films.py, exports.py
and training.py have them. It is killed with SIGKILL at a random moment between
its first output and its end, or at a random one of its file operations
(opening, renaming, deleting, making folders), where a file is most likely to be
incomplete. What is left must open, and be complete up to a known point. Then
the command runs again, and must produce what it produces uninterrupted.
Temporary files left behind must be recognisable as such, and cause no trouble.
The result is a table.
"""

import argparse
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tests.killing import exports, films, training
from tests.killing.process import Moment, Outcome, execute
from tests.killing.writer import COMPLETE, Writer, temporary_files


@dataclass
class Tally:
    """The results of killing one writer."""

    kills: int = 0
    late: int = 0  # kills after its end
    found: Counter[str] = field(default_factory=Counter)
    temporary_files: int = 0  # left behind
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        found = ", ".join(f"{count} {what}" for what, count in self.found.most_common())
        return f"{self.kills:5} {self.late:5} {self.temporary_files:10} {len(self.failures):9}   {found}"


def run(writer: Writer, folder: Path, moment: Moment | None = None, resume: bool = False, limit: int = 0) -> Outcome:
    """The command in a process of its own; see execute."""
    return execute(writer.command(folder, resume), folder, moment, writer.environment(folder), limit)


class Trial:
    """A writer, and an uninterrupted run of it."""

    def __init__(self, writer: Writer, folder: Path, rng: np.random.Generator) -> None:
        self.writer, self.folder, self.rng, self.tally = writer, folder, rng, Tally()
        self.reference = self._new_folder("reference")
        self.baseline = run(writer, self.reference)
        assert self.baseline.status == 0, f"{writer.name}: {self.baseline.err}"
        self.writer.check_resumed(self.reference, self.reference)

    def _new_folder(self, name: str) -> Path:
        folder = self.folder / f"{self.writer.name.replace(' ', '-')}-{name}"
        folder.mkdir()
        self.writer.prepare(folder)
        return folder

    def moment(self, number: int) -> Moment:
        """A random moment; every other one is at a file operation."""
        if number % 2 and self.baseline.operations:
            return Moment(operation=int(self.rng.integers(1, self.baseline.operations + 1)))
        return Moment(seconds=float(self.rng.uniform(0.001, max(0.01, self.baseline.seconds))))

    def kill(self, number: int) -> None:
        """Kill it once, check, run it again, compare."""
        folder, moment, tally = self._new_folder(str(number)), self.moment(number), self.tally
        outcome = run(self.writer, folder, moment)
        tally.kills += 1
        try:
            if outcome.status == 0:
                tally.late += 1
            else:
                assert outcome.status == -signal.SIGKILL, f"status {outcome.status}: {outcome.err}"
            tally.temporary_files += len(temporary_files(folder))
            found = self.writer.check(folder, self.reference)
            tally.found[found] += 1
            if outcome.status and not (self.writer.keeps_existing and found == COMPLETE):
                resumed = run(self.writer, folder, resume=True)
                assert resumed.status == 0, f"it does not go on: {resumed.err}"
                self.writer.check_resumed(folder, self.reference)
        except AssertionError as error:
            tally.failures.append(f"{self.writer.name}, killed at {moment} in {folder}: {error}")


def kill_repeatedly(writer: Writer, times: int, folder: Path, seed: int = 0) -> Tally:
    """Kill a writer `times` times."""
    trial = Trial(writer, folder, np.random.default_rng([seed, *writer.name.encode()]))
    for number in range(times):
        trial.kill(number)
    return trial.tally


def writers() -> list[Writer]:
    """All that there are."""
    return [*films.WRITERS, *exports.WRITERS, *training.WRITERS]


def kills_per_writer(chosen: Iterable[Writer], times: int) -> dict[Writer, int]:
    """Kills for each writer, `times` together; at least one."""
    weights = {writer: 1 if writer.slow else 10 for writer in chosen}
    return {writer: max(1, round(times * weight / sum(weights.values()))) for writer, weight in weights.items()}


def main(arguments: list[str]) -> int:
    known = {writer.name.replace(" ", "-"): writer for writer in writers()}
    parser = argparse.ArgumentParser(
        "python -m tests.killing", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("writers", nargs="*", metavar="WRITER", help=f"{', '.join(known)} (default: all)")
    parser.add_argument("--times", type=int, default=200, help="kills, divided among the writers (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="decides the moments (default %(default)s)")
    options = parser.parse_args(arguments)
    chosen = [known[name] for name in options.writers or known]
    print(f"{'writer':<22} kills  late  temporary  failures   found\n{'-' * 100}", flush=True)
    failures = list[str]()
    with tempfile.TemporaryDirectory() as folder:
        for writer, times in kills_per_writer(chosen, options.times).items():
            tally = kill_repeatedly(writer, times, Path(folder), options.seed)
            failures += tally.failures
            print(f"{writer.name:<22} {tally}", flush=True)
    print(*failures, sep="\n")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
