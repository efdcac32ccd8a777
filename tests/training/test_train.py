"""`outlast.train` and `outlast train`: a run in one call, and several side by side, in a process each."""

import contextlib
import inspect
import itertools
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.ecs import NumberError
from outlast.envs.api.options import flag_of, options_of
from outlast.envs.cli.main import parser
from outlast.envs.errors import UsageError
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.training.base.config import RunOptions, TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.quantities import LiveView
from outlast.training.cli import train
from outlast.training.runs.child_runs import ChildRun, side_by_side
from tests import options
from tests.helpers.child_processes import children, lives, until
from tests.helpers.runs import assert_same, names, outlast_train, points

TINY: dict[str, Any] = {"preset": "original", "worlds": 8, "rollout": 512, "threads": 1, "settings": {"n_epochs": 1}}
WORDS = ("--preset=original", "--worlds=8", "--rollout=512", "--threads=1", "--ppo=n_epochs=1", "--quiet")


def test_a_run_in_one_call_is_that_of_the_command(tmp_path: Path, monkeypatch, capsys) -> None:
    """Settings are texts, or what they stand for."""
    monkeypatch.chdir(tmp_path)
    given: dict[str, Any] = TINY | {"seed": 3, "quiet": True, "melee_damage": 20, "memory": 8, "critic": "state"}
    given |= {"opponents": {"self": 0.5, "scripted": 0.5}, "anneal": ["rewards_kill=10:0@1e5"]}
    texts = given | {"opponents": "self:0.5,scripted:0.5", "anneal": "rewards_kill=10:0@1e5"}
    run = outlast.train("ffa_1", steps=1500, **texts)
    words = "--steps 1.5e3 --seed 3 --set melee_damage=20 --memory 8 --critic state --opponents self:0.5,scripted:0.5"
    assert outlast_train("ffa_1", *WORDS, *words.split(), "--anneal", "rewards_kill=10:0@1e5", "--out", "a") == 0
    assert "a: 2,048 agent-steps, which are 1,024 env" in capsys.readouterr().out
    assert_same(tmp_path / "a", run.folder)
    assert (run.folder, run.steps) == (Path("runs/ffa_1-melee_damage=20-original-3"), 2048)
    assert (run.policy.name, run.logged["time/env_steps"]) == (CHECKPOINT.format(2048), 1024)
    again = outlast.train("ffa_1", run.folder, steps=2500, **given, resume=True)
    assert again.steps == 3072
    done = outlast.train("ffa_1", run.folder, steps=2500, **given, resume=True)
    assert done.logged == pytest.approx(again.logged, nan_ok=True)
    assert outlast.load_policy(again.policy).header["steps"] == 3072


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"melee_damge": 3}, "did you mean melee_damage"),
        ({"opponent": "past"}, "did you mean opponents"),
        ({"gamma": 0.9}, r"gamma is a number of PPO: settings=\{'gamma': 0.9\}"),
        ({"settings": {"gama": 0.9}}, "did you mean gamma"),
        ({"opponents": "slef"}, "did you mean self"),
        ({"critic": "world"}, "critic = 'world': allowed are 'own', 'state'"),
        ({"anneal": None}, "anneal = None: must be a text or a list of texts, as in 'rewards_kill=10:0@5e6'"),
        ({"settings": "gamma=0.9"}, "settings = 'gamma=0.9': must be numbers of PPO by name, as in"),
        ({"opponents": {max: 1, "self": 1}}, "<built-in function max> is not an opponent: they must be names or"),
        ({"opponents": ["self", "past"]}, r"opponents = \['self', 'past'\]: must be names .* {'self': 1, 'runs/a': 1}"),
        ({"warm_start": max}, "<built-in function max>: must be a name, such as 'scripted', or the path of a"),
        ({"processes": 1.5}, "processes = 1.5: an integer >= 1 is needed"),
        ({"processes": 9, "worlds": 8}, "processes = 9: must be from 1 to 8, the number of worlds"),
        ({"opponents": "self,past", "prioritised": "no"}, "prioritised = 'no': allowed are True and False"),
        ({"levels": lambda progress: []}, "ffa_1 has no levels to choose, .*: vary some"),
    ],
)
def test_mistakes_are_refused_before_anything_is_made(tmp_path: Path, wrong: dict[str, Any], words: str) -> None:
    with pytest.raises((NumberError, UsageError, outlast.errors.ScenarioError), match=words):
        outlast.train("ffa_1", tmp_path / "run", **wrong)
    assert not (tmp_path / "run").exists()


def work(steps: int, **options: Any) -> TrainingConfig:
    return TrainingConfig(outlast.variant("ffa_2"), steps=steps, **options)


def test_returns_of_agents_that_come_back_do_not_end_at_a_death() -> None:
    back = outlast.variant("ffa_2").with_(outlast.systems.Respawn()).replace(ending_rule="never", ending_limit=9)
    assert TrainingConfig(back, steps=1).dead == "keep"
    with pytest.raises(TrainingError, match="dead = 'drop': agents respawn here"):
        TrainingConfig(back, steps=1, dead="drop")


def test_whole_rollouts_are_said_before_they_are_collected() -> None:
    sizes = "(256 worlds x 128 steps x 2 agents)"
    assert work(100).workload == f"100 agent-steps, rounded up to one rollout of 65,536 {sizes}"
    assert work(10**7).workload == f"10,000,000 agent-steps in 153 rollouts of 65,536 {sizes}"
    assert (work(100).total, work(10**7).total, work(65_537).total) == (65_536, 153 * 65_536, 131_072)
    varied = outlast.variant("ffa_2").vary(n_agents=outlast.distributions.integers(2, 3))
    asked = TrainingConfig(varied, steps=8192, worlds=8, rollout=1024)
    assert asked.workload == "8,192 agent-steps in 3 rollouts of 3,072 (8 worlds x 128 steps x 3 agents)"
    partly = work(10**7, opponents={"self": 0.5, "scripted": 0.5})  # steps of opponents count
    assert (partly.workload, partly.total) == (work(10**7).workload, work(10**7).total)


def test_the_first_line_says_it_and_whether_a_resumed_run_begins_at_0(tmp_path: Path, capsys) -> None:
    """As after a kill before the first checkpoint; a run that does go on says nothing of it."""
    for steps, resume, gone in ((100, False, False), (2000, True, False), (100, True, True)):
        for file in tmp_path.glob("steps_*.zip") if gone else ():
            file.unlink()
        assert outlast.train("ffa_1", tmp_path, steps=steps, resume=resume, **TINY).steps == 1024 * (1 + steps // 2000)
        first, *rest = capsys.readouterr().err.splitlines()
        assert (f"no checkpoint in {tmp_path} yet: begins at 0" in rest) == gone
        if steps == 100:
            words = "ffa_1, preset original, seed 0: 100 agent-steps, rounded up to one rollout of 1,024 "
            assert first == f"{words}(8 worlds x 64 steps x 2 agents), with an update after each"
            assert rest[-1].startswith("1.02k of 1.02k agent-steps; ")


def test_what_is_slow_to_load_is_not_loaded(tmp_path: Path) -> None:
    """It takes seconds and 80 MB. A process of its own, as other tests may have loaded it."""
    program = "import sys, outlast; outlast.train('ffa_1', sys.argv[1], steps=1, worlds=8, rollout=64, quiet=True); "
    program += "sys.exit('torch._dynamo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program, str(tmp_path / "run")], check=False).returncode == 0
    # and without what else is slow to load
    text = "import sys; from outlast.training.cli import plot, train, watch\n"
    text += "assert not {'torch', 'stable_baselines3', 'http.server', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", text], check=True)


@pytest.mark.nightly
def test_seeds_and_variants_are_trained_side_by_side(tmp_path: Path, capsys) -> None:
    """What comes out is what single runs give; one that fails is reported, and the others go on."""
    options = ("--steps", "1024", *WORDS, "--out")
    assert outlast_train("ffa_1", "1v1_heals_mid", "--seed", "0", "3", *options, str(tmp_path)) == 0
    output = capsys.readouterr().out
    for name in ("ffa_1-original-0", "ffa_1-original-3", "ffa_2-original-0", "ffa_2-original-3"):
        assert f"{name}: trained 1,024 agent-steps in" in output
        assert names(tmp_path / name) == [CHECKPOINT.format(1024)]
    assert outlast_train("ffa_2", "--seed", "3", "--threads", "1", *options, str(tmp_path / "one")) == 0
    assert points(tmp_path / "one") == points(tmp_path / "ffa_2-original-3")
    assert points(tmp_path / "one") != points(tmp_path / "ffa_2-original-0")
    longer = ("--seed", "0", "1", "--steps", "2048", *WORDS, "--out", str(tmp_path))
    assert outlast_train("ffa_1", *longer) == 2
    output = capsys.readouterr().out
    assert re.search("ffa_1-original-0: outlast: .*is not empty: take --resume", output)
    assert "ffa_1-original-1: trained 2,048 agent-steps" in output
    assert outlast_train("ffa_1", *longer, "--resume") == 0
    assert names(tmp_path / "ffa_1-original-0") == [CHECKPOINT.format(n) for n in (1024, 2048)]


def test_a_sweep_is_a_run_of_each_combination(tmp_path: Path, monkeypatch) -> None:
    found: list[ChildRun] = []
    monkeypatch.setattr(train, "side_by_side", lambda runs, *_: found.extend(runs) or 0)
    words = ("--sweep", "melee_damage=5,20", "--sweep", "gamma=0.9,0.99", "--seed", "0", "1", "--out", str(tmp_path))
    assert outlast_train("ffa_1", *WORDS, *words, "--set", "heals_count=3") == 0
    names = [f"ffa_1-n_heals=3{mark}" for mark in ("", "-melee_damage=20")]
    pairs = itertools.product(names, ("gamma=0.9", "gamma=0.99"), "01")
    assert [run.name for run in found] == [f"{name}-{gamma}-original-{seed}" for name, gamma, seed in pairs]
    planned = []
    monkeypatch.setattr(train, "_train_one", lambda options, run: planned.append((options, run.config)) or 0)
    for run in found:
        assert outlast_train(*run.words[4:]) == 0
    configs = [(config.scenario.numbers()["melee_damage"], config.numbers.gamma, config.seed) for _, config in planned]
    assert configs == [*itertools.product((5, 20), (0.9, 0.99), (0, 1))]
    assert {config.scenario.numbers()["heals_count"] for _, config in planned} == {3}
    assert [Path(options.out).name for options, _ in planned] == [run.name for run in found]


@pytest.mark.parametrize(
    ("program", "status", "last"),
    [
        ("", 0, "outlast train ffa_2 --resume"),  # the end of the help; what reads its input must hold nothing
        ("print('said\\n' * 100_000, 'at last\\n')", 0, "run: at last\n"),  # more than a pipe holds
        ("import os; os.kill(os.getpid(), 9)", 128 + 9, "run: ended by signal 9: ended without output"),
    ],
    ids=["help", "much", "killed"],
)
def test_a_run_ends_well_whatever_it_prints(program: str, status: int, last: str, tmp_path: Path, capsys) -> None:
    runs = [ChildRun(tmp_path / name, ["--help"], resume=False) for name in ("run", "other")]
    if program:
        runs[0].words = [sys.executable, "-c", program]
    assert side_by_side(runs, 2, LiveView(0, 1, quiet=True), lambda: 0) == status
    assert last in capsys.readouterr().out


def test_every_option_reaches_every_run() -> None:
    (command,) = (each.choices["train"] for each in parser()._actions if isinstance(each.choices, dict))
    given = """
        --layout=maze --set=n_agents=3 --set=melee_damage=4 --vary=melee_reach=uniform(1,2) --without=heals --with=Maze
        --import=a.py --roles=r.json --save-scenario=s.json --preset=paper --steps=7 --ppo=gamma=0.5 --anneal=a=1:2
        --policies=side --memory=3 --critic=state --dead=drop --warm-start=scripted --opponents=self:2,past
        --prioritised --snapshots=4 --worlds=8 --rollout=512 --every=9 --film --quiet --out=o --resume --seed 3
        --device=cuda --threads=2 --processes=2 --jobs=2 --ray --sweep=gamma=0.9
    """
    options = command.parse_args(["ffa_1", *given.split()])
    usual = command.parse_args(["ffa_1"])
    assert [name for name in vars(usual) if getattr(usual, name) == getattr(options, name)] == ["variant", "run"]
    again = command.parse_args(["ffa_1", *command.words(options, leave_out=train.OWN)])
    different = {name for name in vars(usual) if getattr(again, name) != getattr(options, name)}
    assert different == set(train.OWN) - {"variant"}
    assert command.words(usual) == []


def test_resumed_runs_without_a_checkpoint_are_named(tmp_path: Path, monkeypatch, capsys) -> None:
    """A run that was killed before its first one, and a run that never began."""
    monkeypatch.setattr(train, "side_by_side", lambda *_: 0)
    for k, name in enumerate(["log.csv", CHECKPOINT.format(1024)]):
        (tmp_path / f"ffa_1-fast-{k}").mkdir()
        (tmp_path / f"ffa_1-fast-{k}" / name).touch()
    assert outlast_train("ffa_1", "--seed", "0", "1", "2", "--resume", "--out", str(tmp_path)) == 0
    assert capsys.readouterr().err.splitlines()[1] == "no checkpoint yet, begins at 0: ffa_1-fast-0, ffa_1-fast-2"


@contextlib.contextmanager
def two_runs(folder: Path, prepare: Callable[[], object] | None) -> Iterator[tuple[Any, list[Path]]]:
    """A command that trains two runs, which have logged something; and their logs. prepare: called in its process."""
    words = [sys.executable, "-m", "outlast", "train", "ffa_1", "ffa_2", "--jobs", "2", "--out", str(folder), *WORDS]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, stdout=pipe, stderr=pipe, text=True, preexec_fn=prepare) as process:
        logs = [folder / f"{name}-original-0/log.csv" for name in ("ffa_1", "ffa_2")]
        until(
            lambda: process.poll() is not None or all(log.exists() and log.read_text().count("\n") > 1 for log in logs)
        )
        assert process.poll() is None
        yield process, logs


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="signals are others there")
@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGKILL, -signal.SIGKILL)],
)
def test_asked_stopped_or_left_alone_all_of_them_save(tmp_path: Path, number: int, status: int) -> None:
    """Clusters send SIGTERM to every process, and the command stops its runs: they are interrupted twice."""
    alone = number == signal.SIGKILL
    with two_runs(tmp_path, partial(signal.signal, signal.SIGINT, signal.SIG_IGN) if alone else None) as (
        process,
        logs,
    ):
        pids = children(process.pid)
        if not alone:
            process.send_signal(signal.SIGUSR1)
            until(lambda: all(names(log.parent) for log in logs))  # no other checkpoint comes so early
        for pid in [*pids, process.pid] if number == signal.SIGTERM else [process.pid]:
            os.kill(pid, number)
        out, err = process.communicate(timeout=100)
    until(lambda: not any(map(lives, pids)))
    assert all(names(log.parent) for log in logs)
    assert process.returncode == status
    assert alone or err.strip() == "outlast: stopped: continue with --resume"
    assert alone or out.count(": trained ") == 2


def test_each_option_is_declared_once_and_said_everywhere(capsys) -> None:
    """Signature, docstring, flags and help follow from the declaration, which a new option is added to alone."""
    assert options.main() == 0, capsys.readouterr().out
    parameters, told = inspect.signature(outlast.train).parameters, inspect.getdoc(outlast.train) or ""
    with pytest.raises(SystemExit):
        parser().parse_args(["train", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    for kind in (RunOptions, TrainingConfig):
        for name, each in options_of(kind).items():
            assert name in parameters
            assert f"{name}: " in told
            assert flag_of(name, each) in shown or not each.group
            assert not each.group or each.text.partition(",")[0].partition(" (")[0] in shown
