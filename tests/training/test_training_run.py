"""Runs: resumed ones are as if they had never stopped, logs and checkpoints are whole."""

import argparse
import csv
import io
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant
from outlast.envs.errors import StateError, TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training import checkpoint, command, curves  # noqa: E402
from outlast.training.train import Plan, Run  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
SHORT = variant("ffa_1").replace(agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10)
EACH = 8 * 24 * 2  # agent-steps of a rollout


def plan(steps: int, **changes: Any) -> Plan:
    settings = {"batch_size": 64, "n_epochs": 3, "target_kl": None}
    given = {"scenario": SHORT, "steps": steps, "worlds": 8, "rollout": 8 * 24, "threads": 1, "every": 2 * EACH}
    return Plan(**(given | {"settings": settings, "seed": 3} | changes))


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What a log says, but for times."""
    return {tag: values for tag, values in curves.read(folder / "log.csv").items() if not tag.startswith("time/")}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.zip"))


def test_a_resumed_run_logs_the_same_numbers(tmp_path: Path) -> None:
    Run(plan(6 * EACH), tmp_path / "whole").go()
    Run(plan(2 * EACH), tmp_path / "parts").go()
    for steps in (3 * EACH, 6 * EACH):
        Run(plan(steps), tmp_path / "parts", resume=True).go()
    whole, parts = points(tmp_path / "whole"), points(tmp_path / "parts")
    assert whole == parts
    assert len(whole["train/value_loss"]) == 6
    assert whole["rollout/reward0"][-1] != whole["rollout/reward0"][-2]
    last = checkpoint.NAME.format(6 * EACH)
    one, other = (torch.load(_member(tmp_path / name / last, "policy.pt")) for name in ("whole", "parts"))
    assert all(torch.equal(one[key], other[key]) for key in one)


def _member(path: Path, name: str) -> io.BytesIO:
    return io.BytesIO(checkpoint.read(path)[name])


def test_what_was_logged_after_the_checkpoint_is_taken_back(tmp_path: Path) -> None:
    Run(plan(4 * EACH), tmp_path).go()
    expected, lines = points(tmp_path), (tmp_path / "log.csv").read_text()
    assert names(tmp_path) == [checkpoint.NAME.format(steps * EACH) for steps in (2, 4)]
    (tmp_path / checkpoint.NAME.format(4 * EACH)).unlink()  # as if it had crashed before
    (tmp_path / "log.csv").write_text(lines + "rollout/steps,999999")
    Run(plan(4 * EACH), tmp_path, resume=True).go()
    assert points(tmp_path) == expected


def interrupted(run: Run) -> None:
    """Ctrl-C in the middle of the next update."""

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    run.model.policy.optimizer.register_step_post_hook(stop)


@pytest.mark.parametrize(("updates", "now"), [(0, ""), (3, "collecting"), (3, "epoch 2")])
def test_ctrl_c_saves_the_last_update(tmp_path: Path, updates: int, now: str) -> None:
    run = Run(plan(6 * EACH), tmp_path / "parts")
    if not updates:
        interrupted(run)
    with pytest.raises(KeyboardInterrupt):
        run.go(lambda run: interrupted(run) if (run.done, run.shown["now"]) == (updates * EACH, now) else None)
    assert names(tmp_path / "parts")[-1] == checkpoint.NAME.format(updates * EACH)
    Run(plan(6 * EACH), tmp_path / "parts", resume=True).go()
    Run(plan(6 * EACH), tmp_path / "whole").go()
    assert points(tmp_path / "parts") == points(tmp_path / "whole")
    assert not list(tmp_path.glob("*/*.tmp"))


def test_the_log_has_the_papers_quantities_and_more(tmp_path: Path) -> None:
    Run(plan(2 * EACH, scenario=SHORT.replace(agents_health=4)), tmp_path).go()
    found = points(tmp_path)
    paper = {f"rollout/{name}" for name in ("reward0", "reward1", "kills0", "kills1", "steps", "heals_used")}
    more = {"rollout/deaths_zone", "rollout/deaths_melee", "behaviour/attack_far", "behaviour/zone_distance"}
    update = {f"train/{name}" for name in ("approx_kl", "entropy_loss", "epochs", "value_loss", "clip_fraction")}
    assert paper | more | update | {"behaviour/heals_held", "behaviour/heals_given"} <= found.keys()
    assert found["train/epochs"] == [(EACH, 3.0), (2 * EACH, 3.0)]
    with (tmp_path / "log.csv").open() as file:
        assert next(csv.reader(file)) == ["tag", "step", "value"]


def test_tensorboard_reads_the_same(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    Run(plan(4 * EACH), tmp_path).go()
    (tmp_path / checkpoint.NAME.format(4 * EACH)).unlink()  # as if it had crashed before
    Run(plan(5 * EACH), tmp_path, resume=True).go()
    events = EventAccumulator(str(tmp_path)).Reload()
    for tag, values in points(tmp_path).items():
        read = [(event.step, event.value) for event in events.Scalars(tag)]
        assert [step for step, _ in read] == [step for step, _ in values]
        np.testing.assert_allclose([value for _, value in read], [value for _, value in values], rtol=1e-6)


# ---- refusals


def test_a_checkpoint_runs_no_code(tmp_path: Path) -> None:
    """The files of tensors are those that torch reads with weights_only, its default."""
    Run(plan(EACH), tmp_path).go()
    files = checkpoint.read(checkpoint.newest(tmp_path))
    assert set(files) == {"run.json", "policy.pt", "rest.pt", "worlds.npz"}
    for name in ("policy.pt", "rest.pt"):
        assert torch.load(io.BytesIO(files[name]), weights_only=True)
    assert checkpoint.about(files)["preset"] == "original"


def test_what_cannot_be_resumed_is_refused_and_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(TrainingError, match="nothing to resume in"):
        Run(plan(EACH), folder, resume=True)
    assert not folder.exists()
    Run(plan(EACH), folder).go()
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(TrainingError, match="is not empty: go on with --resume"):
        Run(plan(EACH), folder)
    with pytest.raises(TrainingError, match="was begun with worlds = 8, not 4"):
        Run(plan(EACH, worlds=4), folder, resume=True)
    with pytest.raises(TrainingError, match="preset = original, not paper"):
        Run(plan(EACH, preset="paper"), folder, resume=True)
    with pytest.raises(StateError, match=r"another scenario .*: agents_health is 10 there and 11 here"):
        Run(plan(EACH, scenario=SHORT.replace(agents_health=11)), folder, resume=True)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("content", [b"", b"PK\x05\x06" + bytes(18), b"no archive"])
def test_a_broken_checkpoint_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / checkpoint.NAME.format(1)
    path.write_bytes(content)
    with pytest.raises(TrainingError, match="is not a checkpoint"):
        checkpoint.read(path)


def test_a_checkpoint_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name in ("policy.pt", "rest.pt", "worlds.npz"):
            archive.writestr(name, b"")
        archive.writestr("run.json", '{"version": 99}')
    with pytest.raises(TrainingError, match="has version 99: 1 is needed"):
        checkpoint.read(path)


# ---- the command


def test_the_command_is_there_without_torch() -> None:
    text = "import sys, outlast.training.command; assert not {'torch', 'stable_baselines3'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", text], check=True)


def outlast_train(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    command.add(parser.add_subparsers())
    options = parser.parse_args(["train", *arguments])
    return int(options.run(options))


def test_the_command_trains_resumes_and_counts_both_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    numbers = ("--preset", "paper", "--threads", "1", "--ppo", "n_epochs=1", "--rollout", "1024", "--quiet")
    assert outlast_train("ffa_2", "--steps", "1.5e3", *numbers) == 0
    assert "2,048 agent-steps = 1,024 environment steps in runs/ffa_2-paper-0" in capsys.readouterr().out
    assert outlast_train("ffa_2", "--steps", "3e3", "--resume", *numbers) == 0
    assert "4,096 agent-steps = 2,048" in capsys.readouterr().out
    assert names(tmp_path / "runs/ffa_2-paper-0") == [checkpoint.NAME.format(n * 2048) for n in (1, 2)]


@pytest.mark.parametrize("steps", ["0", "1.5", "many", "-3"])
def test_the_command_refuses_steps_that_are_none(steps: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        outlast_train("ffa_2", "--steps", steps)
    assert f"{steps}: a whole number of at least 1 is needed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "message"),
    [("gama=1", "PPO has no number 'gama'; it has: learning_rate"), ("gamma=big", "gamma=big: a number like 0.99")],
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
    Run(Plan(world, "scaled", steps=250_000, rollout=4096, threads=1, settings=settings), tmp_path).go()
    found = points(tmp_path)
    length, distance = ([value for _, value in found[tag]] for tag in ("rollout/reward0", "behaviour/zone_distance"))
    assert np.mean(length[-5:]) > 1.5 * np.mean(length[:5])
    assert np.mean(distance[-5:]) < 0.7 * np.mean(distance[:5])


def test_progress_is_told_of_each_epoch(tmp_path: Path) -> None:
    """An update counts when it is over; the first ones take minutes."""
    told: list[tuple[int, str]] = []
    Run(plan(2 * EACH), tmp_path).go(lambda run: told.append((run.done, run.shown["now"])))
    expected = [(0, "epoch 1"), (EACH, "collecting"), (EACH, "epoch 1"), (2 * EACH, "collecting")]
    assert [pair for pair in told if pair[1] in ("epoch 1", "collecting")] == expected
    epochs = [value for _, value in points(tmp_path)["train/epochs"]]
    assert [now for _, now in told].count("epoch 2") == sum(value > 1 for value in epochs)
