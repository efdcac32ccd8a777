"""Several processes train as one does: the same numbers, the same files; and they end together."""

import contextlib
import errno
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from outlast import variant
from outlast.envs.rollout.saved import CHECKPOINT, newest
from outlast.envs.snapshots import state
from outlast.training.base.errors import TrainingError
from outlast.training.base.log_file import read_log
from outlast.training.policies import checkpoint
from outlast.training.ppo.crew import Crew, recruit
from outlast.training.runs.run import TrainingConfig, TrainingRun

SHORT = variant("teams_2").replace(
    agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10
)
WORLDS, STEPS = 7, 32
EACH = WORLDS * STEPS * 4  # agent-steps of a rollout
MIXTURE = {"self": 0.5, "past": 0.3, "scripted": 0.2}
ADAM_STEP = 2e-3  # the learning rate: the most by which one step moves a weight
PATIENCE = 60  # seconds
linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks into /proc")


def config(rollouts: int, **changes: Any) -> TrainingConfig:
    """Small, with opponents, past selves after each update, and rewards that are scaled."""
    given = {"scenario": SHORT, "preset": "fast", "steps": rollouts * EACH, "worlds": WORLDS, "threads": 1}
    given |= {"rollout": WORLDS * STEPS, "opponents": MIXTURE, "snapshots": 1, "every": EACH, "seed": 3}
    return TrainingConfig(
        **(given | {"settings": {"batch_size": 64, "anneal_lr": False, "learning_rate": ADAM_STEP}} | changes)
    )


def trained(folder: Path, rollouts: int, *, resume: bool = False, **changes: Any) -> dict[str, bytes]:
    """The files of the last checkpoint of a run."""
    TrainingRun(config(rollouts, **changes), folder, resume=resume).train()
    return checkpoint.read_checkpoint(newest(folder))


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    """What one process comes to after three rollouts."""
    folder = tmp_path_factory.mktemp("alone")
    return folder, trained(folder, 3)


def same(files: dict[str, bytes], expected: dict[str, bytes], tolerance: float = ADAM_STEP / 2) -> None:
    """Worlds are the same bit for bit, tensors nearly.

    Processes add float32 numbers in another order, and Adam magnifies the rounding of small gradients: to 6e-5 on one
    machine, to 1e-6 on another. A gradient that misses a process moves weights by several of Adam's steps.
    """
    one, other = (state.read(io.BytesIO(each["worlds.npz"]), "worlds").arrays for each in (files, expected))
    assert one.keys() == other.keys()
    assert all(np.array_equal(one[key], other[key]) for key in one)
    for read in (checkpoint.policies_in, lambda each: checkpoint.load_tree(each, checkpoint.REST)):
        pairs = zip(*(flat(read(each)) for each in (files, expected)), strict=True)
        for (key, value), (like, wanted) in pairs:
            assert key == like
            if isinstance(value, torch.Tensor):
                torch.testing.assert_close(value, wanted, rtol=0, atol=tolerance, equal_nan=True)
            else:
                assert value == wanted


def flat(content: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(content, (dict, list)):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from flat(value, f"{name}.{key}")
    else:
        yield name, content


def close(folder: Path, expected: Path) -> None:
    """The logs are nearly the same, but for times."""
    one, other = (read_log(each / "log.csv") for each in (folder, expected))
    assert one.keys() == other.keys()
    for tag in [tag for tag in one if not tag.startswith("time/")]:
        assert [step for step, _ in one[tag]] == [step for step, _ in other[tag]]
        values, wanted = ([value for _, value in each[tag]] for each in (one, other))
        np.testing.assert_allclose(values, wanted, rtol=1e-3, atol=1e-4, err_msg=tag)


@pytest.mark.parametrize("processes", [2, pytest.param(3, marks=pytest.mark.nightly)])
def test_numbers_are_those_of_one_process(alone: tuple[Path, dict[str, bytes]], tmp_path: Path, processes: int) -> None:
    same(trained(tmp_path, 3, processes=processes), alone[1])
    close(tmp_path, alone[0])


@pytest.mark.nightly
@pytest.mark.parametrize(
    "changes",
    [
        {"policies": "side"},
        {"prioritised": True},
        {"settings": {"target_kl": 0.001}},
        {"memory": 16},
        {"critic": "state"},
        {"warm_start": f"scripted:{EACH}"},
    ],
)
def test_so_are_they_of_other_settings(tmp_path: Path, changes: dict[str, Any]) -> None:
    expected = trained(tmp_path / "one", 2, **changes)
    same(trained(tmp_path / "two", 2, processes=2, **changes), expected)
    close(tmp_path / "two", tmp_path / "one")


@pytest.mark.nightly
def test_a_run_goes_on_with_any_number_of_processes(alone: tuple[Path, dict[str, bytes]], tmp_path: Path) -> None:
    for rollouts, processes in ((1, 2), (2, 1), (3, 3)):
        files = trained(tmp_path, rollouts, processes=processes, resume=rollouts > 1)
    same(files, alone[1])
    close(tmp_path, alone[0])


def test_more_processes_than_worlds_are_refused() -> None:
    with pytest.raises(TrainingError, match="processes = 8: must be from 1 to 7, the number of worlds"):
        config(1, processes=8)


def test_a_saved_policy_is_imitated_by_one_process(alone: tuple[Path, dict[str, bytes]], tmp_path: Path) -> None:
    """Several can go on with the run."""
    teacher = {"warm_start": f"{newest(alone[0])}:{EACH}"}
    trained(tmp_path, 1, **teacher)
    with pytest.raises(TrainingError, match="draws in sequence: imitate it with one process, then resume"):
        trained(tmp_path / "new", 1, processes=2, **teacher)
    trained(tmp_path, 2, resume=True, processes=2, **teacher)


# ---- how they end


def stopped(run: TrainingRun) -> bool:
    """Whether none of the processes that the run started is left."""
    return not any(process.is_alive() for process in run.crew._others.processes)  # type: ignore[attr-defined]


@pytest.mark.nightly
def test_a_process_that_is_killed_ends_the_run_which_can_be_resumed(
    alone: tuple[Path, dict[str, bytes]], tmp_path: Path
) -> None:
    run = TrainingRun(config(3, processes=2), tmp_path)

    def kill(run: TrainingRun) -> None:
        if run.done == EACH and run.now == "epoch 2":
            run.crew._others.processes[0].kill()  # type: ignore[attr-defined]

    with pytest.raises(TrainingError, match=r"^process 2 of 2 was ended by signal 9; continue with --resume$"):
        run.train(kill)
    assert stopped(run)
    assert newest(tmp_path).name == CHECKPOINT.format(EACH)
    same(trained(tmp_path, 3, resume=True), alone[1])


@pytest.mark.nightly
def test_a_full_disk_ends_all(tmp_path: Path) -> None:
    run = TrainingRun(config(3, processes=2), tmp_path)

    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    run.log.write = full  # type: ignore[method-assign]
    with pytest.raises(TrainingError, match="No space left on device; free some space, and continue with --resume"):
        run.train()
    assert stopped(run)
    assert newest(tmp_path).name == CHECKPOINT.format(0)


def failing(crew: Crew, text: str) -> None:
    raise TrainingError(text)


def leaving(crew: Crew, status: int) -> None:
    os._exit(status)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("work", "argument", "message"),
    [(failing, "no room here", "^process 2 of 3: no room here$"), (leaving, 7, "^process . of 3 ended with status 7")],
)
def test_what_goes_wrong_elsewhere_is_said(work: Any, argument: Any, message: str) -> None:
    crew = recruit(3, work, argument)
    with contextlib.closing(crew), pytest.raises(TrainingError, match=message):
        crew.gather_values(0)


def echo(crew: Crew) -> None:
    """What the test does in the first process."""
    exchange(crew)


def exchange(crew: Crew) -> list[Any]:
    part = np.arange(crew.rank * 10, crew.rank * 10 + crew.rank + 1)
    total = [torch.full((2, 2), float(crew.rank)), torch.ones(1)]
    crew.sum(total)
    narrow = np.zeros((2, crew.rank, 0), np.float32)
    return [
        crew.gather(part),
        crew.gather(part[None], 1),
        total,
        crew.gather(narrow, 1),
        crew.gather_values(part[0].item()),
    ]


def test_what_is_exchanged() -> None:
    with contextlib.closing(recruit(3, echo)) as crew:
        rows, columns, total, narrow, values = exchange(crew)
    assert rows.tolist() == [0, 10, 11, 20, 21, 22]
    assert columns.tolist() == [rows.tolist()]
    assert [each.tolist() for each in total] == [[[3.0, 3.0], [3.0, 3.0]], [3.0]]
    assert (narrow.shape, narrow.dtype) == ((2, 3, 0), np.float32)
    assert values == [0, 10, 20]
    assert [list(Crew(rank, 3).share(7)) for rank in range(3)] == [[0, 1], [2, 3], [4, 5, 6]]


# ---- the command


@contextlib.contextmanager
def command(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """outlast train with two processes, which has saved a checkpoint, in a process group of its own."""
    words = [sys.executable, "-m", "outlast", "train", "ffa_1", "--preset", "fast", "--quiet", "--out", str(folder)]
    words += ["--processes", "2", "--worlds", "8", "--rollout", "256", "--every", "1000", "--steps", "1e9"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen([*words, "--threads", "1"], start_new_session=True, text=True, **pipes) as process:  # type: ignore[call-overload]
        try:
            until(lambda: len(list(folder.glob("steps_*.zip"))) > 1 or process.poll() is not None)
            assert process.poll() is None, process.communicate()[0]
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def until(true: Any) -> None:
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end
        time.sleep(0.05)


def children(pid: int) -> list[int]:
    """The processes that were started by this one."""
    return [int(text) for text in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def lives(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


@pytest.mark.nightly
@linux
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_to_all_saves_and_ends_all(tmp_path: Path, number: int, status: int) -> None:
    with command(tmp_path / "run") as process:
        others = children(process.pid)
        os.killpg(process.pid, number)  # as a terminal does, and a cluster
        output, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == status
    assert "outlast: stopped: continue with --resume" in output
    assert "Traceback" not in output
    assert "trained " in output
    until(lambda: not any(map(lives, others)))


@pytest.mark.nightly
@linux
def test_who_is_left_alone_ends(tmp_path: Path) -> None:
    with command(tmp_path / "run") as process:
        others = children(process.pid)
        assert others
        process.kill()
        output, _ = process.communicate(timeout=PATIENCE)
        until(lambda: not any(map(lives, others)))
    assert "Traceback" not in output
