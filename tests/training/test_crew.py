"""Several processes train as one does: the same numbers, the same files; and they end together."""

import contextlib
import io
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from outlast import variant
from outlast.envs.rollout.saved import CHECKPOINT, newest
from outlast.envs.snapshots import state
from outlast.training.base import policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.base.policy_file import WEIGHTS
from outlast.training.policies import checkpoint
from outlast.training.ppo.crew import Crew, recruit
from outlast.training.runs.run import TrainingConfig, TrainingRun
from tests.helpers.child_processes import PATIENCE, children, lives, until
from tests.helpers.runs import points

SHORT = variant("teams_2").replace(
    agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10
)
WORLDS, STEPS = 7, 32
EACH = WORLDS * STEPS * 4  # agent-steps of a rollout
MIXTURE = {"self": 0.5, "past": 0.3, "scripted": 0.2}
ADAM_STEP = 2e-3  # the learning rate: the most by which one step moves a weight
linux = pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="looks into /proc")


def config(rollouts: int, **changes: Any) -> TrainingConfig:
    """Small, with opponents, past selves after each update, and rewards that are scaled."""
    given = {"scenario": SHORT, "preset": "fast", "steps": rollouts * EACH, "worlds": WORLDS, "threads": 1}
    given |= {"rollout": WORLDS * STEPS, "opponents": MIXTURE, "snapshots": 1, "every": EACH, "seed": 3}
    return TrainingConfig(
        **(given | {"settings": {"batch_size": 64, "anneal_lr": False, "learning_rate": ADAM_STEP}} | changes)
    )


def trained(folder: Path, rollouts: int, *, resume: bool = False, **changes: Any) -> dict[str, bytes]:
    TrainingRun(config(rollouts, **changes), folder, resume=resume).train()
    return checkpoint.read_checkpoint(newest(folder))


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, bytes]]:
    folder = tmp_path_factory.mktemp("alone")
    return folder, trained(folder, 3)


def same(files: dict[str, bytes], expected: dict[str, bytes], tolerance: float = ADAM_STEP / 2) -> None:
    """Check that worlds are the same bit for bit, and tensors nearly.

    Processes add float32 numbers in another order, and Adam magnifies the rounding of small gradients: to 6e-5 on one
    machine, to 1e-6 on another. A gradient that misses a process moves weights by several of Adam's steps.
    """
    one, other = (state.read(io.BytesIO(each["worlds.npz"]), "worlds").arrays for each in (files, expected))
    np.testing.assert_equal(one, other)
    for name in (WEIGHTS, checkpoint.REST):
        (text, tensors), (its, wanted) = (policy_file.parse_tensors(each[name]) for each in (files, expected))
        assert text == its
        torch.testing.assert_close(tensors, wanted, rtol=0, atol=tolerance, equal_nan=True)


def close(folder: Path, expected: Path) -> None:
    """Check that the logs are nearly the same, but for times."""
    one, other = map(points, (folder, expected))
    assert one.keys() == other.keys()
    for tag, rows in one.items():
        np.testing.assert_allclose(rows, other[tag], rtol=1e-3, atol=1e-4, err_msg=tag)


OPTIONS: list[dict[str, Any]] = [{}, {"policies": "side"}, {"prioritised": True}, {"memory": 16}, {"critic": "state"}]
OPTIONS += [{"settings": {"target_kl": 0.001}}, {"warm_start": f"scripted:{EACH}"}]


@pytest.mark.parametrize("changes", OPTIONS, ids=str)
@pytest.mark.by_day(1)
def test_numbers_are_those_of_one_process(alone: Any, tmp_path: Path, changes: dict[str, Any]) -> None:
    folder, files = (tmp_path / "one", trained(tmp_path / "one", 2, **changes)) if changes else alone
    same(trained(tmp_path / "more", 2 if changes else 3, processes=2, **changes), files)
    close(tmp_path / "more", folder)


@pytest.mark.nightly
def test_a_run_goes_on_with_any_number_of_processes(alone: tuple[Path, dict[str, bytes]], tmp_path: Path) -> None:
    for rollouts, processes in ((1, 2), (2, 1), (3, 3)):
        files = trained(tmp_path, rollouts, processes=processes, resume=rollouts > 1)
    same(files, alone[1])
    close(tmp_path, alone[0])


def test_a_saved_policy_is_imitated_by_one_process(alone: tuple[Path, dict[str, bytes]], tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="draws in sequence: imitate it with one process, then resume"):
        trained(tmp_path, 1, processes=2, warm_start=f"{newest(alone[0])}:{EACH}")


@pytest.mark.nightly
def test_a_process_that_is_killed_ends_the_run_which_can_be_resumed(alone: Any, tmp_path: Path) -> None:
    run = TrainingRun(config(3, processes=2), tmp_path)

    def kill(run: TrainingRun) -> None:
        if run.done == EACH and run.now == "epoch 2":
            run.crew._others.processes[0].kill()  # type: ignore[attr-defined]

    with pytest.raises(TrainingError, match=r"^process 2 of 2 was ended by signal 9; continue with --resume$"):
        run.train(kill)
    assert not any(process.is_alive() for process in run.crew._others.processes)  # type: ignore[attr-defined]
    assert newest(tmp_path).name == CHECKPOINT.format(EACH)
    same(trained(tmp_path, 3, resume=True), alone[1])


def failing(crew: Crew) -> None:
    raise TrainingError("no room here")


@pytest.mark.nightly
def test_what_goes_wrong_elsewhere_is_reported() -> None:
    crew = recruit(3, failing)
    with contextlib.closing(crew), pytest.raises(TrainingError, match=r"^process 2 of 3: no room here$"):
        crew.gather_values(0)


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


@pytest.mark.nightly
@linux
@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGKILL, -signal.SIGKILL)]
)
def test_all_processes_end_by_a_signal_and_save_if_they_can(tmp_path: Path, number: int, status: int) -> None:
    with command(tmp_path / "run") as process:
        others = children(process.pid)
        assert others
        if number == signal.SIGKILL:
            process.kill()
        else:
            os.killpg(process.pid, number)  # as a terminal does, and a cluster
        output, _ = process.communicate(timeout=PATIENCE)
        until(lambda: not any(map(lives, others)))
    assert process.returncode == status
    assert "Traceback" not in output
    assert ("outlast: stopped: continue with --resume" in output) == ("trained " in output) == (status > 0)
