"""A process that writes files, and gets a signal at a chosen moment."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PATIENCE = 300  # seconds for one process

# Runs a module as `python -m` does, but sends itself a signal at the N-th operation on a file in a folder, or where a
# module is imported; and says in the end how many operations there were.
PRELUDE = """
import atexit, os, runpy, sys
place, left, number, wanted, module = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], sys.argv[5]
sys.argv[:] = [module, *sys.argv[6:]]
total = left

def watch(event, arguments):
    global left
    on_file = event in ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree")
    on_file = on_file and isinstance(arguments[0], (str, os.PathLike)) and str(arguments[0]).startswith(place)
    if on_file or (event == "import" and arguments[0] == wanted):
        left -= 1
        if left == 0:
            os.kill(os.getpid(), number)

sys.addaudithook(watch)
sys.path[0] = ""
atexit.register(lambda: print("operations:", total - left, file=sys.stderr))
runpy.run_module(module, run_name="__main__", alter_sys=True)
"""


@dataclass(frozen=True)
class Moment:
    """When a process gets a signal: some seconds after its first output, or at an operation on files, from 1."""

    seconds: float = 0.0
    operation: int = 0
    imported: str = ""  # or where this module is imported first
    sent: signal.Signals = signal.SIGKILL

    def __str__(self) -> str:
        return f"operation {self.operation}" if self.operation else self.imported or f"{self.seconds:.2f} s"


@dataclass(frozen=True)
class Ended:
    """How a process ended. stopped: whether by the signal, or after it."""

    status: int
    out: str
    err: str
    seconds: float  # since its first output
    operations: int = 0


def execute(
    words: list[str], place: Path, moment: Moment | None = None, variables: dict[str, str] | None = None, limit: int = 0
) -> Ended:
    """`python -m` words, which writes into the folder `place`, with a signal at that moment.

    variables: of its environment, besides. limit: bytes that a file may have, if any, as if the disk were full.
    """
    command = [sys.executable, "-m", *words]
    if moment is None or not moment.seconds:
        at = moment or Moment()
        count = 1 if at.imported else at.operation
        told = [str(place), str(count), str(int(at.sent)), at.imported]
        command = [sys.executable, "-c", PRELUDE, *told, *words]
    before, start = _listing(place), time.perf_counter()
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=os.environ | (variables or {}),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=(lambda: _limit(limit)) if limit else None,
    )
    while process.poll() is None and _listing(place) == before and time.perf_counter() - start < PATIENCE:
        time.sleep(0.002)
    first = time.perf_counter()
    if moment is not None and moment.seconds:
        time.sleep(moment.seconds)
        process.send_signal(moment.sent)
    out, err = process.communicate(timeout=PATIENCE)
    lines = [line for line in err.splitlines() if not line.startswith("operations: ")]
    counted = [int(line.split()[1]) for line in err.splitlines() if line.startswith("operations: ")]
    return Ended(process.returncode, out, "\n".join(lines), time.perf_counter() - first, sum(counted))


def _limit(size: int) -> None:
    import resource  # which Windows has not

    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def _listing(place: Path) -> list[str]:
    return sorted(os.listdir(place))
