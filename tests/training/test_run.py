"""Runs: resumed ones are as if they had never stopped, logs and checkpoints are whole."""

import csv
import inspect
import json
import shutil
import signal
import subprocess
import sys
import zipfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import choice, variant
from outlast.components import OthersView, Phase, Reward, SelfView, Side
from outlast.ecs import Entity, Field, Module, Offset, Read, Rows, Singleton, Write, column, number
from outlast.envs.errors import StateError, UsageError
from outlast.envs.rollout.saved import CHECKPOINT, common_scenario, newest
from outlast.envs.storage.folder_lock import is_lock
from tests.conftest import call

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from safetensors.torch import load  # noqa: E402

from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.hyperparameters import parse_hyperparameters  # noqa: E402
from outlast.training.base.log_file import last_step, read_log  # noqa: E402
from outlast.training.cli import train as command  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.runs import run as runs  # noqa: E402
from outlast.training.runs.run import TrainingRun  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
SHORT = variant("ffa_1").replace(agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10)
EACH = 8 * 24 * 2  # agent-steps of a rollout


def config(steps: int, **changes: Any) -> TrainingConfig:
    settings = {"batch_size": 64, "n_epochs": 3, "target_kl": 0.0}
    given = {"scenario": SHORT, "steps": steps, "preset": "original", "worlds": 8, "rollout": 8 * 24, "threads": 1}
    return TrainingConfig(**(given | {"every": 2 * EACH, "settings": settings, "seed": 3} | changes))


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """The points of a log, but for times."""
    return {tag: values for tag, values in read_log(folder / "log.csv").items() if not tag.startswith("time/")}


class Mark(Singleton):
    size: Any = column("f4")


def marked(size: float) -> Module:
    """A user's mechanic, whose code differs in a prefab value."""
    return type("Marked", (Module,), {"singletons": lambda self: [Mark(size=size)]})()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.zip"))


def assert_same(one: Path, other: Path) -> None:
    """Two runs logged the same, and their last checkpoints hold the same, bit for bit."""
    assert points(one) == points(other)
    files = [checkpoint.read_checkpoint(newest(folder)) for folder in (one, other)]
    assert files[0].keys() == files[1].keys()
    assert [name for name in files[0] if files[0][name] != files[1][name]] == []


def test_a_resumed_run_logs_the_same_numbers(tmp_path: Path) -> None:
    TrainingRun(config(6 * EACH), tmp_path / "whole").train()
    TrainingRun(config(2 * EACH), tmp_path / "parts").train()
    for steps in (3 * EACH, 6 * EACH):
        TrainingRun(config(steps), tmp_path / "parts", resume=True).train()
    assert_same(tmp_path / "whole", tmp_path / "parts")
    asked = [json.loads((tmp_path / name / "run.json").read_text())["asked"] for name in ("whole", "parts")]
    assert asked == [6 * EACH, 6 * EACH]
    whole = points(tmp_path / "whole")
    assert len(whole["train/value_loss"]) == 6
    assert whole["rollout/reward0"][-1] != whole["rollout/reward0"][-2]


def test_a_resumed_run_with_scaled_rewards_and_an_annealed_rate_is_the_same(tmp_path: Path) -> None:
    """Stopped twice; the rate falls along the whole run, and a run of another length would be another one."""
    fast = config(5 * EACH, preset="fast", settings={"batch_size": 64})
    TrainingRun(fast, tmp_path / "whole").train()
    run = TrainingRun(fast, tmp_path / "parts")
    for updates in (2, 3):
        with pytest.raises(KeyboardInterrupt):
            run.train(lambda run, done=updates * EACH: interrupted(run) if run.done == done else None)
        assert names(tmp_path / "parts")[-1] == CHECKPOINT.format(updates * EACH)
        run = TrainingRun(fast, tmp_path / "parts", resume=True)
    run.train()
    assert_same(tmp_path / "whole", tmp_path / "parts")
    rates = [rate for _, rate in points(tmp_path / "whole")["train/learning_rate"]]
    assert rates == pytest.approx([fast.numbers.learning_rate * left for left in (1, 0.8, 0.6, 0.4, 0.2)])
    files = checkpoint.read_checkpoint(newest(tmp_path / "whole"))
    assert checkpoint.load_tree(files, checkpoint.REST)["rewards"]["count"] == 5 * EACH
    with pytest.raises(TrainingError, match=f"begun with steps = {5 * EACH}, not {6 * EACH}: .* --steps {5 * EACH}"):
        TrainingRun(replace(fast, steps=6 * EACH), tmp_path / "parts", resume=True)
    TrainingRun(replace(fast, warm_start=str(tmp_path / "parts")), tmp_path / "on").log.close()  # as it says
    with pytest.raises(TrainingError, match="was begun with settings = "):
        TrainingRun(replace(fast, settings={"batch_size": 64, "anneal_lr": False}), tmp_path / "parts", resume=True)
    named = {**fast.settings, "gamma": fast.numbers.gamma}  # which is the preset's
    TrainingRun(replace(fast, settings=named), tmp_path / "parts", resume=True).train()


def test_pytorch_is_left_as_it_was(tmp_path: Path) -> None:
    """Its threads, with which sums round, and the user's random numbers, also where a run cannot begin."""
    torch.set_num_threads(2)
    try:
        torch.manual_seed(5)
        expected = torch.rand(3)
        torch.manual_seed(5)
        for threads in (1, 3):
            TrainingRun(config(EACH, threads=threads), tmp_path / f"{threads}").train()
            (tmp_path / f"file {threads}").touch()
            with pytest.raises(TrainingError, match="Not a directory"):
                TrainingRun(config(EACH, threads=threads), tmp_path / f"file {threads}" / "run")
        assert torch.get_num_threads() == 2
        assert torch.equal(torch.rand(3), expected)
    finally:
        torch.set_num_threads(1)


def test_what_was_logged_after_the_checkpoint_is_taken_back(tmp_path: Path) -> None:
    TrainingRun(config(4 * EACH), tmp_path).train()
    expected, lines = points(tmp_path), (tmp_path / "log.csv").read_text()
    assert names(tmp_path) == [CHECKPOINT.format(steps * EACH) for steps in (2, 4)]
    (tmp_path / CHECKPOINT.format(4 * EACH)).unlink()  # as if it had crashed before
    (tmp_path / "log.csv").write_text(lines + "rollout/steps,999999")
    TrainingRun(config(4 * EACH), tmp_path, resume=True).train()
    assert points(tmp_path) == expected


@pytest.mark.parametrize("row", [b"rollout/steps,many,1\n", b"rollout/steps\n", b"\xff,8,1\n", b"\0\0\n"])
def test_a_damaged_log_is_named(row: bytes, tmp_path: Path) -> None:
    TrainingRun(config(EACH), tmp_path).train()
    with (tmp_path / "log.csv").open("ab") as log:
        log.write(row)
    with pytest.raises(TrainingError, match=r"log\.csv(, line \d+: .* is not a tag, a step, a value| cannot be read)"):
        TrainingRun(config(2 * EACH), tmp_path, resume=True)


def interrupted(run: TrainingRun) -> None:
    """Ctrl-C in the middle of the next update."""
    optimizer = run.trainer.learners[0].optimizer
    step = optimizer.step

    def stop(rate: float) -> None:
        step(rate)
        raise KeyboardInterrupt

    optimizer.step = stop  # type: ignore[method-assign]


def test_a_second_ctrl_c_waits_for_the_checkpoint(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, write = TrainingRun(config(6 * EACH), tmp_path), checkpoint.write_checkpoint

    def again(*arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        write(*arguments)

    def stop(run: TrainingRun) -> None:
        if run.done == 3 * EACH:
            monkeypatch.setattr(checkpoint, "write_checkpoint", again)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run.train(stop)
    assert names(tmp_path)[-1] == CHECKPOINT.format(3 * EACH)


def test_a_second_ctrl_c_does_not_come_ahead_of_the_checkpoint(tmp_path: Path) -> None:
    """It comes between the first one and the first line of what saves."""
    run, came = TrainingRun(config(6 * EACH), tmp_path), list[int]()
    lines, first = inspect.getsourcelines(inspect.unwrap(TrainingRun.train))
    saving = first + next(k for k, line in enumerate(lines) if "with interrupts_held()" in line)

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        if frame.f_code.co_name != "train" or Path(frame.f_code.co_filename).name != "run.py":
            return None
        if event == "line" and frame.f_lineno == saving:
            came.append(frame.f_lineno)
            signal.raise_signal(signal.SIGINT)
        return trace

    def stop(own: TrainingRun) -> None:
        if own.done == 2 * EACH:
            signal.raise_signal(signal.SIGINT)

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        with pytest.raises(KeyboardInterrupt):
            run.train(stop)
    finally:
        sys.settrace(before)
    assert came
    assert names(tmp_path) == [CHECKPOINT.format(2 * EACH)]


@pytest.mark.parametrize(("updates", "now"), [(0, ""), (3, "collecting"), (3, "epoch 2")])
@pytest.mark.by_day(1)
def test_ctrl_c_saves_the_last_update(tmp_path: Path, updates: int, now: str) -> None:
    run = TrainingRun(config(6 * EACH), tmp_path / "parts")
    if not updates:
        interrupted(run)
    with pytest.raises(KeyboardInterrupt):
        run.train(lambda run: interrupted(run) if (run.done, run.now) == (updates * EACH, now) else None)
    assert names(tmp_path / "parts")[-1] == CHECKPOINT.format(updates * EACH)
    TrainingRun(config(6 * EACH), tmp_path / "parts", resume=True).train()
    TrainingRun(config(6 * EACH), tmp_path / "whole").train()
    assert points(tmp_path / "parts") == points(tmp_path / "whole")
    assert not list(tmp_path.glob("*/*.tmp"))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGUSR1")
def test_a_signal_asks_for_a_checkpoint_and_the_run_goes_on(tmp_path: Path) -> None:
    """The checkpoint is of the last complete update. One that is there already is not written again."""
    run, saved = TrainingRun(config(4 * EACH, every=10 * EACH), tmp_path / "run"), list[int]()

    def ask(run: TrainingRun) -> None:
        if (run.done, run.now) in ((0, "epoch 1"), (2 * EACH, "epoch 1"), (2 * EACH, "epoch 2")):
            signal.raise_signal(signal.SIGUSR1)

    write = run._save
    run._save = lambda kept: (saved.append(kept[0]), write(kept))  # type: ignore[method-assign, func-returns-value]
    run.train(ask)
    assert saved == [0, 2 * EACH, 4 * EACH, 4 * EACH]
    TrainingRun(config(4 * EACH, every=10 * EACH), tmp_path / "whole").train()
    assert_same(tmp_path / "run", tmp_path / "whole")


def test_the_log_has_the_papers_quantities_and_more(tmp_path: Path) -> None:
    TrainingRun(config(2 * EACH, scenario=SHORT.replace(agents_health=4)), tmp_path).train()
    found = points(tmp_path)
    paper = {f"rollout/{name}" for name in ("reward0", "reward1", "kills0", "kills1", "steps", "heals_used")}
    more = {"rollout/deaths_zone", "rollout/deaths_melee", "behaviour/attack_far", "behaviour/zone_distance"}
    update = {f"train/{name}" for name in ("approx_kl", "entropy", "epochs", "value_loss", "clip_fraction")}
    assert paper | more | update | {"behaviour/heals_held", "behaviour/heals_given"} <= found.keys()
    assert found["train/epochs"] == [(EACH, 3.0), (2 * EACH, 3.0)]
    with (tmp_path / "log.csv").open() as file:
        assert next(csv.reader(file)) == ["tag", "step", "value"]


def test_tensorboard_reads_the_same(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    TrainingRun(config(4 * EACH), tmp_path).train()
    (tmp_path / CHECKPOINT.format(4 * EACH)).unlink()  # as if it had crashed before
    TrainingRun(config(5 * EACH), tmp_path, resume=True).train()
    events = EventAccumulator(str(tmp_path)).Reload()
    for tag, values in points(tmp_path).items():
        read = [(event.step, event.value) for event in events.Scalars(tag)]
        assert [step for step, _ in read] == [step for step, _ in values]
        np.testing.assert_allclose([value for _, value in read], [value for _, value in values], rtol=1e-6)


# ---- killed early: see also tests.killing


def test_a_run_that_diverges_stops_and_keeps_the_checkpoint_before(tmp_path: Path) -> None:
    run = TrainingRun(config(20 * EACH, preset="fast", settings={"learning_rate": 1e4}), tmp_path / "run")
    with pytest.raises(TrainingError, match=r"training diverged: after \d+ agent-steps .* lower learning rate"):
        run.train()
    for path in (tmp_path / "run").glob("*.zip"):
        outlast.load_policy(path)


class Unpayable(Module):
    pass


@Unpayable.system(Phase.REWARD, after=Reward)
def pay_nothing(reward: Write[Reward]) -> None:
    reward.reward[0] = np.nan


def test_rewards_that_are_no_numbers_are_said_to_be_so(tmp_path: Path) -> None:
    run = TrainingRun(config(EACH, scenario=SHORT.with_(Unpayable()), preset="fast"), tmp_path / "run")
    with pytest.raises(TrainingError, match=r"rewards are no finite numbers \(NaN or infinity\): a mechanic computes"):
        run.train()


@dataclass(frozen=True)
class Rich(Module):
    pay: float = number(1e31)


@Rich.system(Phase.REWARD, after=Reward)
def pay_much(reward: Write[Reward], pay: float) -> None:
    reward.reward[:] = np.float32(pay)


@pytest.mark.parametrize(
    ("pay", "preset", "words"),
    [
        (1e31, "fast", r"rewards, or their discounted sums, are beyond 1e\+30, .*: pay less"),
        (9e29, "fast", r"rewards, or their discounted sums, are beyond 1e\+30"),
        (1e20, "paper", "training diverged: after .* train/value_loss is inf; begin again .* smaller rewards"),
    ],
)
def test_rewards_that_nothing_is_learned_from_are_refused(pay: float, preset: str, words: str, tmp_path: Path) -> None:
    run = TrainingRun(config(EACH, scenario=SHORT.with_(Rich(pay)), preset=preset), tmp_path / "run")
    with pytest.raises(TrainingError, match=words):
        run.train()
    TrainingRun(config(EACH, scenario=SHORT.with_(Rich(pay)), preset=preset), tmp_path / "run", resume=True).log.close()


class Ratio(Module):
    def fields(self) -> dict[str, tuple[Field, ...]]:
        return {"own": (Field("ratio", low=-1, high=1),)}


@Ratio.system(Phase.OBSERVE)
def divide(view: Write[SelfView], own_ratio: Offset, entities: Read[Entity], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        view.own[i, own_ratio] = np.inf if entities.alive[agents[i]] else 0


class Far(Module):
    pass


@Far.system(Phase.OBSERVE, after=OthersView)
def see_far(view: Write[OthersView], others_x: Offset) -> None:
    for i in range(view.others.shape[0]):
        for k in range(view.others.shape[1]):
            view.others[i, k, others_x] = np.nan


@pytest.mark.parametrize(
    ("mechanic", "preset", "named"),
    [(Ratio(), "fast", "own.ratio"), (Far(), "fast", "others.x"), (Far(), "original", "others.x")],
)
def test_observations_that_are_no_numbers_are_named(mechanic: Module, preset: str, named: str, tmp_path: Path) -> None:
    """And not said to be training that diverged. The first time that others are seen is after the last step."""
    run = TrainingRun(config(EACH, scenario=SHORT.with_(mechanic), preset=preset), tmp_path / "run")
    with pytest.raises(TrainingError, match=rf"observations have .*: {named}\. A mechanic .* outlast check looks"):
        run.train()
    assert names(tmp_path / "run") == [CHECKPOINT.format(0)]


def test_what_could_not_be_read_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("outlast.training.base.run_header.MOST", 1)
    with pytest.raises(TrainingError, match="does not describe a run"):
        TrainingRun(config(EACH), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_run_of_many_agents_can_be_gone_on_with(tmp_path: Path) -> None:
    crowd = SHORT.replace(n_agents=257, spawn_grid_cells=20, room_size=90.0, safe_zone_radii=(40.0, 4.0))
    given: dict[str, Any] = {"scenario": crowd, "worlds": 1, "rollout": 2, "every": 1}
    given["settings"] = {"batch_size": 257, "n_epochs": 1, "target_kl": 0.0}
    TrainingRun(config(2 * 257, **given), tmp_path / "run").train()
    TrainingRun(config(4 * 257, **given), tmp_path / "run", resume=True).train()
    assert last_step(tmp_path / "run" / "log.csv") == 4 * 257


def test_many_opponents_with_strange_names_can_be_gone_on_with(tmp_path: Path) -> None:
    """Their names are longer than a line, and tags of the log have commas."""
    TrainingRun(config(EACH), tmp_path / "rival").train()
    places = [tmp_path / f"lr=1,{k}$" / ("x" * 40 + ".zip") for k in range(3)]
    for place in places:
        place.parent.mkdir()
        shutil.copy(newest(tmp_path / "rival"), place)
    given = {"opponents": {str(place): 1.0 for place in places}}
    TrainingRun(config(EACH, **given), tmp_path / "run").train()
    TrainingRun(config(2 * EACH, **given), tmp_path / "run", resume=True).train()
    assert f"wins/{places[0]}" in read_log(tmp_path / "run" / "log.csv")
    assert last_step(tmp_path / "run" / "log.csv") == 2 * EACH


@pytest.mark.parametrize(
    "given",
    [{"steps": -1}, {"every": 0}, {"snapshots": 0, "opponents": {"past": 1.0}}, {"rollout": -64}, {"seed": 1.5}],
)
def test_numbers_that_cannot_be_are_named(given: dict[str, Any]) -> None:
    with pytest.raises(TrainingError, match=f"{next(iter(given))} = .*: a whole number from [01] is needed"):
        config(**({"steps": EACH} | given))


@pytest.mark.parametrize(
    ("scenario", "preset", "words"),
    [
        (SHORT.replace(cameras_mode="omniscient"), "fast", "cameras_mode = omniscient: preset fast trains with masked"),
        (SHORT.replace(cameras_mode="revealed"), "paper", "trains with masked; .*, or take preset original"),
        (
            SHORT.vary(cameras_mode=choice("masked", "revealed")),
            "original",
            "cameras_mode = choice.*trains with reveal",
        ),
    ],
)
def test_what_agents_see_is_not_changed_without_a_word(scenario: Any, preset: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=words):
        config(EACH, scenario=scenario, preset=preset)
    TrainingRun(config(EACH), tmp_path / "run").train()
    if scenario.varied:
        with pytest.raises(UsageError, match=r"cameras_mode is choice.*the same in all worlds"):
            common_scenario(scenario, [outlast.load_policy(newest(tmp_path / "run"))])


def test_hyperparameters_are_given_once() -> None:
    with pytest.raises(TrainingError, match="gamma is given twice"):
        parse_hyperparameters(["gamma=0.9", "gamma=0.99"])


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    TrainingRun(config(np.int64(EACH), seed=np.int64(1)), tmp_path / "run").train()  # type: ignore[arg-type]
    assert json.loads((tmp_path / "run/run.json").read_text())["plan"]["seed"] == 1


def test_a_run_goes_on_where_the_files_of_its_opponents_lie_elsewhere(tmp_path: Path) -> None:
    for name, seed in (("rival", 1), ("stranger", 2)):
        TrainingRun(config(EACH, seed=seed), tmp_path / name).train()
    rival, stranger = (newest(tmp_path / name) for name in ("rival", "stranger"))
    TrainingRun(config(EACH, opponents={str(rival): 1.0}), tmp_path / "run").train()
    shutil.move(rival, tmp_path / "moved.zip")

    def resumed(**opponents: float) -> TrainingRun:
        return TrainingRun(config(2 * EACH, opponents=opponents), tmp_path / "run", resume=True)

    with pytest.raises(TrainingError, match=r"stranger.*is another policy than the one that the run has"):
        resumed(**{str(stranger): 1.0})
    with pytest.raises(TrainingError, match=r"was begun with opponents = .*:1, not self:1,.*moved\.zip:1"):
        resumed(**{"self": 1.0, str(tmp_path / "moved.zip"): 1.0})
    run = resumed(**{str(tmp_path / "moved.zip"): 1.0})
    run.train()
    assert run.trainer.steps == 2 * EACH


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_again(tmp_path: Path) -> None:
    TrainingRun(config(2 * EACH), tmp_path / "whole").train()
    begun = TrainingRun(config(2 * EACH), tmp_path / "parts")  # and killed
    begun.log.close()
    begun.lock.release()
    (tmp_path / "parts/.log.csv-0123abcd.tmp").write_text("half")
    with (tmp_path / "parts/log.csv").open("a") as log:
        log.write("train/loss,384,0.5\ntrain/lo")
    assert json.loads((tmp_path / "parts/run.json").read_text())["plan"]["seed"] == 3
    with pytest.raises(TrainingError, match="is not empty: go on with --resume"):
        TrainingRun(config(2 * EACH), tmp_path / "parts")
    with pytest.raises(TrainingError, match="was begun with seed = 3, not 4"):
        TrainingRun(config(2 * EACH, seed=4), tmp_path / "parts", resume=True)
    with pytest.raises(TrainingError, match=r"another scenario .*: agents_health is 10 there and 11 here"):
        TrainingRun(config(2 * EACH, scenario=SHORT.replace(agents_health=11)), tmp_path / "parts", resume=True)
    with pytest.raises(TrainingError, match=r"another scenario .*: here the mechanic marked is .*Marked"):
        TrainingRun(config(2 * EACH, scenario=SHORT.with_(marked(1))), tmp_path / "parts", resume=True)
    TrainingRun(config(2 * EACH), tmp_path / "parts", resume=True).train()
    assert points(tmp_path / "parts") == points(tmp_path / "whole")
    assert not list(tmp_path.glob("*/*.tmp"))


def test_two_processes_do_not_train_one_run(tmp_path: Path) -> None:
    """The other one reads, and writes nothing; a lock ends with its process, however that ends."""
    TrainingRun(config(EACH), tmp_path / "whole").train()
    code = "import sys, time, pathlib\nfrom outlast.envs.storage.folder_lock import FolderLock\n"
    code += "lock = FolderLock(pathlib.Path(sys.argv[1]))\nlock.acquire()\nprint('held', flush=True)\ntime.sleep(600)"
    (tmp_path / "run").mkdir()
    command = [sys.executable, "-c", code, str(tmp_path / "run")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        for resume in (False, True):
            with pytest.raises(TrainingError, match="run: another process trains this run; wait until it ends"):
                TrainingRun(config(EACH), tmp_path / "run", resume=resume)
        assert all(map(is_lock, (tmp_path / "run").iterdir()))
        other.kill()
    run = TrainingRun(config(EACH), tmp_path / "run")
    with pytest.raises(TrainingError, match="another process trains this run"):
        TrainingRun(config(EACH), tmp_path / "run", resume=True)
    run.train()
    assert_same(tmp_path / "run", tmp_path / "whole")
    TrainingRun(config(2 * EACH), tmp_path / "run", resume=True).train()


@pytest.mark.parametrize("resume", [False, True])
def test_a_run_that_another_process_trains_meanwhile_is_left_as_it_is(
    tmp_path: Path, resume: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if resume:
        TrainingRun(config(EACH), tmp_path / "run").train()

    def slowly(*given: Any) -> Any:
        monkeypatch.undo()
        TrainingRun(config(2 * EACH), tmp_path / "run", resume=resume).train()
        return runs.prepared(*given)

    monkeypatch.setattr(runs, "prepared", slowly)
    with pytest.raises(TrainingError, match="another process has trained this run in the meantime; go on"):
        TrainingRun(config(3 * EACH), tmp_path / "run", resume=resume)
    TrainingRun(config(2 * EACH), tmp_path / "whole").train()
    assert_same(tmp_path / "run", tmp_path / "whole")


@pytest.mark.parametrize("resume", [False, True])
def test_a_folder_with_nothing_but_a_temporary_file_is_empty(tmp_path: Path, resume: bool) -> None:
    (tmp_path / ".run.json-0123abcd.tmp").write_text("half")
    TrainingRun(config(EACH), tmp_path, resume=resume).train()
    assert names(tmp_path) == [CHECKPOINT.format(EACH)]
    assert not list(tmp_path.glob("*.tmp"))


def test_run_json_is_part_of_that_of_a_checkpoint(tmp_path: Path) -> None:
    TrainingRun(config(EACH), tmp_path).train()
    header = json.loads((tmp_path / "run.json").read_text())
    saved = checkpoint.header_of(checkpoint.read_checkpoint(newest(tmp_path)))
    assert header == {key: saved[key] for key in ("plan", "scenario", "modules")} | {"asked": EACH}
    (tmp_path / "run.json").write_text("{")
    (tmp_path / CHECKPOINT.format(EACH)).unlink()
    with pytest.raises(TrainingError, match=r"run.json does not describe a run"):
        TrainingRun(config(EACH), tmp_path, resume=True)


# ---- refusals


def test_the_weights_of_a_checkpoint_are_safetensors(tmp_path: Path) -> None:
    """To the bit, as other programs read them."""
    run = TrainingRun(config(EACH), tmp_path)
    run.train()
    files = checkpoint.read_checkpoint(newest(tmp_path))
    assert set(files) == {"run.json", "policy.safetensors", "rest.safetensors", "worlds.npz"}
    found, own = load(files["policy.safetensors"]), run.trainer.policies[0].state_dict()
    assert found.keys() == {f"0.{name}" for name in own}
    assert all(torch.equal(found[f"0.{name}"], values) for name, values in own.items())
    moments = load(files["rest.safetensors"])["learners/0/optimiser/0/exp_avg"]
    assert torch.equal(moments, run.trainer.learners[0].optimizer.moments[0]["exp_avg"])
    assert checkpoint.header_of(files)["preset"] == "original"


def test_what_cannot_be_resumed_is_refused_and_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(TrainingError, match="nothing to resume in"):
        TrainingRun(config(EACH), folder, resume=True)
    assert not folder.exists()
    TrainingRun(config(EACH), folder).train()
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(TrainingError, match="is not empty: go on with --resume"):
        TrainingRun(config(EACH), folder)
    with pytest.raises(TrainingError, match="was begun with worlds = 8, not 4"):
        TrainingRun(config(EACH, worlds=4), folder, resume=True)
    with pytest.raises(
        TrainingError, match=r"begun with preset = original, not fast: go on with the same, or .* --out"
    ):
        TrainingRun(config(EACH, preset="fast"), folder, resume=True)
    with pytest.raises(TrainingError, match="preset = original, not paper"):
        TrainingRun(config(EACH, preset="paper"), folder, resume=True)
    with pytest.raises(StateError, match=r"another scenario .*: agents_health is 10 there and 11 here"):
        TrainingRun(config(EACH, scenario=SHORT.replace(agents_health=11)), folder, resume=True)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_a_checkpoint_of_a_game_with_another_mechanic_is_refused(tmp_path: Path) -> None:
    TrainingRun(config(EACH, scenario=SHORT.with_(marked(1))), tmp_path).train()
    TrainingRun(config(2 * EACH, scenario=SHORT.with_(marked(1))), tmp_path, resume=True).train()
    with pytest.raises(StateError, match=r"another scenario .*: the code of the mechanic marked .*Marked\) is another"):
        TrainingRun(config(3 * EACH, scenario=SHORT.with_(marked(2))), tmp_path, resume=True)


@pytest.mark.parametrize("content", [b"", b"PK\x05\x06" + bytes(18), b"no archive"])
def test_a_broken_checkpoint_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / CHECKPOINT.format(1)
    path.write_bytes(content)
    with pytest.raises(TrainingError, match=r"is not a checkpoint: .*; .* another library has saved plays as"):
        checkpoint.read_checkpoint(path)


def test_a_checkpoint_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("policy.safetensors", "rest.safetensors", "worlds.npz"):
            archive.writestr(name, b"")
        archive.writestr("run.json", '{"version": 99}')
    with pytest.raises(TrainingError, match="has version 99: 1 is needed"):
        checkpoint.read_checkpoint(path)


# ---- the command

outlast_train = partial(call, command)


def test_the_command_is_there_without_torch() -> None:
    text = "import sys, outlast.training.cli.train; assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", text], check=True)


def test_the_command_trains_resumes_and_counts_both_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    numbers = ("--preset", "paper", "--threads", "1", "--ppo", "n_epochs=1", "--rollout", "1024", "--quiet")
    assert outlast_train("ffa_2", "--steps", "1.5e3", *numbers) == 0
    assert "runs/ffa_2-paper-0: 2,048 agent-steps, which are 1,024 environment steps" in capsys.readouterr().out
    assert outlast_train("ffa_2", "--steps", "3e3", "--resume", *numbers) == 0
    assert "4,096 agent-steps, which are 2,048" in capsys.readouterr().out
    assert names(tmp_path / "runs/ffa_2-paper-0") == [CHECKPOINT.format(n * 2048) for n in (1, 2)]


@pytest.mark.parametrize("steps", ["0", "1.5", "many", "-3"])
def test_the_command_refuses_steps_that_are_none(steps: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        outlast_train("ffa_2", "--steps", steps)
    assert f"{steps}: an integer of at least 1 is needed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gama=1", "PPO has no number 'gama'; did you mean gamma.$"),
        ("gamma=big", "gamma=big: a number like 0.99"),
    ],
)
def test_the_command_refuses_numbers_that_ppo_has_not(text: str, message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        outlast_train("ffa_2", "--ppo", text)


@pytest.mark.nightly
def test_agents_learn_to_stay_in_the_zone(tmp_path: Path) -> None:
    """In a world that is all about it: they live longer, and nearer to its middle, than at first."""
    zone = {"safe_zone_radii": (4.0,), "safe_zone_centres": "middle", "safe_zone_stand": 1000, "safe_zone_damage": 2}
    world = variant("ffa_1").replace(room_size=20.0, n_heals=1, ending_limit=200, **zone)
    settings = {"n_epochs": 8, "gamma": 0.98, "learning_rate": 1e-3}
    TrainingRun(
        TrainingConfig(world, "scaled", steps=250_000, rollout=4096, threads=1, settings=settings), tmp_path
    ).train()
    found = points(tmp_path)
    length, distance = ([value for _, value in found[tag]] for tag in ("rollout/reward0", "behaviour/zone_distance"))
    assert np.mean(length[-5:]) > 1.5 * np.mean(length[:5])
    assert np.mean(distance[-5:]) < 0.7 * np.mean(distance[:5])


def test_progress_is_reported_at_each_epoch(tmp_path: Path) -> None:
    """An update counts when it is over; the first ones take minutes."""
    seen: list[tuple[int, str]] = []
    TrainingRun(config(2 * EACH), tmp_path).train(lambda run: seen.append((run.done, run.now)))
    expected = [(0, "epoch 1"), (EACH, "collecting"), (EACH, "epoch 1"), (2 * EACH, "collecting")]
    assert [pair for pair in seen if pair[1] in ("epoch 1", "collecting")] == expected
    epochs = [value for _, value in points(tmp_path)["train/epochs"]]
    assert [now for _, now in seen].count("epoch 2") == sum(value > 1 for value in epochs)
