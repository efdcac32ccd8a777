"""Hostile files: each loader is given very many, and what it accepts is used.

    python -m tests.fuzz LOADER [--files N] [--seed N] [--memory-mib N] [--out FOLDER]

LOADER: states, recordings, checkpoints, policies or results; traps are files that must be findings. A file is a valid
one with something wrong in it: bits, pieces, headers, archives, numbers behind checksums that fit. File k of a seed is
always the same.

They are loaded in a process of their own, which may take so much more memory than it has at first. A loader refuses a
file with its own exception, or what it returns works. Anything else is a finding: another exception, a process that
dies, runs out of memory or does not come back within a minute. The file is kept, with what happened, and the exit
status is 1. With NUMBA_BOUNDSCHECK=1, kernels check their indices: what would go unseen is then a finding, too.
"""

import argparse
import importlib
import mmap
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

TARGETS = {
    "states": "fuzz_worlds.States",
    "recordings": "fuzz_worlds.Recordings",
    "checkpoints": "fuzz_training.Checkpoints",
    "policies": "fuzz_training.Policies",
    "results": "fuzz_training.Results",
    "traps": "fuzz_traps.Traps",
}
PATIENCE = 60.0  # seconds for a file
ENOUGH = 10  # findings
DONE, REFUSED, READY = range(3)  # numbers that the two processes share


class Target(Protocol):
    """What is fuzzed. refusals: the exceptions with which it refuses a file. valid: a file that it accepts."""

    refusals: tuple[type[Exception], ...]
    valid: bytes

    def mutate(self, dice: Random) -> bytes:
        """A hostile file, a function of the dice."""

    def use(self, path: Path) -> None:
        """Load a file and do with it what is done with such files."""


@dataclass(frozen=True)
class Task:
    """Which files. memory: MiB that the process may take on top of what it has when the first is loaded."""

    loader: str
    files: int
    seed: int
    memory: int

    @property
    def target(self) -> Target:
        """What makes the files and uses them."""
        module, _, name = TARGETS[self.loader].partition(".")
        target: Target = getattr(importlib.import_module(f"tests.{module}"), name)()
        return target


@dataclass
class Found:
    """What came of the files. findings: what happened, by number of the file."""

    files: int
    refused: int
    findings: dict[int, str]


# ---- the process that loads


def load(task: Task, first: int, folder: Path) -> int:
    """Load the files from number `first` on, and keep each finding in the folder: the file, and what happened.

    Ends early where all files together left too much behind: that is not what is looked for here.
    """
    target, shared, path = task.target, _shared(folder), folder / "file"
    path.write_bytes(target.valid)
    target.use(path)
    begin, most = _size(), task.memory * 2**20
    shared[READY] = 1
    for k in range(first, task.files):
        path.write_bytes(target.mutate(Random(f"{task.seed} {k}")))
        resource.setrlimit(resource.RLIMIT_AS, (_size() + most, -1))
        refused, told = used(target, path)
        shared[REFUSED] += refused and not told
        if told:
            _keep(folder, k, told)
        shared[DONE] = k + 1
        if _size() > begin + most or len(list(folder.glob("*.txt"))) >= ENOUGH:
            break
    return 0


def used(target: Target, path: Path) -> tuple[bool, str]:
    """Whether the file was refused, and what happened if that is a finding."""
    try:
        target.use(path)
    except target.refusals as error:
        greedy = isinstance(error.__cause__ or error.__context__, MemoryError)
        return True, traceback.format_exc() if greedy else ""
    except Exception:
        return False, traceback.format_exc()
    return False, ""


def _size() -> int:
    """Bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE


def _shared(folder: Path) -> np.ndarray[Any, Any]:
    path = folder / "shared"
    if not path.exists():
        path.write_bytes(bytes(24))
    return np.memmap(path, np.int64, "r+")


# ---- the process that watches


def fuzz(task: Task, out: Path, quiet: bool = False) -> Found:
    """Have all files loaded, by another process after each that dies; findings are kept in the folder `out`."""
    with tempfile.TemporaryDirectory() as name, tqdm(total=task.files, unit="file", disable=quiet) as bar:
        folder = Path(name)
        shared = _shared(folder)
        while shared[DONE] < task.files and len(list(folder.glob("*.txt"))) < ENOUGH:
            if (status := _watched(task, folder, bar)) != 0:
                if not shared[READY]:
                    raise RuntimeError(f"the {task.loader} cannot be loaded at all:\n{_errors(folder)}")
                _keep(folder, int(shared[DONE]), f"{_errors(folder)}\nstatus {status}")
                shared[DONE] += 1
        findings = {int(path.stem): path.read_text() for path in sorted(folder.glob("*.txt"))}
        for number in findings:
            out.mkdir(parents=True, exist_ok=True)
            for ending in ("file", "txt"):
                shutil.copy(folder / f"{number}.{ending}", out / f"{task.loader}-{task.seed}-{number}.{ending}")
        return Found(int(shared[DONE]), int(shared[REFUSED]), findings)


def _keep(folder: Path, number: int, told: str) -> None:
    shutil.copy(folder / "file", folder / f"{number}.file")
    (folder / f"{number}.txt").write_text(told, errors="backslashreplace")


def _watched(task: Task, folder: Path, bar: Any) -> int | str:
    """The exit status of a process that loads the files that are left, or "hangs"."""
    shared, own = _shared(folder), [str(number) for number in (task.files, task.seed, task.memory)]
    before, since = int(shared[DONE]), time.monotonic()
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    command = [sys.executable, "-X", "faulthandler", "-m", "tests.fuzz", task.loader, "--child", str(folder)]
    shared[READY] = 0
    with (folder / "errors").open("wb") as errors:
        process = subprocess.Popen(
            [*command, "--files", own[0], "--seed", own[1], "--memory-mib", own[2]], stderr=errors, stdout=errors
        )
        while process.poll() is None:
            time.sleep(0.1)
            bar.update(int(shared[DONE]) - bar.n)
            if shared[DONE] > before or not shared[READY]:
                before, since = int(shared[DONE]), time.monotonic()
            if time.monotonic() - since > PATIENCE:
                process.kill()
                process.wait()
                return "hangs"
    return process.returncode


def _errors(folder: Path) -> str:
    """What a process that died had to say."""
    return (folder / "errors").read_text(errors="replace")[-4000:]


def main(arguments: list[str] | None = None) -> int:
    """The command; 1 if there are findings."""
    parser = argparse.ArgumentParser(
        "python -m tests.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("loader", choices=TARGETS)
    parser.add_argument("--files", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--memory-mib", type=int, default=1500, help="that a file may take (default 1500)")
    parser.add_argument("--out", type=Path, default=Path("findings"), help="folder for findings (default findings)")
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    task = Task(options.loader, options.files, options.seed, options.memory_mib)
    if options.child:
        return load(task, int(_shared(options.child)[DONE]), options.child)
    start = time.monotonic()
    found = fuzz(task, options.out)
    seconds = time.monotonic() - start
    for number, told in found.findings.items():
        print(f"file {number}: {told.strip().splitlines()[-1]}; see {options.out}")
    accepted = found.files - found.refused - len(found.findings)
    print(f"{task.loader}, seed {task.seed}: {found.files:,} files, {found.refused:,} refused, {accepted:,} accepted")
    print(f"{len(found.findings)} findings, {found.files / seconds:,.0f} files a second")
    return 1 if found.findings else 0


if __name__ == "__main__":
    sys.exit(main())
