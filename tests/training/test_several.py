"""outlast train with several variants or seeds: a process each, side by side."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from outlast.envs.rollout.saved import CHECKPOINT
from outlast.training.base.errors import TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.envs.cli.main import parser  # noqa: E402
from outlast.training.cli import train  # noqa: E402
from outlast.training.runs.child_runs import ChildRun, side_by_side  # noqa: E402
from outlast.training.runs.live_view import LiveView  # noqa: E402
from tests.training.test_crew import children  # noqa: E402
from tests.training.test_run import names, outlast_train, points  # noqa: E402

TINY = ("--preset", "original", "--ppo", "n_epochs=1", "--rollout", "512", "--worlds", "8", "--quiet")


@pytest.mark.nightly
def test_seeds_and_variants_are_trained_side_by_side(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What comes out is what single runs give."""
    options = ("--steps", "1024", *TINY, "--out")
    assert outlast_train("ffa_1", "1v1_heals_mid", "--seed", "0", "3", *options, str(tmp_path)) == 0
    output = capsys.readouterr().out
    for name in ("ffa_1-original-0", "ffa_1-original-3", "ffa_2-original-0", "ffa_2-original-3"):
        assert f"{name}: trained 1,024 agent-steps in" in output
        assert names(tmp_path / name) == [CHECKPOINT.format(1024)]
    assert outlast_train("ffa_2", "--seed", "3", "--threads", "1", *options, str(tmp_path / "one")) == 0
    assert points(tmp_path / "one") == points(tmp_path / "ffa_2-original-3")
    assert points(tmp_path / "one") != points(tmp_path / "ffa_2-original-0")


@pytest.mark.nightly
def test_several_go_on_and_a_failure_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = ("--seed", "0", "1", *TINY, "--out", str(tmp_path))
    alone = ("--seed", "0", "--steps", "1024", *TINY, "--out", str(tmp_path / "ffa_1-original-0"))
    assert outlast_train("ffa_1", *alone) == 0
    assert outlast_train("ffa_1", "--steps", "2048", *small) == 2
    output = capsys.readouterr().out
    assert "ffa_1-original-0: outlast: " in output
    assert "is not empty: go on with --resume" in output
    assert "ffa_1-original-1: trained 2,048 agent-steps" in output
    assert outlast_train("ffa_1", "--steps", "2048", "--resume", *small) == 0
    assert names(tmp_path / "ffa_1-original-0") == [CHECKPOINT.format(n) for n in (1024, 2048)]


def test_a_run_ends_well_while_its_input_is_open(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The thread that reads it must hold nothing that Python needs at its end."""
    run = ChildRun(tmp_path / "run", ["--help"], resume=False)
    run.start()
    assert run.report() == 0
    assert "outlast train ffa_2 --resume" in capsys.readouterr().out  # the end of the help


def test_a_run_may_print_as_much_as_it_likes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """More than a pipe holds, as a system with `print` does."""
    run = ChildRun(tmp_path / "run", [], resume=False)
    run.words = [sys.executable, "-c", "print('said\\n' * 100_000, 'at last\\n')"]
    run.start()
    assert run.process.wait(30) == run.report() == 0
    assert capsys.readouterr().out == "run: at last\n"


class Killed(ChildRun):
    def start(self) -> None:
        super().start()
        self.process.kill()


def test_a_run_that_was_killed_failed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also beside others that end well."""
    runs = [kind(tmp_path / name, ["--help"], resume=False) for kind, name in ((Killed, "killed"), (ChildRun, "well"))]
    assert side_by_side(runs, 2, LiveView(0, 1, quiet=True), lambda: 0) == 128 + signal.SIGKILL
    assert "killed: ended by signal 9: ended without a word" in capsys.readouterr().out


def test_every_option_reaches_every_run() -> None:
    """Words of options that differ from the usual in every option give the same options again."""
    (command,) = (each.choices["train"] for each in parser()._actions if isinstance(each.choices, dict))
    given = """
        --layout=maze --set=n_agents=3 --set=melee_damage=4 --vary=melee_reach=uniform(1,2) --without=heals --with=Maze
        --import=a.py --roles=r.json --save-scenario=s.json --preset=paper --steps=7 --ppo=gamma=0.5 --anneal=a=1:2
        --policies=side --memory=3 --critic=state --dead=drop --warm-start=scripted --opponents=self:2,past
        --prioritised --snapshots=4 --worlds=8 --rollout=512 --every=9 --film --quiet --out=o --resume --seed 3
        --device=cuda --threads=2 --processes=2 --jobs=2 --halves --ray
    """
    options = command.parse_args(["ffa_1", *given.split()])
    usual = command.parse_args(["ffa_1"])
    assert [name for name in vars(usual) if getattr(usual, name) == getattr(options, name)] == ["variant", "run"]
    again = command.parse_args(["ffa_1", *command.words(options, leave_out=train.OWN)])
    different = {name for name in vars(usual) if getattr(again, name) != getattr(options, name)}
    assert different == set(train.OWN) - {"variant"}
    assert command.words(usual) == []


def test_the_same_run_twice_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="name each variant and each seed once"):
        outlast_train("ffa_1", "1v1_heals_low", "--out", str(tmp_path))


def test_resumed_runs_without_a_checkpoint_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A run that was killed before its first one, and a run that never began."""
    monkeypatch.setattr(train, "side_by_side", lambda *_: 0)
    for k, name in enumerate(["log.csv", CHECKPOINT.format(1024)]):
        (tmp_path / f"ffa_1-fast-{k}").mkdir()
        (tmp_path / f"ffa_1-fast-{k}" / name).touch()
    assert outlast_train("ffa_1", "--seed", "0", "1", "2", "--resume", "--out", str(tmp_path)) == 0
    assert capsys.readouterr().err.splitlines()[1] == "no checkpoint yet, begins at 0: ffa_1-fast-0, ffa_1-fast-2"


def test_one_run_has_no_jobs(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="--jobs has no effect on one run: leave it out, or name several"):
        outlast_train("ffa_1", "--jobs", "2", "--out", str(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


@contextlib.contextmanager
def two_runs(
    folder: Path, prepare: Callable[[], object] | None = None
) -> Iterator[tuple["subprocess.Popen[str]", list[Path]]]:
    """A command that trains two runs, which have logged something; and their logs. prepare: called in its process."""
    words = [sys.executable, "-m", "outlast", "train", "ffa_1", "ffa_2", "--jobs", "2", "--out", str(folder), *TINY]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True, preexec_fn=prepare) as process:
        logs = [folder / f"{name}-original-0/log.csv" for name in ("ffa_1", "ffa_2")]
        deadline = time.monotonic() + 200
        while not all(log.exists() and log.read_text().count("\n") > 1 for log in logs):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.2)
        yield process, logs


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
def test_killed_all_of_them_save_and_end(tmp_path: Path) -> None:
    with two_runs(tmp_path, lambda: signal.signal(signal.SIGINT, signal.SIG_IGN)) as (process, logs):
        process.kill()  # one that a script has begun in the background
    deadline = time.monotonic() + 100
    while not all(names(log.parent) for log in logs):  # a run that is killed has no checkpoint so early
        assert time.monotonic() < deadline
        time.sleep(0.2)
    time.sleep(1)
    sizes = [log.stat().st_size for log in logs]
    time.sleep(2)
    assert [log.stat().st_size for log in logs] == sizes  # nobody goes on


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)])
def test_asked_or_stopped_all_of_them_save(tmp_path: Path, number: int, status: int) -> None:
    """Clusters send SIGTERM to every process, and the command stops its runs: they are interrupted twice."""
    with two_runs(tmp_path) as (process, logs):
        process.send_signal(signal.SIGUSR1)
        deadline = time.monotonic() + 100
        while not all(names(log.parent) for log in logs):  # no other checkpoint comes so early
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.2)
        for pid in [*children(process.pid), process.pid] if number == signal.SIGTERM else [process.pid]:
            os.kill(pid, number)
        out, err = process.communicate(timeout=100)
    assert process.returncode == status
    assert err.strip() == "outlast: stopped: go on with --resume"
    assert out.count(": trained ") == 2
    assert all(names(log.parent) for log in logs)
