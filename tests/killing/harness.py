"""Commands that write files, stopped by a signal or a full disk: what is on disk then, and that they go on from it.

A command runs in a process of its own, once undisturbed, and then stopped: by
SIGKILL or Ctrl-C, at a chosen time or at one of its operations on files
(opening, renaming, deleting, making folders), where a file is most likely to
be incomplete; or by a limit on the size of files, as if the disk were full.

After each of these ends, everything under the name of its product is what an
undisturbed run would have written up to a known point (`part`; for most
commands all of it, or nothing). Ctrl-C and a full disk are one line on stderr
and leave no temporary file; SIGKILL may leave some, which are known as such by
their names. Run again, the command ends as an undisturbed one does (`whole`).
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.storage.outputs import target_name

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 300  # seconds for one process
Comparison = Callable[[Path, Path], None]

# Runs a module as `python -m` does, but sends itself a signal at the N-th operation on files of a folder, or when a
# module is imported; prints at exit how many operations there were.
PRELUDE = """
import atexit, os, runpy, sys
folder, remaining, number, wanted, module = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], sys.argv[5]
sys.argv[:] = [module, *sys.argv[6:]]
total = remaining

def audit(event, arguments):
    global remaining
    on_file = event in ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree")
    on_file = on_file and isinstance(arguments[0], (str, os.PathLike)) and str(arguments[0]).startswith(folder)
    if on_file or (event == "import" and arguments[0] == wanted):
        remaining -= 1
        if remaining == 0:
            os.kill(os.getpid(), number)

sys.addaudithook(audit)
sys.path[0] = ""
atexit.register(lambda: print("operations:", total - remaining, file=sys.stderr))
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


def temporary_files(folder: Path) -> list[Path]:
    """The temporary files in a folder, at any depth."""
    return [path for path in folder.rglob("*") if target_name(path)]


def visible(folder: Path) -> list[Path]:
    """Everything in a folder but temporary files, sorted by name."""
    return sorted(path for path in folder.iterdir() if not target_name(path))


def same_bytes(path: Path, expected: Path) -> None:
    assert path.read_bytes() == expected.read_bytes(), path.name


@dataclass(frozen=True)
class Writer:
    """A command that writes one file or folder.

    Attributes:
        name: Its name in tests.
        command: A module and its arguments; {folder} is where it may write, {out} the product in it.
        product: The name of what it writes.
        whole: Called with (product, that of an undisturbed run); AssertionError unless it is complete.
        part: The same of what a stopped run may leave, if that is not the complete product.
        prepare: Sets up an empty folder for the first run.
        resume: More words for a run that goes on from a product that is there.
        keeps: It overwrites nothing: what is there has to go out of the way first.
        variables: Additional environment variables.
        needs: Libraries that not every installation has.
    """

    name: str
    command: str
    product: str
    whole: Comparison
    part: Comparison | None = None
    prepare: Callable[[Path], object] = lambda folder: None
    resume: str = ""
    keeps: bool = False
    variables: Mapping[str, str] = field(default_factory=dict)
    needs: tuple[str, ...] = ()


@dataclass(frozen=True)
class Moment:
    """When to send a signal: seconds after the first output, or at the n-th file operation, from 1."""

    seconds: float = 0.0
    operation: int = 0
    imported: str = ""  # or when this module is first imported
    sent: signal.Signals = signal.SIGKILL

    def __str__(self) -> str:
        return f"operation {self.operation}" if self.operation else self.imported or f"{self.seconds:.2f} s"


@dataclass(frozen=True)
class Outcome:
    """How a process ended."""

    status: int
    err: str
    seconds: float  # since its first output
    operations: int


def run(writer: Writer, folder: Path, moment: Moment | None = None, limit: int = 0) -> Outcome:
    """Run the command, and send it the signal of `moment`. limit: the largest size of a file in bytes."""
    moment, out = moment or Moment(), folder / writer.product
    begun = out.is_dir() and bool(visible(out))
    words = shlex.split(f"{writer.command} {writer.resume if begun else ''}")
    command = [word.format(folder=folder, out=out) for word in words]
    variables = {name: value.format(folder=folder, out=out) for name, value in writer.variables.items()}
    count = 1 if moment.imported else moment.operation
    prelude = ["-c", PRELUDE, str(folder), str(count), str(int(moment.sent)), moment.imported]
    before, start = os.listdir(folder), time.perf_counter()
    words = [sys.executable, *(["-m"] if moment.seconds else prelude), *command]
    streams: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    limited = {"env": os.environ | variables, "preexec_fn": lambda: _prepare(limit)}
    process = subprocess.Popen(words, cwd=ROOT, **streams, **limited)
    while process.poll() is None and os.listdir(folder) == before and time.perf_counter() - start < TIMEOUT:
        time.sleep(0.002)
    first = time.perf_counter()
    if moment.seconds:
        time.sleep(moment.seconds)
        process.send_signal(moment.sent)
    _, err = process.communicate(timeout=TIMEOUT)
    lines = [line for line in err.splitlines() if not line.startswith("operations: ")]
    counted = [int(line.split()[1]) for line in err.splitlines() if line.startswith("operations: ")]
    return Outcome(process.returncode, "\n".join(lines), time.perf_counter() - first, sum(counted))


def _prepare(limit: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # ignored by the background processes of a shell
    if limit:
        import resource  # not available on Windows

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


class Trial:
    """A writer, and an undisturbed run of it."""

    def __init__(self, writer: Writer, folder: Path) -> None:
        self.writer, self.folder = writer, folder
        self.reference = self.new_folder("reference")
        self.baseline = run(writer, self.reference)
        assert self.baseline.status == 0, f"{writer.name}: {self.baseline.err}"
        writer.whole(self.reference / writer.product, self.reference / writer.product)

    def new_folder(self, name: str) -> Path:
        folder = self.folder / name
        folder.mkdir()
        self.writer.prepare(folder)
        return folder

    def moment(self, number: int, rng: np.random.Generator) -> Moment:
        """A random moment of SIGKILL; every other one is at a file operation."""
        if number % 2 and self.baseline.operations:
            return Moment(operation=int(rng.integers(1, self.baseline.operations + 1)))
        return Moment(seconds=float(rng.uniform(0.001, max(0.01, self.baseline.seconds))))

    def check(self, folder: Path) -> None:
        """AssertionError unless what a stopped run left is as promised, and the command goes on from it."""
        writer, product, expected = self.writer, folder / self.writer.product, self.reference / self.writer.product
        assert {path.name for path in visible(folder)} <= {path.name for path in visible(self.reference)}
        if product.exists():
            (writer.part or writer.whole)(product, expected)
            if writer.keeps:
                product.rename(folder / "out of the way")
        again = run(writer, folder)
        assert again.status == 0, f"it does not go on: {again.err}"
        writer.whole(product, expected)

    def kill(self, times: int, seed: int = 0) -> list[int]:
        """Kill the command that often, and check each time; returns the statuses, 0 where it had ended before."""
        rng, statuses = np.random.default_rng([seed, *self.writer.name.encode()]), []
        for number in range(times):
            folder, moment = self.new_folder(str(number)), self.moment(number, rng)
            outcome = run(self.writer, folder, moment)
            statuses.append(outcome.status)
            try:
                assert outcome.status in (0, -signal.SIGKILL), outcome.err
                self.check(folder)
            except AssertionError as error:
                raise AssertionError(f"{self.writer.name}, killed at {moment} in {folder}: {error}") from error
        return statuses
