"""A start by imitation, a start with saved weights, and numbers of the game that are annealed."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from outlast.distributions import integers
from outlast.ecs import NumberError
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.hide_and_seek import HIDE_SMALL
from outlast.envs.scenarios.transfer import BLUEPRINT
from outlast.training.base.config import IMITATED, TrainingConfig, parse_anneal, parse_warm_start
from outlast.training.base.errors import TrainingError
from outlast.training.policies import checkpoint
from outlast.training.ppo.trainer import IMITATION, Trainer
from outlast.training.runs.run import TrainingRun
from tests.helpers.runs import EACH, SHORT, names
from tests.helpers.runs import config as tiny
from tests.helpers.runs import points as logged

START = CHECKPOINT.format(0)


def config(steps: int = 2 * EACH, **changes: Any) -> TrainingConfig:
    return tiny(steps, **({"preset": "fast", "every": 10 * EACH} | changes))


def points(folder: Path) -> dict[str, Any]:
    return {tag: values for tag, values in logged(folder).items() if "seconds" not in tag}


def weights(path: Path) -> dict[str, torch.Tensor]:
    (found,) = checkpoint.read_policies(path)[1]
    return found


def same(one: Any, other: Any) -> bool:
    return all(torch.equal(one[key], other[key]) for key in one)


@pytest.fixture(scope="module")
def taught(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that begins by imitation, with a checkpoint after each rollout. It must stay as it is."""
    folder = tmp_path_factory.mktemp("taught") / "run"
    TrainingRun(config(4 * EACH, warm_start=f"scripted:{2 * EACH}", every=EACH), folder).train()
    return folder


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that begins at random. It must stay as it is."""
    folder = tmp_path_factory.mktemp("random") / "a,self:0.5"  # a folder may have a colon
    TrainingRun(config(2 * EACH, every=EACH), folder).train()
    return folder


def test_a_policy_learns_to_do_as_the_teacher_does() -> None:
    """Games in which it imitates do not count for its opponents."""
    measured: list[dict[str, float]] = []
    trainer = Trainer(config(warm_start=f"scripted:{40 * EACH}", opponents={"self": 0.5, "scripted": 0.5}))
    last = trainer.imitate(lambda done, tags: measured.append({"done": done} | tags))
    assert [each["done"] for each in measured] == [EACH * (k + 1) for k in range(40)]
    assert last["imitation/differs"] < 0.6 * measured[0]["imitation/differs"]
    assert last["imitation/cross_entropy"] < 0.8 * measured[0]["imitation/cross_entropy"]
    assert last["imitation/agent_steps"] == 40 * EACH
    assert trainer.steps == trainer.updates == 0
    assert not trainer.learners[0].optimizer.moments[0]["step"]
    assert trainer.lane.teacher is None
    assert [(one.won, one.games, one.total) for one in trainer.opponents.all.values()] == [(0, 0, 0)] * 2
    trainer.collect()
    assert trainer.opponents.all[1].total


def test_its_checkpoint_is_the_start_and_a_run_never_imitates_again(taught: Path, first: Path, tmp_path: Path) -> None:
    assert names(taught) == [CHECKPOINT.format(k * EACH) for k in range(5)]
    found, folder = points(taught), tmp_path / "run"
    assert found["imitation/agent_steps"] == [(0, 2 * EACH)]
    assert [step for step, _ in found["train/loss"]] == [EACH * k for k in (1, 2, 3, 4)]
    assert not same(weights(taught / START), weights(first / CHECKPOINT.format(EACH)))
    shutil.copytree(taught, folder)
    for k in range(1, 5):  # as if it had been killed behind its first checkpoint
        (folder / CHECKPOINT.format(k * EACH)).unlink()
    TrainingRun(config(4 * EACH, warm_start=f"scripted:{2 * EACH}", every=EACH), folder, resume=True).train()
    assert points(folder) == found
    with pytest.raises(TrainingError, match="begun with warm_start = "):
        TrainingRun(config(4 * EACH, warm_start="scripted", every=EACH), folder, resume=True)


def test_an_imitation_that_is_stopped_saves_nothing(taught: Path, tmp_path: Path, monkeypatch) -> None:
    def stop(run: TrainingRun) -> None:
        assert run.now.startswith("imitated")
        raise KeyboardInterrupt

    own = config(4 * EACH, warm_start=f"scripted:{2 * EACH}", every=EACH)
    with monkeypatch.context() as patch:
        patch.setitem(IMITATION, "learning_rate", 1e6)
        with pytest.raises(TrainingError, match=f"imitation .* diverged: after {EACH} agent-steps .* --warm-start"):
            TrainingRun(own, tmp_path).train()
    with pytest.raises(KeyboardInterrupt):
        TrainingRun(own, tmp_path, resume=True).train(stop)
    assert not names(tmp_path)
    TrainingRun(own, tmp_path, resume=True).train()
    assert points(tmp_path) == points(taught)


def test_a_teacher_may_lie_elsewhere_when_a_run_goes_on(first: Path, tmp_path: Path) -> None:
    """By the same file name; or be a later policy of the same run. By another name elsewhere it is another teacher."""
    early, late = (first / CHECKPOINT.format(k * EACH) for k in (1, 2))
    TrainingRun(config(EACH, warm_start=f"{early}:{EACH}"), tmp_path / "second").train()
    TrainingRun(config(2 * EACH, warm_start=f"{late}:{EACH}"), tmp_path / "second", resume=True).train()
    (tmp_path / "third").mkdir()
    elsewhere, other = shutil.copy(late, tmp_path), shutil.copy(late, tmp_path / "third" / "other.zip")
    TrainingRun(config(3 * EACH, warm_start=f"{elsewhere}:{EACH}"), tmp_path / "second", resume=True).train()
    for wrong in (f"{elsewhere}:{2 * EACH}", f"{elsewhere}", f"{other}:{EACH}", "scripted"):
        with pytest.raises(TrainingError, match="begun with warm_start = "):
            TrainingRun(config(4 * EACH, warm_start=wrong), tmp_path / "second", resume=True)


def test_a_file_is_where_the_weights_begin(first: Path, tmp_path: Path) -> None:
    file = Path(shutil.copy(first / CHECKPOINT.format(EACH), tmp_path))
    TrainingRun(config(EACH, warm_start=str(file)), tmp_path / "second").train()
    assert same(weights(tmp_path / "second" / START), weights(file))
    file.unlink()  # a run that goes on needs it no more
    TrainingRun(config(2 * EACH, warm_start=str(file)), tmp_path / "second", resume=True).train()
    sides = Trainer(config(policies="agent", warm_start=str(tmp_path / "second" / START)))
    sides.take_weights()
    assert len(sides.policies) == 2
    assert same(sides.policies[0].state_dict(), sides.policies[1].state_dict())


@pytest.mark.parametrize("critic", ["own", "state"])
def test_weights_of_other_scales_are_the_same_function(critic: str, tmp_path: Path) -> None:
    file, trained = str(tmp_path / "a.zip"), Trainer(config(critic=critic))
    trained.update(trained.collect())
    checkpoint.write_checkpoint(Path(file), trained.policy_files(trained.config.header()))
    plain, large = (
        Trainer(config(warm_start=file, critic=critic, scenario=SHORT.replace(room_size=size)))
        for size in (SHORT.numbers()["room_size"], 50.0)
    )
    assert not torch.equal(plain.policies[0].extractors[0].own_scale, large.policies[0].extractors[0].own_scale)
    outputs = []
    for trainer in (plain, large):
        trainer.take_weights()
        (seen,) = plain.lane.observe().values()
        if critic == "state":
            seen.state *= torch.from_numpy(plain.state_scale / trainer.state_scale)
        with torch.no_grad():
            outputs.append(trainer.policies[0](seen)[:2])
    for one, other in zip(*outputs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_a_game_with_other_counts_begins_with_the_weights_of_its_first_sides(tmp_path: Path) -> None:
    file, options = tmp_path / "a.zip", {"worlds": 4, "rollout": 16}
    trained = Trainer(config(scenario=HIDE_SMALL, policies="side", **options))
    trained.update(trained.collect())
    checkpoint.write_checkpoint(file, trained.policy_files(trained.config.header()))
    task = Trainer(config(scenario=BLUEPRINT, policies="side", warm_start=str(file), **options))  # one side, 8 crates
    task.take_weights()
    hider, seeker = (policy.state_dict() for policy in trained.policies)
    (own,) = (policy.state_dict() for policy in task.policies)
    assert not same(hider, seeker)
    actor = [name for name in own if name.startswith("actor")]
    assert same({name: own[name] for name in actor}, hider)
    assert not same({name: own[name] for name in actor}, seeker)
    task.collect()
    shared = Trainer(config(scenario=HIDE_SMALL, warm_start=str(file), **options))  # one policy of both sides
    with pytest.raises(TrainingError, match="are 2 of preset 'fast'"):
        shared.take_weights()


def test_other_networks_can_be_imitated_but_not_taken(first: Path, tmp_path: Path) -> None:
    file = first / CHECKPOINT.format(EACH)
    with pytest.raises(TrainingError, match=rf"preset 'fast'.*imitate it instead: --warm-start .*\.zip:{IMITATED}"):
        TrainingRun(config(EACH, preset="scaled", warm_start=str(file)), tmp_path / "run")
    assert not (tmp_path / "run").exists()
    TrainingRun(config(EACH, preset="scaled", warm_start=f"{file}:{EACH}"), tmp_path / "run").train()
    assert START in names(tmp_path / "run")


def test_what_a_warm_start_means(first: Path) -> None:
    meanings = {"": ("", 0), "scripted": ("scripted", IMITATED), "scripted:2e6": ("scripted", 2_000_000)}
    meanings |= {"c:/a.zip": ("c:/a.zip", 0), "c:/a.zip:5": ("c:/a.zip", 5), f"{first}:7": (f"{first}", 7)}
    assert {text: parse_warm_start(text) for text in meanings} == meanings
    for text in ("script", "random", "scripted:0", "scripted:x", "scripted:1.5", "scripted:inf", ":5"):
        with pytest.raises(TrainingError, match="warm start"):
            config(warm_start=text)


def test_an_annealed_number_follows_from_the_steps(tmp_path: Path) -> None:
    """Each rollout is played, and logged, with the value that its first step has; rewards, too."""
    anneal = parse_anneal([f"rewards_alive=5:1@{2 * EACH}", "safe_zone_damage=3:1"])
    own = config(4 * EACH, anneal=anneal, every=2 * EACH, settings={"scale_rewards": False})
    played: list[tuple[int, float]] = []

    def note(run: TrainingRun) -> None:
        if run.now == "epoch 1":
            rewards = run.trainer.lane.samples.rewards
            played.append((int(run.trainer.env.worlds.number("safe_zone_damage")), float(np.max(rewards))))

    TrainingRun(own, tmp_path / "whole").train(note)
    found = points(tmp_path / "whole")
    alive, damage = (5.0, 3.0, 1.0, 1.0), (3, 2, 2, 2)
    assert played == [*zip(damage, alive, strict=True)]
    assert found["anneal/rewards_alive"] == [(k * EACH, value) for k, value in enumerate(alive, 1)]
    assert found["anneal/safe_zone_damage"] == [(k * EACH, value) for k, value in enumerate(damage, 1)]
    last = tmp_path / "whole" / CHECKPOINT.format(4 * EACH)
    assert checkpoint.header_of(checkpoint.read_checkpoint(last))["scenario"] == fingerprint(SHORT)
    last.unlink()
    TrainingRun(own, tmp_path / "whole", resume=True).train()
    assert points(tmp_path / "whole") == found
    with pytest.raises(TrainingError, match="begun with anneal = "):
        TrainingRun(config(4 * EACH, settings=own.settings), tmp_path / "whole", resume=True)


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("rewards_kil=1:0", "no number 'rewards_kil'; did you mean rewards_kill"),
        ("inventory_slots=4:8", "inventory_slots cannot change while worlds run: Inventory.dims"),
        ("melee_damage=5:-1", "melee.damage = -1: must be >= 0"),
        ("rewards_basis=1:0", "rewards_basis is 'side': only a single number can be annealed"),
        ("rewards_kill=a:b", "NUMBER=FROM:TO or"),
        ("rewards_kill=inf:0", "numbers must be finite"),
        ("rewards_kill=1:0@0", "STEPS an integer of at least 1"),
        ("heals_amount=1:40", "heals_amount varies from world to world; annealing sets one value for all"),
    ],
)
def test_what_cannot_be_annealed_is_refused(text: str, wrong: str) -> None:
    with pytest.raises((TrainingError, NumberError), match=wrong):
        Trainer(config(scenario=SHORT.vary(heals_amount=integers(5, 20)), anneal=parse_anneal([text])))
