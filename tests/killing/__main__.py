"""Crash safety: kill what writes files at random moments, look at what is left, and go on from there.

    python -m tests.killing [WRITER ...] [--times N] [--seed N]    N kills, shared out among the writers; prints a table

A writer is a command of `outlast` in a process of its own; they are in killing_films, _exports and _training. It is
killed with SIGKILL at a random moment between its first output and its end, or at a random one of its operations on
files (opening, renaming, deleting, making folders), where a file is most likely to be half there. What is left must
open, and be whole up to a known point. Then the command runs once more, and must leave what it leaves if nobody kills
it; drafts left behind must be recognisable, and in nobody's way.
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

from outlast.envs.storage.atomic_write import is_draft
from tests.killing_process import Ended, Moment, execute

NOTHING, WHOLE = "nothing", "whole"  # is left


class Writer:
    """A command that writes into a folder.

    costly: it runs for long, and is killed a tenth as often. once: it overwrites nothing, what is whole stays.
    """

    name = ""
    costly = once = False

    def prepare(self, place: Path) -> None:
        """Before the first run, in an empty folder."""

    def words(self, place: Path, again: bool = False) -> list[str]:
        """A module, and its arguments. again: to go on from what is there."""
        raise NotImplementedError

    def environment(self, place: Path) -> dict[str, str]:
        """Variables of its own."""
        return {}

    def check(self, place: Path, whole: Path) -> str:
        """What a killed one left, in a word or two; AssertionError if it must not be. whole: where nobody killed it."""
        raise NotImplementedError

    def same(self, place: Path, whole: Path) -> None:
        """After it has gone on, all is as where nobody killed it; or AssertionError."""
        raise NotImplementedError


def drafts(place: Path) -> list[Path]:
    """What is in a folder under names of drafts, at any depth."""
    return [path for path in place.rglob("*") if is_draft(path)]


def visible(place: Path) -> list[Path]:
    """Everything in a folder but drafts, in order of names."""
    return sorted(path for path in place.iterdir() if not is_draft(path))


@dataclass
class Tally:
    """What came of killing one writer."""

    kills: int = 0
    late: int = 0  # it had ended before
    found: Counter[str] = field(default_factory=Counter)
    drafts: int = 0  # left behind
    failures: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        found = ", ".join(f"{count} {what}" for what, count in self.found.most_common())
        return f"{self.kills:5} {self.late:5} {self.drafts:7} {len(self.failures):9}   {found}"


def run(writer: Writer, place: Path, moment: Moment | None = None, again: bool = False, limit: int = 0) -> Ended:
    """The command in a process of its own; see execute."""
    return execute(writer.words(place, again), place, moment, writer.environment(place), limit)


class Trial:
    """A writer, and a run of it that nobody kills."""

    def __init__(self, writer: Writer, folder: Path, rng: np.random.Generator) -> None:
        self.writer, self.folder, self.rng, self.tally = writer, folder, rng, Tally()
        self.whole = self._place("whole")
        self.usual = run(writer, self.whole)
        assert self.usual.status == 0, f"{writer.name}: {self.usual.err}"
        self.writer.same(self.whole, self.whole)

    def _place(self, name: str) -> Path:
        place = self.folder / f"{self.writer.name.replace(' ', '-')}-{name}"
        place.mkdir()
        self.writer.prepare(place)
        return place

    def moment(self, number: int) -> Moment:
        """A random one; every other one at an operation on files."""
        if number % 2 and self.usual.operations:
            return Moment(operation=int(self.rng.integers(1, self.usual.operations + 1)))
        return Moment(seconds=float(self.rng.uniform(0.001, max(0.01, self.usual.seconds))))

    def kill(self, number: int) -> None:
        """Once: kill, check, go on, compare."""
        place, moment, tally = self._place(str(number)), self.moment(number), self.tally
        ended = run(self.writer, place, moment)
        tally.kills += 1
        try:
            if ended.status == 0:
                tally.late += 1
            else:
                assert ended.status == -signal.SIGKILL, f"status {ended.status}: {ended.err}"
            tally.drafts += len(drafts(place))
            found = self.writer.check(place, self.whole)
            tally.found[found] += 1
            if ended.status and not (self.writer.once and found == WHOLE):
                went_on = run(self.writer, place, again=True)
                assert went_on.status == 0, f"it does not go on: {went_on.err}"
                self.writer.same(place, self.whole)
        except AssertionError as error:
            tally.failures.append(f"{self.writer.name}, killed at {moment} in {place}: {error}")


def tried(writer: Writer, times: int, folder: Path, seed: int = 0) -> Tally:
    """Kill a writer so many times."""
    trial = Trial(writer, folder, np.random.default_rng([seed, *writer.name.encode()]))
    for number in range(times):
        trial.kill(number)
    return trial.tally


def writers() -> list[Writer]:
    """All that are known."""
    from . import killing_exports, killing_films, killing_training  # which know this module

    return [*killing_films.WRITERS, *killing_exports.WRITERS, *killing_training.WRITERS]


def shares(chosen: Iterable[Writer], times: int) -> dict[Writer, int]:
    """Kills for each writer, `times` together; at least one."""
    weights = {writer: 1 if writer.costly else 10 for writer in chosen}
    return {writer: max(1, round(times * weight / sum(weights.values()))) for writer, weight in weights.items()}


def main(arguments: list[str]) -> int:
    known = {writer.name.replace(" ", "-"): writer for writer in writers()}
    parser = argparse.ArgumentParser(
        "python -m tests.killing", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("writers", nargs="*", metavar="WRITER", help=f"{', '.join(known)}; all if none is named")
    parser.add_argument("--times", type=int, default=200, help="kills, of all writers together (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(arguments)
    chosen = [known[name] for name in asked.writers or known]
    print(f"{'writer':<22} kills  late  drafts  failures   found\n{'-' * 100}", flush=True)
    failures = list[str]()
    with tempfile.TemporaryDirectory() as folder:
        for writer, times in shares(chosen, asked.times).items():
            tally = tried(writer, times, Path(folder), asked.seed)
            failures += tally.failures
            print(f"{writer.name:<22} {tally}", flush=True)
    print(*failures, sep="\n")
    return 1 if failures else 0


if __name__ == "__main__":
    from tests.killing import main as start  # the module that the writers know

    sys.exit(start(sys.argv[1:]))
