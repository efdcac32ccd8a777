"""Jobs in threads: results and errors; and Ctrl-C after every call of them."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

INTERRUPTED = """
import sys
from outlast.envs.core.concurrency import Job
from tests.helpers.interruption import interrupt_after

after = 0
while True:  # Ctrl-C comes after the next call in each round: there, Python looks for signals
    begun = []
    job = Job(begun.append, after)
    try:
        interrupt_after(after)
        job.start()
        job.result()
        sys.setprofile(None)
        break
    except KeyboardInterrupt:
        sys.setprofile(None)
    job.start()
    assert job._unfinished.acquire(timeout=20), f"the job hangs after Ctrl-C at event {after}"
    job._unfinished.release()
    job.result()
    assert begun == [after]
    after += 1
print(after)
"""


def test_interrupted_anywhere_it_can_be_started_again() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], cwd=ROOT, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 4  # calls in `start` and `result`
