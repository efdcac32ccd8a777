"""The worker thread: results and errors; and Ctrl-C after every call of it."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from outlast.envs.core.worker import Job, Worker

ROOT = Path(__file__).resolve().parents[2]

INTERRUPTED = """
import sys
from outlast.envs.core.worker import Job, Worker
from tests.helpers.interruption import interrupt_after

after = 0
while True:  # Ctrl-C comes after the next call in each round: there, Python looks for signals
    begun, worker = [], Worker()
    job = Job(begun.append, after)
    try:
        interrupt_after(after)
        worker.submit(job)
        job.result()
        sys.setprofile(None)
        break
    except KeyboardInterrupt:
        sys.setprofile(None)
    worker.submit(job)
    assert job._unfinished.acquire(timeout=20), f"the job hangs after Ctrl-C at event {after}"
    job._unfinished.release()
    job.result()
    assert begun == [after]
    worker.close()
    after += 1
print(after)
"""


def test_interrupted_anywhere_it_can_be_submitted_again() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], cwd=ROOT, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 10  # calls in `submit` and `result`


def test_results_and_errors_reach_the_caller() -> None:
    worker, jobs = Worker(), [Job(divmod, 7, k) for k in (2, 0, 3)]
    for job in jobs:
        worker.submit(job)
    assert jobs[0].result() == (3, 1)
    with pytest.raises(ZeroDivisionError):
        jobs[1].result()
    assert jobs[2].result() == jobs[2].result() == (2, 1)
    assert all(job.finished for job in jobs)
    worker.close()
    worker.close()


def test_the_thread_ends_with_its_owner() -> None:
    worker = Worker()
    job = Job(threading.get_ident)
    worker.submit(job)
    assert job.result() in sys._current_frames().keys() - {threading.get_ident()}
    del worker
    deadline = time.monotonic() + 20
    while job.result() in sys._current_frames():
        assert time.monotonic() < deadline
