"""outlast.train: a run in one call; and what a run comprises is said before it begins."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.ecs import NumberError
from outlast.envs.errors import UsageError
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.training.runs.live_view import LiveView

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training.base.config import TrainingConfig, Workload  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from tests.training.test_run import names, outlast_train, points  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
TINY: dict[str, Any] = {"preset": "original", "worlds": 8, "rollout": 512, "threads": 1, "settings": {"n_epochs": 1}}
WORDS = [
    "--preset",
    "original",
    "--worlds",
    "8",
    "--rollout",
    "512",
    "--threads",
    "1",
    "--ppo",
    "n_epochs=1",
    "--quiet",
]


def test_a_run_in_one_call_is_that_of_the_command(tmp_path: Path) -> None:
    run = outlast.train("ffa_1", tmp_path / "a", steps=1500, seed=3, **TINY, quiet=True, melee_damage=20)
    more = ("--steps", "1500", "--seed", "3", "--set", "melee_damage=20", "--out", str(tmp_path / "b"))
    assert outlast_train("ffa_1", *WORDS, *more) == 0
    assert points(tmp_path / "a") == points(tmp_path / "b")
    assert (run.folder, run.steps, run.policy.name) == (tmp_path / "a", 2048, CHECKPOINT.format(2048))
    assert run.logged["time/env_steps"] == 1024
    again = outlast.train("ffa_1", tmp_path / "a", steps=2500, seed=3, **TINY, quiet=True, resume=True, melee_damage=20)
    assert again.steps == 3072
    done = outlast.train("ffa_1", tmp_path / "a", steps=2500, seed=3, **TINY, quiet=True, resume=True, melee_damage=20)
    assert done.logged == pytest.approx(again.logged, nan_ok=True)
    assert outlast.load_policy(again.policy).header["steps"] == 3072


def test_settings_are_texts_or_what_they_stand_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    weights = "self:0.5,scripted:0.5"
    one = outlast.train("ffa_1", steps=1, **TINY, quiet=True, opponents=weights, anneal="rewards_kill=10:0")
    assert one.folder == Path("runs/ffa_1-original-0")
    both = {"opponents": {"self": 0.5, "scripted": 0.5}, "anneal": ["rewards_kill=10:0"]}
    other = outlast.train("ffa_1", "other", steps=1, **TINY, quiet=True, **both)
    assert points(one.folder) == points(other.folder)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"melee_damge": 3}, "did you mean melee_damage"),
        ({"step": 3}, "did you mean steps"),
        ({"opponent": "past"}, "did you mean opponents"),
        ({"gamma": 0.9}, r"gamma is a number of PPO: settings=\{'gamma': 0.9\}"),
        ({"settings": {"gama": 0.9}}, "did you mean gamma"),
        ({"opponents": "slef"}, "did you mean self"),
        ({"preset": "quick"}, "there is no preset 'quick'"),
        ({"anneal": "rewards_kill"}, "NUMBER=FROM:TO"),
        ({"anneal": None}, "anneal = None: a text or a list of texts is needed, as in 'rewards_kill=10:0@5e6'"),
        ({"anneal": [3]}, r"anneal = \[3\]: a text or a list of texts"),
        (
            {"settings": "gamma=0.9"},
            "settings = 'gamma=0.9': numbers of PPO by name are needed, as in {'gamma': 0.995}",
        ),
        ({"settings": 3}, "settings = 3: numbers of PPO by name"),
        ({"opponents": {max: 1, "self": 1}}, "opponents: <built-in function max> is no opponent of training: names or"),
        ({"opponents": ["self", "past"]}, r"opponents = \['self', 'past'\]: names .* {'self': 1, 'runs/a': 1}"),
        ({"opponents": None}, "opponents = None: names or paths of saved policies are needed, with weights"),
        ({"warm_start": max}, "warm_start = <built-in function max>: a name, such as 'scripted', or the path of a"),
        ({"warm_start": None}, "warm_start = None: a name"),
        ({"processes": "2"}, "processes = '2': a whole number from 1 is needed"),
        ({"processes": 1.5}, "processes = 1.5: a whole number from 1 is needed"),
        ({"levels": lambda progress: []}, "ffa_1 has no levels to choose, .*: vary some"),
    ],
)
def test_mistakes_are_refused_before_anything_is_made(tmp_path: Path, wrong: dict[str, Any], words: str) -> None:
    with pytest.raises((NumberError, UsageError, outlast.ScenarioError), match=words):
        outlast.train("ffa_1", tmp_path / "run", **wrong)
    assert not (tmp_path / "run").exists()


def test_the_path_of_a_run_is_a_warm_start_and_an_opponent(tmp_path: Path) -> None:
    run = outlast.train("ffa_1", tmp_path / "first", steps=1, **TINY, quiet=True)
    more: dict[str, Any] = {"warm_start": run.policy, "opponents": {run.folder: 1, "self": 1}}
    again = outlast.train("ffa_1", tmp_path / "second", steps=1, **TINY, quiet=True, **more)
    plan = outlast.load_policy(again.policy).header["plan"]
    assert plan["warm_start"] == str(run.policy)
    assert plan["opponents"] == f"{run.policy}:1,self:1"


def test_ctrl_c_saves_and_is_raised(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(view: LiveView, done: int, *_: object) -> None:
        if done:
            raise KeyboardInterrupt

    monkeypatch.setattr(LiveView, "update", interrupt)
    with pytest.raises(KeyboardInterrupt):
        outlast.train("ffa_1", tmp_path, steps=10_000, **TINY, quiet=True)
    assert names(tmp_path) == [CHECKPOINT.format(1024)]


# ---- what a run comprises


def work(steps: int, **options: Any) -> Workload:
    return Workload.of(TrainingConfig(outlast.variant("ffa_2"), steps=steps, **options))


def test_returns_of_agents_that_come_back_do_not_end_at_a_death() -> None:
    back = outlast.variant("ffa_2").with_(outlast.systems.Respawn()).replace(ending_rule="never", ending_limit=9)
    assert TrainingConfig(back, steps=1).dead == "keep"
    with pytest.raises(TrainingError, match="dead = 'drop': agents come back here"):
        TrainingConfig(back, steps=1, dead="drop")


def test_whole_rollouts_are_said_before_they_are_collected() -> None:
    """F23: --steps 100 collects 65,536, and showed 0.00/100 meanwhile."""
    sizes = "(256 worlds x 128 steps x 2 agents)"
    assert str(work(100)) == f"100 agent-steps, rounded up to one rollout of 65,536 {sizes}"
    assert str(work(10**7)) == f"10,000,000 agent-steps in 153 rollouts of 65,536 {sizes}"
    assert (work(100).total, work(10**7).total, work(65_537).total) == (65_536, 153 * 65_536, 131_072)
    varied = outlast.variant("ffa_2").vary(n_agents=outlast.integers(2, 3))
    asked = TrainingConfig(varied, steps=8192, worlds=8, rollout=1024)
    assert str(Workload.of(asked)) == "8,192 agent-steps in 3 rollouts of 3,072 (8 worlds x 128 steps x 3 agents)"
    partly = work(10**7, opponents={"self": 0.5, "scripted": 0.5})  # steps of opponents count
    assert (str(partly), partly.total) == (str(work(10**7)), work(10**7).total)


def test_the_first_line_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outlast.train("ffa_1", tmp_path, steps=100, **TINY)
    first, *_, last = capsys.readouterr().err.splitlines()
    assert first == (
        "ffa_1, preset original, seed 0: 100 agent-steps, rounded up to one rollout of 1,024 "
        "(8 worlds x 64 steps x 2 agents), with an update after each"
    )
    assert last.startswith("1.02k of 1.02k agent-steps; ")


def test_a_run_that_has_no_checkpoint_to_go_on_from_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As after a kill before the first checkpoint; a run that does go on says nothing of it."""
    outlast.train("ffa_1", tmp_path, steps=100, **TINY)
    words = f"no checkpoint in {tmp_path} yet: begins at 0"
    assert words not in capsys.readouterr().err
    outlast.train("ffa_1", tmp_path, steps=2000, resume=True, **TINY)
    assert words not in capsys.readouterr().err
    for file in tmp_path.glob("steps_*.zip"):
        file.unlink()
    assert outlast.train("ffa_1", tmp_path, steps=100, resume=True, **TINY).steps == 1024
    assert capsys.readouterr().err.splitlines()[1] == words


def test_a_run_does_not_load_the_compiler_of_pytorch(tmp_path: Path) -> None:
    """It takes seconds and 80 MB. A process of its own, as other tests may have loaded it."""
    program = "import sys, outlast; outlast.train('ffa_1', sys.argv[1], steps=1, worlds=8, rollout=64, quiet=True); "
    program += "sys.exit('torch._dynamo' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program, str(tmp_path / "run")], check=False).returncode == 0
