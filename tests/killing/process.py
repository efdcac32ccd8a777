"""Run a process that writes files, and send it a signal at a chosen moment."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT = 300  # seconds for one process

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
    out: str
    err: str
    seconds: float  # since its first output
    operations: int = 0


def execute(
    command: list[str], folder: Path, moment: Moment | None, variables: dict[str, str], limit: int = 0
) -> Outcome:
    """Run `python -m` with a command that writes into `folder`, and send the signal of `moment`.

    variables: additional environment variables. limit: the largest size of a file in bytes, as if the disk were full.
    """
    moment = moment or Moment()
    count = 1 if moment.imported else moment.operation
    prelude = ["-c", PRELUDE, str(folder), str(count), str(int(moment.sent)), moment.imported]
    before, start = _listing(folder), time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *(["-m"] if moment.seconds else prelude), *command],
        cwd=ROOT,
        env=os.environ | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: _prepare(limit),
    )
    while process.poll() is None and _listing(folder) == before and time.perf_counter() - start < TIMEOUT:
        time.sleep(0.002)
    first = time.perf_counter()
    if moment.seconds:
        time.sleep(moment.seconds)
        process.send_signal(moment.sent)
    out, err = process.communicate(timeout=TIMEOUT)
    lines = [line for line in err.splitlines() if not line.startswith("operations: ")]
    counted = [int(line.split()[1]) for line in err.splitlines() if line.startswith("operations: ")]
    return Outcome(process.returncode, out, "\n".join(lines), time.perf_counter() - first, sum(counted))


def _prepare(limit: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # ignored by the background processes of a shell
    if limit:
        import resource  # not available on Windows

        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))


def _listing(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))
