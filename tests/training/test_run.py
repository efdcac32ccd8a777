"""Runs: resumed ones are as if they had never stopped, logs and checkpoints are whole."""

import json
import shutil
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load

import outlast
from docs.examples.own_ppo import Pooled
from outlast import variant
from outlast.components import OthersView, Phase, Reward, SelfView, Side
from outlast.distributions import choice
from outlast.ecs import Entity, Field, Module, Offset, Read, Rows, Singleton, Write, column, number
from outlast.envs.errors import StateError, UsageError
from outlast.envs.rollout.saved import CHECKPOINT, common_scenario, newest
from outlast.envs.storage.interrupts import interrupts_held
from outlast.envs.storage.outputs import FolderLock, is_lock
from outlast.training.base.config import TrainingConfig
from outlast.training.base.curves import last_step, read_log
from outlast.training.base.errors import TrainingError
from outlast.training.policies import checkpoint
from outlast.training.runs import run as runs
from outlast.training.runs.run import TrainingRun
from tests.helpers.checkpoints import KEPT
from tests.helpers.runs import EACH, SHORT, assert_same, config, names, points
from tests.training import test_chosen_levels as levels
from tests.training.test_seams import HIDING, SEEKERS, Remembering

Folders = Callable[..., Path]


class Mark(Singleton):
    size: Any = column("f4")


def marked(size: float) -> Module:
    return type("Marked", (Module,), {"singletons": lambda self: [Mark(size=size)]})()


def resume(folder: Path, rollouts: int, **changes: Any) -> TrainingRun:
    return TrainingRun(config(rollouts * EACH, **changes), folder, resume=True)


def test_a_resumed_run_logs_the_same_numbers(whole: Folders, begun: Folders) -> None:
    parts = begun(2)
    for rollouts in (3, 6):
        resume(parts, rollouts).train()
    assert_same(whole(6), parts)
    assert [json.loads((folder / "run.json").read_text())["asked"] for folder in (whole(6), parts)] == [6 * EACH] * 2
    found = points(parts)
    assert [value for _, value in found["train/epochs"]] == [3.0] * 6
    assert found["rollout/reward0"][-1] != found["rollout/reward0"][-2]


@pytest.mark.parametrize(
    "options",
    [
        {"memory": 8, "rollout": 8 * 32},
        {"policies": "side", "critic": "state", "prioritised": True},
        {"levels": levels.drawn, "scenario": levels.SHORT, "memory": 16, "rollout": 8 * 32},
        {"networks": Remembering, "memory": 8, "rollout": 8 * 32},
        {"networks": {"seeker": Pooled}, "scenario": HIDING, "policies": "side", "settings": SEEKERS},
        {"preset": "fast,seeker:original", "scenario": HIDING, "policies": "side"},
    ],
    ids=["memory", "sides", "levels", "networks", "networks of sides", "presets of sides"],
)
def test_a_resumed_run_is_the_same_whatever_it_trains(options: dict[str, Any], tmp_path: Path) -> None:
    opponents = {"self": 1.0, "past": 1.0, "scripted": 1.0}
    plan = partial(config, **({"preset": "fast", "opponents": opponents, "snapshots": 1} | options))
    each = 2 * options.get("rollout", 8 * 24)
    TrainingRun(plan(4 * each), tmp_path / "whole").train()
    for rollouts in (2, 4):
        TrainingRun(plan(rollouts * each), tmp_path / "parts", resume=rollouts > 2).train()
    assert_same(tmp_path / "whole", tmp_path / "parts")


def test_a_resumed_run_with_scaled_rewards_and_an_annealed_rate_is_the_same(tmp_path: Path) -> None:
    """The rate falls along all of it, and a run of another length would be another one."""
    fast, parts = config(5 * EACH, "fast", settings={"batch_size": 64}), tmp_path / "parts"
    TrainingRun(fast, tmp_path / "whole").train()
    run = TrainingRun(fast, parts)
    for updates in (2, 3):
        with pytest.raises(KeyboardInterrupt):
            run.train(lambda run, done=updates * EACH: interrupted(run) if run.done == done else None)
        assert names(parts)[-1] == CHECKPOINT.format(updates * EACH)
        run = TrainingRun(fast, parts, resume=True)
    run.train()
    assert_same(tmp_path / "whole", parts)
    rates = [rate for _, rate in points(parts)["train/learning_rate"]]
    assert rates == pytest.approx([fast.numbers.learning_rate * left for left in (1, 0.8, 0.6, 0.4, 0.2)])
    files = checkpoint.read_checkpoint(newest(parts))
    assert checkpoint.load_tree(files, checkpoint.REST)["rewards"]["count"] == 5 * EACH
    with pytest.raises(TrainingError, match=f"begun with steps = {5 * EACH}, not {6 * EACH}: .* --steps {5 * EACH}"):
        TrainingRun(replace(fast, steps=6 * EACH), parts, resume=True)
    TrainingRun(replace(fast, warm_start=str(parts)), tmp_path / "on").log.close()  # as it says
    with pytest.raises(TrainingError, match="was begun with settings = "):
        TrainingRun(replace(fast, settings={"batch_size": 64, "anneal_lr": False}), parts, resume=True)
    named = {**fast.settings, "gamma": fast.numbers.gamma}  # which is the preset's
    TrainingRun(replace(fast, settings=named), parts, resume=True).train()


def test_what_was_logged_after_the_checkpoint_is_taken_back(whole: Folders, begun: Folders) -> None:
    """Also in TensorBoard's files."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    folder = begun(6)
    lines = (folder / "log.csv").read_text()
    assert names(folder) == [CHECKPOINT.format(steps * EACH) for steps in (2, 4, 6)]
    assert lines.startswith("tag,step,value\n")
    (folder / CHECKPOINT.format(6 * EACH)).unlink()  # as if it had crashed before
    (folder / "log.csv").write_text(lines + "rollout/steps,999999")
    resume(folder, 6).train()
    assert points(folder) == points(whole(6))
    events = EventAccumulator(str(folder)).Reload()
    for tag, values in points(folder).items():
        read = [(event.step, event.value) for event in events.Scalars(tag)]
        np.testing.assert_allclose(read, values, rtol=1e-6)


def test_a_run_that_was_killed_before_its_first_checkpoint_begins_again(whole: Folders, tmp_path: Path) -> None:
    (tmp_path / ".log.csv-0123abcd.tmp").write_text("half")  # a folder with nothing else counts as empty
    killed = TrainingRun(config(2 * EACH), tmp_path)
    killed.log.close()
    killed.lock.release()
    with (tmp_path / "log.csv").open("a") as log:
        log.write("train/loss,384,0.5\ntrain/lo")
    resume(tmp_path, 2).train()
    assert points(tmp_path) == points(whole(2))
    assert not list(tmp_path.glob("*.tmp"))


@pytest.mark.parametrize("saved", [False, True])
def test_a_run_of_another_plan_is_refused_and_left_alone(begun: Folders, tmp_path: Path, saved: bool) -> None:
    """As the checkpoint says or, before the first one, run.json."""
    with pytest.raises(TrainingError, match="does not hold a run to resume"):
        resume(tmp_path / "none", 1)
    assert not (tmp_path / "none").exists()
    folder = begun(1)
    if not saved:
        newest(folder).unlink()
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(TrainingError, match="is not empty: take --resume"):
        TrainingRun(config(EACH), folder)
    for changes, words in (
        ({"worlds": 4}, "was begun with worlds = 8, not 4"),
        ({"preset": "fast"}, "begun with preset = original, not fast.*: resume with the same, or .* --out"),
        ({"scenario": SHORT.replace(agents_health=11)}, "another scenario .*: agents_health is 10 there and 11 here"),
        ({"scenario": SHORT.with_(marked(1))}, "another scenario .*: here the mechanic marked is .*Marked"),
    ):
        with pytest.raises((TrainingError, StateError), match=words):
            resume(folder, 1, **changes)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    for row in (b"rollout/steps,many,1\n", b"\xff,8,1\n"):
        (folder / "log.csv").write_bytes(before[folder / "log.csv"] + row)
        with pytest.raises(TrainingError, match=r"log\.csv(, line \d+: .* is not a tag, a s| cannot be read)"):
            resume(folder, 2)


def test_a_run_whose_mechanic_has_other_code_is_refused(tmp_path: Path) -> None:
    TrainingRun(config(EACH, scenario=SHORT.with_(marked(1))), tmp_path).train()
    resume(tmp_path, 2, scenario=SHORT.with_(marked(1))).train()
    with pytest.raises(StateError, match=r"another scenario .*: the code of the mechanic marked .*Marked\) is another"):
        resume(tmp_path, 3, scenario=SHORT.with_(marked(2)))


def test_a_run_whose_opponents_see_more_goes_on_from_its_beginning(tmp_path: Path) -> None:
    """Before its first checkpoint: run.json has the observations that all of them can play with."""
    game, opponents = variant("ffa_2"), {"self": 1.0, str(KEPT / "ffa_2/original-0.safetensors"): 1.0}
    for again in (False, True):
        run = TrainingRun(config(EACH, "fast", scenario=game, opponents=opponents), tmp_path, resume=again)
        run.log.close()
        run.lock.release()


def test_a_run_of_many_agents_can_be_gone_on_with(tmp_path: Path) -> None:
    crowd = SHORT.replace(n_agents=257, spawn_grid_cells=20, room_size=90.0, safe_zone_radii=(40.0, 4.0))
    given: dict[str, Any] = {"scenario": crowd, "worlds": 1, "rollout": 2, "every": 1}
    given["settings"] = {"batch_size": 257, "n_epochs": 1, "target_kl": 0.0}
    for again in (False, True):
        TrainingRun(config((2 + 2 * again) * 257, **given), tmp_path, resume=again).train()
    assert last_step(tmp_path / "log.csv") == 4 * 257


def test_many_opponents_with_strange_names_can_be_gone_on_with(whole: Folders, tmp_path: Path) -> None:
    """Their names are longer than a line, and tags of the log have commas."""
    places = [tmp_path / f"lr=1,{k}$" / ("x" * 40 + ".zip") for k in range(3)]
    for place in places:
        place.parent.mkdir()
        shutil.copy(newest(whole(1)), place)
    given = {"opponents": {str(place): 1.0 for place in places}}
    TrainingRun(config(EACH, **given), tmp_path / "run").train()
    resume(tmp_path / "run", 2, **given).train()
    assert f"wins/{places[0]}" in read_log(tmp_path / "run" / "log.csv")
    assert last_step(tmp_path / "run" / "log.csv") == 2 * EACH


def test_files_of_opponents_may_lie_elsewhere(whole: Folders, begun: Folders, tmp_path: Path) -> None:
    rival, stranger = newest(begun(1, "rival")), newest(whole(2))
    TrainingRun(config(EACH, opponents={str(rival): 1.0}), tmp_path / "run").train()
    moved = shutil.move(rival, tmp_path / "moved.zip")
    for opponents, words in (
        ({str(stranger): 1.0}, "is not the policy that the run has"),
        ({"self": 1.0, str(moved): 1.0}, r"was begun with opponents = .*:1, not self:1,.*moved\.zip:1"),
    ):
        with pytest.raises(TrainingError, match=words):
            resume(tmp_path / "run", 2, opponents=opponents)
    run = resume(tmp_path / "run", 2, opponents={str(moved): 1.0})
    run.train()
    assert run.trainer.steps == 2 * EACH


def interrupted(run: TrainingRun) -> None:
    optimizer = run.trainer.learners[0].optimizer
    step = optimizer.step

    def stop(rate: float) -> None:
        step(rate)
        raise KeyboardInterrupt

    optimizer.step = stop  # type: ignore[method-assign]


def test_a_second_ctrl_c_does_not_come_ahead_of_the_checkpoint(tmp_path: Path, monkeypatch) -> None:
    def held() -> Any:
        signal.raise_signal(signal.SIGINT)  # after the first one, ahead of what saves
        return interrupts_held()

    run = TrainingRun(config(6 * EACH), tmp_path)
    monkeypatch.setattr(runs, "interrupts_held", held)
    with pytest.raises(KeyboardInterrupt):
        run.train(lambda run: signal.raise_signal(signal.SIGINT) if run.done == EACH else None)
    assert names(tmp_path) == [CHECKPOINT.format(EACH)]


@pytest.mark.parametrize(("updates", "now"), [(0, ""), (3, "collecting"), (3, "epoch 2")])
@pytest.mark.by_day(1)
def test_ctrl_c_saves_the_last_update(whole: Folders, tmp_path: Path, updates: int, now: str) -> None:
    run = TrainingRun(config(6 * EACH), tmp_path)
    if not updates:
        interrupted(run)
    with pytest.raises(KeyboardInterrupt):
        run.train(lambda run: interrupted(run) if (run.done, run.now) == (updates * EACH, now) else None)
    assert names(tmp_path)[-1] == CHECKPOINT.format(updates * EACH)
    resume(tmp_path, 6).train()
    assert points(tmp_path) == points(whole(6))
    assert not list(tmp_path.glob("*.tmp"))


@pytest.mark.skipif(sys.platform == "win32", reason="there is no SIGUSR1")
def test_a_signal_asks_for_a_checkpoint_and_the_run_goes_on(whole: Folders, tmp_path: Path) -> None:
    """The checkpoint is of the last complete update. One that is there already is not written again."""
    run, saved = TrainingRun(config(6 * EACH, every=10 * EACH), tmp_path), list[int]()
    seen: list[tuple[int, str]] = []

    def ask(run: TrainingRun) -> None:
        seen.append((run.done // EACH, run.now))
        if (run.done, run.now) in ((0, "epoch 1"), (2 * EACH, "epoch 1"), (2 * EACH, "epoch 2")):
            signal.raise_signal(signal.SIGUSR1)

    write = run._save
    run._save = lambda kept: (saved.append(kept[0]), write(kept))  # type: ignore[method-assign, func-returns-value]
    run.train(ask)
    assert saved == [0, 2 * EACH, 6 * EACH, 6 * EACH]
    assert points(tmp_path) == points(whole(6))
    update = ["epoch 1", "epoch 2", "epoch 3", "collecting"]  # it counts when it is over
    assert seen[:8] == [(done + (now == "collecting"), now) for done in (0, 1) for now in update]


@dataclass(frozen=True)
class Rich(Module):
    pay: float = number(1e31, about="paid to all in each tick; 0: what is no number")


@Rich.system(Phase.REWARD, after=Reward)
def pay_much(reward: Write[Reward], pay: float) -> None:
    reward.reward[:] = np.float32(pay) if pay else np.nan


@pytest.mark.parametrize(
    ("pay", "preset", "settings", "words"),
    [
        (1e31, "fast", {}, r"rewards, or their discounted sums, are beyond 1e\+30, .*: pay less"),
        (9e29, "fast", {}, r"rewards, or their discounted sums, are beyond 1e\+30"),
        (0, "fast", {}, r"rewards are not finite \(NaN or infinity\): a mechanic computes"),
        (1e20, "paper", {}, "training diverged: after .* train/value_loss is inf; begin again .* smaller rewards"),
        (1, "fast", {"learning_rate": 1e4}, r"training diverged: after \d+ agent-steps .* lower learning rate"),
    ],
)
def test_a_run_that_diverges_stops(pay: float, preset: str, settings: Any, words: str, tmp_path: Path) -> None:
    given = config(20 * EACH, preset, scenario=SHORT.with_(Rich(pay)), settings=settings)
    with pytest.raises(TrainingError, match=words):
        TrainingRun(given, tmp_path).train()
    for path in tmp_path.glob("*.zip"):
        outlast.load_policy(path)
    TrainingRun(given, tmp_path, resume=True).log.close()


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
    run = TrainingRun(config(EACH, preset, scenario=SHORT.with_(mechanic)), tmp_path)
    with pytest.raises(TrainingError, match=rf"observations have .*: {named}\. A mechanic .* outlast check looks"):
        run.train()
    assert names(tmp_path) == [CHECKPOINT.format(0)]


def test_two_processes_do_not_train_one_run(tmp_path: Path) -> None:
    """The other one reads, and writes nothing; how locks end with their processes is in test_folder_lock.py."""
    lock = FolderLock(tmp_path)
    lock.acquire()
    for again in (False, True):
        with pytest.raises(TrainingError, match=": another process trains this run; wait until it ends"):
            TrainingRun(config(EACH), tmp_path, resume=again)
    assert all(map(is_lock, tmp_path.iterdir()))
    lock.release()
    TrainingRun(config(EACH), tmp_path).train()
    resume(tmp_path, 2).train()


@pytest.mark.parametrize("again", [False, True])
def test_a_run_that_another_process_has_trained_is_left(
    whole: Folders, begun: Folders, tmp_path, again, monkeypatch
) -> None:
    folder = begun(1) if again else tmp_path / "run"

    def slowly(*given: Any) -> Any:
        monkeypatch.undo()
        TrainingRun(config(2 * EACH), folder, resume=again).train()
        return runs.prepared(*given)

    monkeypatch.setattr(runs, "prepared", slowly)
    with pytest.raises(TrainingError, match="another process has just trained this run; continue"):
        TrainingRun(config(3 * EACH), folder, resume=again)
    assert_same(folder, whole(2))


def test_the_files_of_a_checkpoint(begun: Folders) -> None:
    """Weights are safetensors, as other programs read them, to the bit; run.json is part of that of a checkpoint."""
    folder = begun(1)
    run, files = resume(folder, 1), checkpoint.read_checkpoint(newest(folder))
    run.log.close()
    run.lock.release()
    assert set(files) == {"run.json", "policy.safetensors", "rest.safetensors", "worlds.npz"}
    found, own = load(files["policy.safetensors"]), run.trainer.policies[0].state_dict()
    assert found.keys() == {f"0.{name}" for name in own}
    assert all(torch.equal(found[f"0.{name}"], values) for name, values in own.items())
    moments = load(files["rest.safetensors"])["learners/0/optimiser/0/exp_avg"]
    assert torch.equal(moments, run.trainer.learners[0].optimizer.moments[0]["exp_avg"])
    header, saved = json.loads((folder / "run.json").read_text()), checkpoint.header_of(files)
    assert header == {key: saved[key] for key in ("plan", "scenario", "modules")} | {"asked": EACH}
    assert saved["preset"] == "original"


@pytest.mark.parametrize(
    "given", [{"steps": -1}, {"every": 0}, {"snapshots": 0, "opponents": {"past": 1}}, {"memory": -1}, {"seed": 1.5}]
)
def test_numbers_that_cannot_be_are_named(given: dict[str, Any]) -> None:
    with pytest.raises(TrainingError, match=f"{next(iter(given))} = .*: an integer >= [01] is needed"):
        config(**({"steps": EACH} | given))
    numpy = config(np.int64(EACH), seed=np.int64(1))  # type: ignore[arg-type]
    assert json.loads(json.dumps(numpy.header()))["plan"]["seed"] == 1


@pytest.mark.parametrize(
    ("mode", "preset", "words"),
    [
        ("omniscient", "fast", "cameras_mode = omniscient: preset fast trains with masked"),
        ("revealed", "paper", "trains with masked; .*, or take preset original"),
        (choice("masked", "revealed"), "original", "cameras_mode = choice.*trains with reveal"),
    ],
)
def test_what_agents_see_is_not_changed_without_a_word(mode: Any, preset: str, words: str, whole: Folders) -> None:
    scenario = SHORT.replace(cameras_mode=mode) if isinstance(mode, str) else SHORT.vary(cameras_mode=mode)
    with pytest.raises(TrainingError, match=words):
        config(EACH, preset, scenario=scenario)
    if scenario.varied:
        with pytest.raises(UsageError, match=r"cameras_mode is choice.*the same in all worlds"):
            common_scenario(scenario, [outlast.load_policy(newest(whole(1)))])


@pytest.mark.nightly
def test_agents_learn_to_stay_in_the_zone(tmp_path: Path) -> None:
    zone = {"safe_zone_radii": (4.0,), "safe_zone_centres": "middle", "safe_zone_stand": 1000, "safe_zone_damage": 2}
    world = variant("ffa_1").replace(room_size=20.0, n_heals=1, ending_limit=200, **zone)
    settings = {"n_epochs": 8, "gamma": 0.98, "learning_rate": 1e-3}
    given = TrainingConfig(world, "scaled", steps=250_000, rollout=4096, threads=1, settings=settings)
    TrainingRun(given, tmp_path).train()
    found = points(tmp_path)
    length, distance = ([value for _, value in found[tag]] for tag in ("rollout/reward0", "behaviour/zone_distance"))
    assert np.mean(length[-5:]) > 1.5 * np.mean(length[:5])
    assert np.mean(distance[-5:]) < 0.7 * np.mean(distance[:5])
