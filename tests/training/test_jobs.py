"""Jobs in several processes."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")  # which all of outlast.training is for

from outlast.training.errors import TrainingError
from outlast.training.processes import results

PARENT = """
import time
from functools import partial
from outlast.training.processes import results

if __name__ == "__main__":
    for _ in results([partial(print, "begun", flush=True), *[partial(time.sleep, 60)] * 4], 2):
        pass
"""


@pytest.mark.parametrize("at_once", [1, 3])
def test_results_come_in_order(at_once: int) -> None:
    jobs = [partial(time.sleep, 0.2), *[partial(divmod, k, 3) for k in range(7)], os.getpid]
    found = [*results(jobs, at_once)]
    assert found[1:-1] == [divmod(k, 3) for k in range(7)]
    assert (found[-1] == os.getpid()) == (at_once == 1)


def test_what_a_job_raises_ends_the_others() -> None:
    start = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        [*results([partial(divmod, 1, 0), *[partial(time.sleep, 100)] * 3], 2)]
    assert time.monotonic() - start < 50


def test_a_process_that_is_killed_is_an_error() -> None:
    with pytest.raises(TrainingError, match="a process that played was ended, maybe as memory ran out"):
        [*results([_kill_this_process, partial(time.sleep, 100)], 2)]


def _kill_this_process() -> None:
    os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_its_parent(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "parent_of_jobs.py"
    script.write_text(PARENT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as parent:
        assert parent.stdout is not None
        while parent.stdout.readline().strip() != b"begun":
            assert parent.poll() is None
        children = _children(parent.pid)
        assert len(children) >= 2
        parent.send_signal(how)
        parent.wait(30)
    end = time.monotonic() + 30
    while time.monotonic() < end and any(Path("/proc", str(child)).exists() for child in children):
        time.sleep(0.1)
    assert [child for child in children if Path("/proc", str(child)).exists()] == []


def _children(parent: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]
