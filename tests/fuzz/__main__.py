"""Fuzz the loaders of files: give them many hostile files, and use what they load.

    python -m tests.fuzz LOADER [--files N] [--seed N] [--memory-mib N]
        [--out FOLDER]

LOADER is states, level-states, recordings, checkpoints, policies, results,
plans, levels, games (scenarios as JSON) or roles. A hostile file is a valid one
in which something has been changed: bits, pieces, headers, archive entries, or
numbers under a correct checksum. File k of a seed is always the same.

Each file may take --memory-mib on top of what the process has. A loader has to
refuse a file with its own exception, or to return something that works.
Another exception, or exhausted memory, is a finding: the file and the traceback
are kept, and the exit status is 1. A crash, or more than a minute for a file,
ends the process with the stacks of its threads; the file is FOLDER/file. With
NUMBA_BOUNDSCHECK=1, an index out of range in a kernel is a finding, too.
"""

import argparse
import contextlib
import faulthandler
import importlib
import mmap
import resource
import shutil
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from random import Random
from typing import Protocol

from tqdm import tqdm

TARGETS = {
    "states": "worlds.States",
    "level-states": "worlds.LevelStates",
    "recordings": "worlds.Recordings",
    "checkpoints": "training.Checkpoints",
    "policies": "training.Policies",
    "results": "training.Results",
    "plans": "plans.Plans",
    "levels": "levels.Levels",
    "games": "levels.Games",
    "roles": "levels.RoleFiles",
}
TIMEOUT = 60.0  # seconds for a file


class Target(Protocol):
    """A loader under test. refusals: the exceptions with which it refuses a file. valid: a file that it accepts."""

    refusals: tuple[type[Exception], ...]
    valid: bytes

    def mutate(self, rng: Random) -> bytes:
        """A hostile file, a function of the generator's state."""

    def use(self, path: Path) -> None:
        """Load a file and do with it what its users do."""


def target_of(loader: str) -> Target:
    """The loader under test."""
    module, _, name = TARGETS[loader].partition(".")
    target: Target = getattr(importlib.import_module(f"tests.fuzz.{module}"), name)()
    return target


def use_file(target: Target, path: Path) -> tuple[bool, str]:
    """Whether the file was refused, and the traceback if that is a finding, else ""."""
    try:
        target.use(path)
    except target.refusals as error:
        out_of_memory = isinstance(error.__cause__ or error.__context__, MemoryError)
        return True, traceback.format_exc() if out_of_memory else ""
    except Exception:
        return False, traceback.format_exc()
    return False, ""


def outcomes(loader: str, files: int, seed: int, place: Path, memory: int = 1500) -> Iterator[tuple[int, bool, str]]:
    """Use the files of a seed; yields their numbers, whether they were refused, and tracebacks of findings.

    place: a folder, in which the file in use is called "file". memory: MiB that a file may take.
    """
    target, path = target_of(loader), place / "file"
    path.write_bytes(target.valid)
    target.use(path)
    for k in range(files):
        path.write_bytes(target.mutate(Random(f"{seed} {k}")))
        with limited(memory * 2**20):
            found = use_file(target, path)
        yield k, *found


@contextlib.contextmanager
def limited(memory: int) -> Iterator[None]:
    """At most so many bytes more than this process has, and a minute."""
    now = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (now + memory, before[1]))
    faulthandler.dump_traceback_later(TIMEOUT, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, before)


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns 1 if there are findings."""
    parser = argparse.ArgumentParser(
        "python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("loader", choices=TARGETS, metavar="LOADER", help=", ".join(TARGETS))
    parser.add_argument("--files", type=int, default=100_000, help="number of files (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="decides which files they are (default %(default)s)")
    parser.add_argument(
        "--memory-mib", type=int, default=1500, help="MiB of memory that a file may take (default %(default)s)"
    )
    parser.add_argument("--out", type=Path, default=Path("findings"), help="folder for findings (default %(default)s)")
    options = parser.parse_args(arguments)
    faulthandler.enable()
    options.out.mkdir(parents=True, exist_ok=True)
    name, findings, refusals = f"{options.loader}-{options.seed}", 0, 0
    every = outcomes(options.loader, options.files, options.seed, options.out, options.memory_mib)
    for k, refused, failure in tqdm(every, total=options.files, unit="file"):
        refusals += refused
        if failure:
            findings += 1
            shutil.copy(options.out / "file", options.out / f"{name}-{k}.file")
            (options.out / f"{name}-{k}.txt").write_text(failure, errors="backslashreplace")
            tqdm.write(f"file {k}: {failure.strip().splitlines()[-1]}; see {options.out}")
    print(f"{name}: {options.files:,} files, {refusals:,} refused, {findings} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
