"""Jobs in several processes."""

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from outlast.envs.cli.main import main
from outlast.envs.cli.options import STOPPED
from outlast.training.base.errors import TrainingError
from outlast.training.base.processes import results
from outlast.training.cli import benchmark, train
from outlast.training.research import reproduce
from outlast.training.research.__main__ import parser

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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, at_once: int
) -> None:
    """As in a job of 5 of 128 cores."""
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


def test_what_a_job_raises_ends_the_others() -> None:
    start = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        [*results([partial(divmod, 1, 0), *[partial(time.sleep, 100)] * 3], 2)]
    assert time.monotonic() - start < 50


@pytest.mark.timeout(120)
@pytest.mark.parametrize("order", [1, -1])
def test_a_process_that_is_killed_is_an_error(order: int) -> None:
    """Whether it was started first or last."""
    with pytest.raises(TrainingError, match="a process that played was ended, maybe as memory ran out"):
        [*results([_kill_this_process, partial(time.sleep, 1000)][::order], 2)]


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


@pytest.mark.parametrize("name", UNGUARDED)
def test_a_program_without_a_main_guard_is_told_so_in_the_last_line(tmp_path: Path, name: str) -> None:
    """Each process runs the whole program again, and fails where it would start further ones."""
    (tmp_path / "program.py").write_text(UNGUARDED[name])
    last = _last_line(tmp_path, [sys.executable, "program.py"])
    assert 'which must start it under if __name__ == "__main__":' in last


@pytest.mark.parametrize("name", UNGUARDED)
def test_a_program_from_standard_input_is_told_so(tmp_path: Path, name: str) -> None:
    """No process can import it, with a guard or without one."""
    last = _last_line(tmp_path, [sys.executable, "-"], UNGUARDED[name])
    assert last.endswith("the program comes from standard input, but several processes import it: put it into a file")


def _last_line(folder: Path, words: list[str], given: str = "") -> str:
    ended = subprocess.run(words, cwd=folder, input=given, capture_output=True, text=True, timeout=120, check=False)
    assert ended.returncode == 1
    assert not (folder / "run").exists()
    return ended.stderr.strip().splitlines()[-1]


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
