"""Worker threads: results, errors and cancellation; and Ctrl-C after every call of theirs."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from outlast.ecs.workers import Job, Workers

ROOT = Path(__file__).resolve().parents[2]

INTERRUPTED = """
import sys
from outlast.ecs.workers import Job, Workers

after = 0
while True:  # Ctrl-C comes after the next call in each round: there, Python looks for signals
    left, begun, workers = after, [], Workers(2)
    job = Job(begun.append, after)

    def profile(frame, event, argument):
        global left
        if event in ("return", "c_return"):
            left -= 1
            if left < 0:
                sys.setprofile(None)
                raise KeyboardInterrupt

    try:
        sys.setprofile(profile)
        workers.submit([job])
        job.result()
        sys.setprofile(None)
        break
    except KeyboardInterrupt:
        sys.setprofile(None)
    workers.submit([job])
    assert job._unfinished.acquire(timeout=20), f"the job hangs after Ctrl-C at event {after}"
    job._unfinished.release()
    job.result()
    assert begun == [after]
    workers.close()
    after += 1
print(after)
"""


def test_interrupted_anywhere_it_can_be_submitted_again() -> None:
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], cwd=ROOT, capture_output=True, text=True, timeout=250)
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout) > 10  # calls in `submit` and `result`


def test_results_and_errors_reach_the_caller() -> None:
    workers, jobs = Workers(2), [Job(divmod, 7, k) for k in (2, 0, 3)]
    workers.submit(jobs)
    assert jobs[0].result() == (3, 1)
    with pytest.raises(ZeroDivisionError):
        jobs[1].result()
    assert jobs[2].result() == jobs[2].result() == (2, 1)
    assert all(job.finished for job in jobs)
    workers.close()
    workers.close()


def test_a_cancelled_job_never_runs_and_one_that_runs_is_waited_for() -> None:
    workers, begun, go, ran = Workers(1), threading.Event(), threading.Event(), []

    def first() -> None:
        begun.set()
        go.wait()
        ran.append("first")

    jobs = [Job(first), Job(ran.append, "second")]
    workers.submit(jobs)
    begun.wait()
    jobs[1].cancel()
    threading.Timer(0.1, go.set).start()
    jobs[0].cancel()
    assert ran == ["first"]
    workers.close()
    assert ran == ["first"]


def test_threads_end_with_their_owner() -> None:
    workers = Workers(3)
    job = Job(threading.get_ident)
    workers.submit([job])
    assert job.result() in sys._current_frames().keys() - {threading.get_ident()}
    del workers
    deadline = time.monotonic() + 20
    while job.result() in sys._current_frames():
        assert time.monotonic() < deadline
