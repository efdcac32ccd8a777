"""Fuzz the loaders of files: give them many hostile files, and use what they load.

    python -m tests.fuzz LOADER [--files N] [--seed N] [--memory-mib N]
        [--out FOLDER]

LOADER is states, level-states, recordings, checkpoints, policies, results,
plans, levels, games (scenarios as JSON) or roles; or "traps", files that must
be findings. A hostile file is a valid one in which something has been changed:
bits, pieces, headers, archive entries, or numbers under a correct checksum.
File k of a seed is always the same.

Files are loaded in a child process, whose memory is limited to what it has at
first plus --memory-mib. A loader has to refuse a file with its own exception,
or to return something that works. Anything else is a finding: another
exception, a crash, exhausted memory, or more than a minute. The file and the
traceback are kept, and the exit status is 1. With NUMBA_BOUNDSCHECK=1, an index
out of range in a kernel is a finding, too.
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
    "traps": "traps.Traps",
}
TIMEOUT = 60.0  # seconds for a file
MAX_FINDINGS = 10  # findings
DONE, REFUSED, READY = range(3)  # indices of the counters shared by the two processes


class Target(Protocol):
    """A loader under test. refusals: the exceptions with which it refuses a file. valid: a file that it accepts."""

    refusals: tuple[type[Exception], ...]
    valid: bytes

    def mutate(self, rng: Random) -> bytes:
        """A hostile file, a function of the generator's state."""

    def use(self, path: Path) -> None:
        """Load a file and do with it what its users do."""


@dataclass(frozen=True)
class Task:
    """Which files. memory: MiB that the process may allocate on top of what it has before the first file."""

    loader: str
    files: int
    seed: int
    memory: int

    @property
    def target(self) -> Target:
        """The loader under test."""
        module, _, name = TARGETS[self.loader].partition(".")
        target: Target = getattr(importlib.import_module(f"tests.fuzz.{module}"), name)()
        return target


@dataclass
class Result:
    """The outcome. findings: the error or traceback, by number of the file."""

    files: int
    refused: int
    findings: dict[int, str]


# ---- the child process


def load_files(task: Task, first: int, folder: Path) -> int:
    """Load the files from number `first` on; save each finding in the folder.

    Ends early if the files together leak more than the limit, as leaks are not what is tested here.
    """
    target, shared, path = task.target, _shared(folder), folder / "file"
    path.write_bytes(target.valid)
    target.use(path)
    begin, limit = _size(), task.memory * 2**20
    shared[READY] = 1
    for k in range(first, task.files):
        path.write_bytes(target.mutate(Random(f"{task.seed} {k}")))
        resource.setrlimit(resource.RLIMIT_AS, (_size() + limit, -1))
        refused, failure = use_file(target, path)
        shared[REFUSED] += refused and not failure
        if failure:
            _save_finding(folder, k, failure)
        shared[DONE] = k + 1
        if _size() > begin + limit or len(list(folder.glob("*.txt"))) >= MAX_FINDINGS:
            break
    return 0


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


def _size() -> int:
    """Bytes of virtual memory of this process."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE


def _shared(folder: Path) -> np.ndarray[Any, Any]:
    path = folder / "shared"
    if not path.exists():
        path.write_bytes(bytes(24))
    return np.memmap(path, np.int64, "r+")


# ---- the parent process


def fuzz(task: Task, out: Path, quiet: bool = False) -> Result:
    """Load all files in child processes, a new one after each crash; copy the findings to the folder `out`."""
    with tempfile.TemporaryDirectory() as name, tqdm(total=task.files, unit="file", disable=quiet) as bar:
        folder = Path(name)
        shared = _shared(folder)
        while shared[DONE] < task.files and len(list(folder.glob("*.txt"))) < MAX_FINDINGS:
            if (status := _run_child(task, folder, bar)) != 0:
                if not shared[READY]:
                    raise RuntimeError(f"the {task.loader} cannot be loaded at all:\n{_errors(folder)}")
                _save_finding(folder, int(shared[DONE]), f"{_errors(folder)}\nstatus {status}")
                shared[DONE] += 1
        findings = {int(path.stem): path.read_text() for path in sorted(folder.glob("*.txt"))}
        for number in findings:
            out.mkdir(parents=True, exist_ok=True)
            for ending in ("file", "txt"):
                shutil.copy(folder / f"{number}.{ending}", out / f"{task.loader}-{task.seed}-{number}.{ending}")
        return Result(int(shared[DONE]), int(shared[REFUSED]), findings)


def _save_finding(folder: Path, number: int, failure: str) -> None:
    shutil.copy(folder / "file", folder / f"{number}.file")
    (folder / f"{number}.txt").write_text(failure, errors="backslashreplace")


def _run_child(task: Task, folder: Path, bar: Any) -> int | str:
    """Load the remaining files in a child process; its exit status, or "hangs"."""
    shared = _shared(folder)
    before, since = int(shared[DONE]), time.monotonic()
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
    command = [sys.executable, "-X", "faulthandler", "-m", "tests.fuzz", task.loader, "--child", str(folder)]
    command += ["--files", str(task.files), "--seed", str(task.seed), "--memory-mib", str(task.memory)]
    shared[READY] = 0
    with (folder / "errors").open("wb") as errors:
        process = subprocess.Popen(command, stderr=errors, stdout=errors)
        while process.poll() is None:
            time.sleep(0.1)
            bar.update(int(shared[DONE]) - bar.n)
            if shared[DONE] > before or not shared[READY]:
                before, since = int(shared[DONE]), time.monotonic()
            if time.monotonic() - since > TIMEOUT:
                process.kill()
                process.wait()
                return "hangs"
    return process.returncode


def _errors(folder: Path) -> str:
    """The last output of the child process."""
    return (folder / "errors").read_text(errors="replace")[-4000:]


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
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    task = Task(options.loader, options.files, options.seed, options.memory_mib)
    if options.child:
        return load_files(task, int(_shared(options.child)[DONE]), options.child)
    start = time.monotonic()
    found = fuzz(task, options.out)
    seconds = time.monotonic() - start
    for number, failure in found.findings.items():
        print(f"file {number}: {failure.strip().splitlines()[-1]}; see {options.out}")
    accepted = found.files - found.refused - len(found.findings)
    print(f"{task.loader}, seed {task.seed}: {found.files:,} files, {found.refused:,} refused, {accepted:,} accepted")
    print(f"{len(found.findings)} findings, {found.files / seconds:,.0f} files a second")
    return 1 if found.findings else 0


if __name__ == "__main__":
    sys.exit(main())
