"""Jobs in several processes."""

import os
import re
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from outlast.envs.cli.main import main
from outlast.envs.cli.options import STOPPED
from outlast.training.base.errors import TrainingError
from outlast.training.base.processes import results
from outlast.training.cli import benchmark, train
from outlast.training.research import reproduce
from outlast.training.research.__main__ import parser
from tests.helpers.child_processes import children, lives, until

PARENT = """
import time
from functools import partial
from outlast.training.base.processes import results

if __name__ == "__main__":
    for _ in results([partial(print, "begun", flush=True), *[partial(time.sleep, 60)] * 4], 2):
        pass
"""


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processes have no affinity there")
@pytest.mark.parametrize(
    ("words", "at_once"),
    [
        ("train ffa_1 --seed 0 1 2 3 4 5 6 7 --out {}", 5),
        ("train ffa_1 --seed 0 1 2 3 4 5 6 7 --processes 2 --out {}", 2),
        ("train ffa_1 --seed 0 1 2 3 4 5 6 7 --jobs 7 --out {}", 7),
        ("benchmark run {}", 5),
        ("reproduce original --out {}", 5),
    ],
)
def test_as_many_run_at_once_as_there_are_cores_for_this_process(
    tmp_path, monkeypatch, words: str, at_once: int
) -> None:
    for needed in ("matplotlib", "imageio_ffmpeg") if words.startswith("reproduce") else ():
        pytest.importorskip(needed, reason=f"needs {needed}: outlast[plot,view]")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 5, 8, 13, 21})
    monkeypatch.setattr(os, "cpu_count", lambda: 128)
    found: list[int] = []
    for command in (train, benchmark, reproduce):
        monkeypatch.setattr(command, "side_by_side", lambda runs, at_once, *_: found.append(at_once) or STOPPED)
    made = parser if words.startswith("reproduce") else None
    if words.startswith("benchmark"):
        plan = ["benchmark", "plan", "ffa_2-v2", "--agent", "fast", "--seed", *"01234567", "--out", str(tmp_path)]
        assert main(plan) == 0
    assert main([*words.format(tmp_path).split(), "--quiet"], made) == STOPPED
    assert found == [at_once]


@pytest.mark.parametrize("at_once", [1, 3])
def test_results_come_in_order(at_once: int) -> None:
    jobs = [partial(time.sleep, 0.2), *[partial(divmod, k, 3) for k in range(7)], os.getpid]
    found = [*results(jobs, at_once)]
    assert found[1:-1] == [divmod(k, 3) for k in range(7)]
    assert (found[-1] == os.getpid()) == (at_once == 1)


ENDLESS, ENDED = partial(time.sleep, 1000), "a process that played was ended, maybe as memory ran out"
KILLED = partial(signal.raise_signal, getattr(signal, "SIGKILL", signal.SIGTERM))


@pytest.mark.timeout(120)
@pytest.mark.parametrize(
    ("jobs", "error", "words"),
    [
        ([partial(divmod, 1, 0), ENDLESS], ZeroDivisionError, "zero"),
        ([KILLED, ENDLESS], TrainingError, ENDED),
        ([ENDLESS, KILLED], TrainingError, ENDED),
    ],
    ids=["raises", "killed first", "killed last"],
)
def test_what_goes_wrong_in_a_job_ends_the_others(jobs: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        [*results(jobs, 2)]


UNGUARDED = {
    "jobs": """
from functools import partial
from outlast.training.base.processes import results

print(*results([partial(divmod, 7, 2)] * 2, 2))
""",
    "training": """
import outlast

outlast.train("ffa_1", "run", steps=1, processes=2, worlds=8, rollout=512, threads=1, quiet=True)
""",
}


@pytest.mark.parametrize(("name", "file"), [("jobs", "program.py"), ("training", "program.py"), ("jobs", "-")])
def test_a_program_without_a_main_guard_is_told_so_in_the_last_line(tmp_path: Path, name: str, file: str) -> None:
    """Each process runs the program again; from standard input it cannot be imported, with a guard or without one."""
    (tmp_path / "program.py").write_text(UNGUARDED[name])
    ended = subprocess.run(
        [sys.executable, file], cwd=tmp_path, input=UNGUARDED[name], capture_output=True, text=True, timeout=280
    )
    assert (ended.returncode, (tmp_path / "run").exists()) == (1, False)
    guard, place = 'which must start it under if __name__ == "__main__":', "standard input, .*: put it into a file$"
    assert re.search(place if file == "-" else guard, ended.stderr.strip().splitlines()[-1])


@pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_no_process_outlives_its_parent(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "parent_of_jobs.py"
    script.write_text(PARENT)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as parent:
        assert parent.stdout is not None
        while parent.stdout.readline().strip() != b"begun":
            assert parent.poll() is None
        jobs = children(parent.pid)
        assert len(jobs) >= 2
        parent.send_signal(how)
        parent.wait(30)
    until(lambda: not any(map(lives, jobs)))
