"""A start by imitation, a start with saved weights, and numbers of the game that are annealed."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant
from outlast.ecs import NumberError
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.fingerprint import fingerprint

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training.base.annealing import Anneal, parse_anneal  # noqa: E402
from outlast.training.base.config import IMITATED, parse_warm_start  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.log_file import read_log  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.ppo.trainer import IMITATION, Trainer  # noqa: E402
from outlast.training.runs.run import TrainingConfig, TrainingRun  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
SHORT = variant("ffa_1").replace(agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10)
EACH = 8 * 24 * 2  # agent-steps of a rollout
START = CHECKPOINT.format(0)


def config(steps: int = 2 * EACH, **changes: Any) -> TrainingConfig:
    given = {"scenario": SHORT, "preset": "fast", "steps": steps, "worlds": 8, "rollout": 8 * 24, "threads": 1}
    return TrainingConfig(**(given | {"settings": {"batch_size": 64, "anneal_lr": False}, "seed": 3} | changes))


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """The points of a log, but for times."""
    found = read_log(folder / "log.csv")
    return {tag: values for tag, values in found.items() if not tag.startswith("time/") and "seconds" not in tag}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("*.zip"))


def weights(path: Path) -> dict[str, torch.Tensor]:
    (found,) = checkpoint.read_policies(path)[1]
    return found


def same(one: Any, other: Any) -> bool:
    return all(torch.equal(one[key], other[key]) for key in one)


def test_a_policy_learns_to_do_as_the_teacher_does() -> None:
    measured: list[dict[str, float]] = []
    trainer = Trainer(config(warm_start=f"scripted:{40 * EACH}"))
    last = trainer.imitate(lambda done, tags: measured.append({"done": done} | tags))
    assert [each["done"] for each in measured] == [EACH * (k + 1) for k in range(40)]
    assert last["imitation/differs"] < 0.6 * measured[0]["imitation/differs"]
    assert last["imitation/cross_entropy"] < 0.8 * measured[0]["imitation/cross_entropy"]
    assert last["imitation/agent_steps"] == 40 * EACH
    assert trainer.steps == trainer.updates == 0
    assert not trainer.learners[0].optimizer.moments[0]["step"]
    assert trainer.lane.teacher is None


def test_its_checkpoint_is_the_start_of_a_run_that_never_imitates_again(tmp_path: Path) -> None:
    own = config(4 * EACH, warm_start=f"scripted:{2 * EACH}", every=EACH)
    TrainingRun(own, tmp_path / "whole").train()
    assert names(tmp_path / "whole") == [CHECKPOINT.format(k * EACH) for k in range(5)]
    found = points(tmp_path / "whole")
    assert found["imitation/agent_steps"] == [(0, 2 * EACH)]
    assert [step for step, _ in found["train/loss"]] == [EACH * k for k in (1, 2, 3, 4)]
    TrainingRun(config(4 * EACH, every=EACH), tmp_path / "random").train()
    assert not same(weights(tmp_path / "whole" / START), weights(tmp_path / "random" / CHECKPOINT.format(EACH)))
    for k in range(1, 5):  # as if it had been killed behind its first checkpoint
        (tmp_path / "whole" / CHECKPOINT.format(k * EACH)).unlink()
    TrainingRun(own, tmp_path / "whole", resume=True).train()
    assert points(tmp_path / "whole") == found
    with pytest.raises(TrainingError, match="begun with warm_start = "):
        TrainingRun(config(4 * EACH, warm_start="scripted", every=EACH), tmp_path / "whole", resume=True)


def test_games_while_it_imitates_do_not_count() -> None:
    """Opponents are drawn, and rated, by what policies have done since PPO began."""
    trainer = Trainer(config(warm_start=f"scripted:{8 * EACH}", opponents={"self": 0.5, "scripted": 0.5}))
    trainer.imitate(lambda done, tags: None)
    assert [(one.won, one.games, one.total) for one in trainer.opponents.all.values()] == [(0, 0, 0)] * 2
    trainer.collect()
    assert trainer.opponents.all[1].total


def test_a_teacher_may_lie_elsewhere_when_a_run_goes_on(tmp_path: Path) -> None:
    """By the same file name; or be a later policy of the same run. By another name elsewhere it is another teacher."""
    TrainingRun(config(2 * EACH, every=EACH), tmp_path / "first").train()
    early, late = (tmp_path / "first" / CHECKPOINT.format(k * EACH) for k in (1, 2))
    TrainingRun(config(EACH, warm_start=f"{early}:{EACH}"), tmp_path / "second").train()
    (tmp_path / "moved").mkdir()
    TrainingRun(config(2 * EACH, warm_start=f"{late}:{EACH}"), tmp_path / "second", resume=True).train()
    elsewhere = shutil.copy(late, tmp_path / "moved")
    TrainingRun(config(3 * EACH, warm_start=f"{elsewhere}:{EACH}"), tmp_path / "second", resume=True).train()
    (tmp_path / "third").mkdir()
    other = shutil.copy(late, tmp_path / "third" / "other.zip")
    for wrong in (f"{elsewhere}:{2 * EACH}", f"{elsewhere}", f"{other}:{EACH}", "scripted"):
        with pytest.raises(TrainingError, match="begun with warm_start = "):
            TrainingRun(config(4 * EACH, warm_start=wrong), tmp_path / "second", resume=True)


def test_ctrl_c_while_it_imitates_saves_nothing_and_it_begins_again(tmp_path: Path) -> None:
    def stop(run: TrainingRun) -> None:
        assert run.now.startswith("imitated")
        raise KeyboardInterrupt

    own = config(EACH, warm_start=f"scripted:{3 * EACH}")
    with pytest.raises(KeyboardInterrupt):
        TrainingRun(own, tmp_path / "parts").train(stop)
    assert not names(tmp_path / "parts")
    TrainingRun(own, tmp_path / "parts", resume=True).train()
    TrainingRun(own, tmp_path / "whole").train()
    assert points(tmp_path / "parts") == points(tmp_path / "whole")


def test_an_imitation_that_diverges_is_said_to_be_so_and_saves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(IMITATION, "learning_rate", 1e6)
    run = TrainingRun(config(EACH, warm_start=f"scripted:{EACH}"), tmp_path / "run")
    with pytest.raises(TrainingError, match=f"imitation .* diverged: after {EACH} agent-steps .* --warm-start"):
        run.train()
    assert not names(tmp_path / "run")


def test_a_file_is_where_the_weights_begin(tmp_path: Path) -> None:
    TrainingRun(config(EACH), tmp_path / "first").train()
    file = tmp_path / "first" / CHECKPOINT.format(EACH)
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
    TrainingRun(config(EACH, critic=critic), tmp_path).train()
    file = str(tmp_path / CHECKPOINT.format(EACH))
    plain, large = (
        Trainer(config(warm_start=file, critic=critic, scenario=SHORT.replace(room_size=size)))
        for size in (SHORT.numbers()["room_size"], 50.0)
    )
    assert not torch.equal(plain.policies[0].extractors[0].own_scale, large.policies[0].extractors[0].own_scale)
    outputs = []
    for trainer in (plain, large):
        trainer.take_weights()
        seen = plain.lane._seen(plain.env.observe())
        if critic == "state":
            seen.state *= torch.from_numpy(plain.state_scale / trainer.state_scale)
        with torch.no_grad():
            outputs.append(trainer.policies[0](seen)[:2])
    for one, other in zip(*outputs, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_other_networks_can_be_imitated_but_not_taken(tmp_path: Path) -> None:
    TrainingRun(config(EACH, preset="scaled"), tmp_path / "first").train()
    file = tmp_path / "first" / CHECKPOINT.format(EACH)
    with pytest.raises(TrainingError, match=rf"preset 'scaled'.*imitate it instead: --warm-start .*\.zip:{IMITATED}"):
        TrainingRun(config(EACH, warm_start=str(file)), tmp_path / "second")
    assert not (tmp_path / "second").exists()
    TrainingRun(config(EACH, warm_start=f"{file}:{EACH}"), tmp_path / "second").train()
    assert START in names(tmp_path / "second")


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("", ("", 0)),
        ("scripted", ("scripted", IMITATED)),
        ("scripted:2e6", ("scripted", 2_000_000)),
        ("a.zip", ("a.zip", 0)),
        ("c:/a.zip", ("c:/a.zip", 0)),
        ("c:/a.zip:5", ("c:/a.zip", 5)),
    ],
)
def test_what_a_warm_start_means(text: str, meant: tuple[str, int]) -> None:
    assert parse_warm_start(text) == meant


def test_a_folder_may_have_a_colon(tmp_path: Path) -> None:
    TrainingRun(config(EACH), tmp_path / "a,self:0.5").train()
    for text, steps in (("", 0), (":7", 7)):
        assert parse_warm_start(f"{tmp_path}/a,self:0.5{text}") == (f"{tmp_path}/a,self:0.5", steps)


@pytest.mark.parametrize("text", ["script", "random", "scripted:0", "scripted:x", "scripted:1.5", "scripted:inf", ":5"])
def test_what_no_warm_start_is(text: str) -> None:
    with pytest.raises(TrainingError, match="warm start"):
        config(warm_start=text)


def test_an_annealed_number_follows_from_the_steps(tmp_path: Path) -> None:
    """Each rollout is played, and logged, with the value that its first step has."""
    own = config(
        4 * EACH, anneal=parse_anneal([f"rewards_alive=5:1@{2 * EACH}", "safe_zone_damage=3:1"]), every=2 * EACH
    )
    TrainingRun(own, tmp_path / "whole").train()
    found = points(tmp_path / "whole")
    assert found["anneal/rewards_alive"] == [(k * EACH, value) for k, value in ((1, 5.0), (2, 3.0), (3, 1.0), (4, 1.0))]
    assert found["anneal/safe_zone_damage"] == [(k * EACH, value) for k, value in ((1, 3), (2, 2), (3, 2), (4, 2))]
    last = tmp_path / "whole" / CHECKPOINT.format(4 * EACH)
    assert checkpoint.header_of(checkpoint.read_checkpoint(last))["scenario"] == fingerprint(SHORT)
    last.unlink()
    TrainingRun(own, tmp_path / "whole", resume=True).train()
    assert points(tmp_path / "whole") == found
    with pytest.raises(TrainingError, match="begun with anneal = "):
        TrainingRun(config(4 * EACH), tmp_path / "whole", resume=True)


def test_rewards_are_those_of_the_moment() -> None:
    trainer = Trainer(config(4 * EACH, anneal=(Anneal("rewards_alive", 8.0, 0.0, 2 * EACH),)))
    trainer.collector.numbers = trainer.learners[0].numbers
    seen = []
    for _ in range(3):
        trainer.collect()
        seen.append(float(np.max(trainer.lane.samples.rewards)))
    assert seen == [8.0, 4.0, 0.0]


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("rewards_kil=1:0", "no number 'rewards_kil'; did you mean rewards_kill"),
        ("inventory_slots=4:8", "inventory_slots cannot change while worlds run: Inventory.dims"),
        ("melee_damage=5:-1", "melee.damage = -1: must be >= 0"),
        ("melee_damage=5.5:1", "melee.damage = 5.5: an integer"),
        ("rewards_basis=1:0", "rewards_basis is 'side': only a single number can be annealed"),
        ("safe_zone_radii=1:2", "only a single number can be annealed"),
        ("rewards_kill=1", "NUMBER=FROM:TO or"),
        ("rewards_kill=a:b", "NUMBER=FROM:TO or"),
        ("rewards_kill=inf:0", "finite numbers are needed"),
        ("rewards_kill=1:0@0", "of STEPS a whole one of at least 1"),
    ],
)
def test_what_cannot_be_annealed_is_refused(text: str, wrong: str) -> None:
    with pytest.raises((TrainingError, NumberError), match=wrong):
        Trainer(config(anneal=parse_anneal([text])))
