"""Losses, networks and callbacks of a user's own: outlast.train(loss=..., networks=..., callbacks=...)."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import outlast
from docs.examples.own_ppo import Pooled, Predicting, kl_penalty, predicting
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.hide_and_seek import HIDE_DOOR
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.presets import preset
from outlast.training.policies.player import Player
from outlast.training.policies.policy import ActorCritic
from outlast.training.policies.rows import Rows
from outlast.training.ppo.loss import ppo_loss
from outlast.training.ppo.minibatches import Batch
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs.run import TrainingRun
from outlast.training.runs.train import TrainedRun
from tests.helpers.runs import names, points
from tests.helpers.trainers import make

OWN = Pooled.__module__
EACH = 8 * 32 * 2  # agent-steps of a rollout
TINY: dict[str, Any] = {"worlds": 8, "rollout": 8 * 32, "threads": 1, "quiet": True}
TINY["settings"] = {"batch_size": 128, "anneal_lr": False}


class Remembering(Pooled):
    def forward(self, seen: Any, memory: Any = None, begins: Any = None) -> Any:
        logs, values, _ = super().forward(seen)
        last = values.detach().view(-1, len(memory))
        for new, step in zip(begins.view(last.shape), last, strict=True):
            memory = 0.5 * memory * ~new[:, None] + step[:, None]
        return logs, values + memory.mean(1).repeat(len(last)), memory


class WithState(Pooled):
    """A critic that learns nothing from the state that it gets."""

    def logs(self, seen: Any, memory: Any = None, begins: Any = None) -> Any:
        assert seen.state is None
        return super().logs(seen, memory, begins)


ROLES = {"hider": outlast.role(2), "seeker": outlast.role(2, without=["grab", "lock"])}
HIDING = HIDE_DOOR.roles(**ROLES).replace(ending_limit=20, preparation_ticks=5, handling_reach=3)
SEEKERS = {"seeker:learning_rate": 1e-4, "seeker:n_epochs": 3, "batch_size": 128, "anneal_lr": False}


def train(folder: Path, steps: int = 2 * EACH, **options: Any) -> TrainedRun:
    return outlast.train("ffa_2", folder, steps=steps, **(TINY | options))


def test_a_loss_with_an_auxiliary_term_is_trained(tmp_path: Path) -> None:
    own = {"loss": predicting, "networks": Predicting}
    whole = train(tmp_path / "whole", 3 * EACH, **own)
    logged = [value for _, value in points(tmp_path / "whole")["train/prediction"]]
    assert logged[-1] < 0.9 * logged[0]
    assert {"train/loss", "train/approx_kl", "train/policy_loss"} <= whole.logged.keys()
    train(tmp_path / "parts", EACH, **own)
    assert train(tmp_path / "parts", 3 * EACH, **own, resume=True).logged["train/prediction"] == logged[-1]
    plan = Player(whole.policy).header["plan"]
    assert (plan["loss"], plan["networks"]) == (f"{OWN}.predicting", f"{OWN}.Predicting")
    for other in (None, kl_penalty):
        with pytest.raises(TrainingError, match=f"begun with loss = {OWN}.predicting, not "):
            train(tmp_path / "parts", 4 * EACH, networks=Predicting, loss=other, resume=True)


def test_old_values_are_those_of_the_rollout() -> None:
    seen: list[Batch] = []
    trainer = make("fast", loss=lambda batch: (seen.append(batch), ppo_loss(batch))[1], batch_size=10**6)
    rollout = trainer.collect()
    trainer.update(rollout)
    values, advantages = (torch.from_numpy(each.ravel()) for each in (rollout.values, rollout.advantages))
    for sorted_values, own in ((values, seen[0].old_values), (advantages, seen[0].returns - seen[0].old_values)):
        torch.testing.assert_close(own.sort().values, sorted_values.sort().values)


@pytest.mark.parametrize(
    ("networks", "options"),
    [
        (Pooled, {"policies": "side", "opponents": "self:1,past:1", "snapshots": 1}),
        (Remembering, {"memory": 8}),
        (WithState, {"critic": "state"}),
    ],
)
def test_networks_of_ones_own(networks: Any, options: dict[str, Any], tmp_path: Path) -> None:
    run = train(tmp_path / "run", networks=networks, **options)
    player = outlast.load_policy(run.policy)
    assert all(isinstance(policy, networks) for policy in player.policies)
    assert "random" in str(outlast.evaluate("ffa_2", [run.policy, "random"], episodes=4))
    more = train(tmp_path / "more", EACH, networks=networks, warm_start=run.policy, **options)
    assert more.steps == EACH
    if networks is Pooled:
        values, likely, attention = player.explainer()(outlast.make_vec("ffa_2", 2).reset(seed=0)[0])
        assert np.isfinite([values.sum(), likely.sum()]).all()
        assert not np.any(attention)
    with pytest.raises(TrainingError, match=f"begun with networks = .*{networks.__name__}, not None"):
        train(tmp_path / "run", 4 * EACH, resume=True, **options)


@pytest.mark.parametrize(
    ("own", "kinds"),
    [
        ({"networks": {"seeker": Pooled}, "settings": SEEKERS}, [(ActorCritic, "fast"), (Pooled, "fast")]),
        ({"preset": "fast,seeker:original"}, [(ActorCritic, "fast"), (ActorCritic, "original")]),
    ],
    ids=["networks", "presets"],
)
def test_sides_have_networks_and_numbers_of_their_own(own: dict[str, Any], kinds: Any, tmp_path: Path) -> None:
    opposed: dict[str, Any] = {"policies": "side", "opponents": "self:1,past:1", "snapshots": 1}
    run = outlast.train(HIDING, tmp_path, steps=1, **(TINY | opposed | own))
    player = Player(run.policy)
    assert [(type(policy), policy.preset.name) for policy in player.policies] == kinds
    env = outlast.make_vec(player.scenario(HIDING), 2, seed=0)
    assert env.scenario.numbers()["cameras_mode"] == ("revealed" if "preset" in own else "masked")
    values, likely, attention = player.explainer()(env.reset()[0])
    assert np.isfinite([values.sum(), likely.sum()]).all()
    assert (attention.sum(-1) <= 1 + 1e-6).all()
    played = outlast.evaluate(HIDING, [run.policy, "random"], episodes=2, worlds=2, quiet=True)
    assert len(played.pairings) == 3
    others = SEEKERS | {"seeker:n_epochs": 4}
    with pytest.raises(TrainingError, match="begun with settings = "):
        outlast.train(HIDING, tmp_path, steps=1, resume=True, **(TINY | opposed | own | {"settings": others}))


def test_sides_have_presets_of_their_own() -> None:
    """Each observes, learns and plays as where all have its preset; what a rollout is, the first one says."""
    usual = {"policies": "side", "worlds": 8, "rollout": 8 * 32}
    config = TrainingConfig(HIDING, "fast,seeker:original", **usual)
    assert config.numbers_by_policy["seeker"].target_kl == preset("original").numbers.target_kl
    assert config.numbers_by_policy["seeker"].scale_rewards == config.numbers.scale_rewards
    assert config.size == TrainingConfig(HIDING, "fast", **usual).size
    rollout = Trainer(config).collect()
    seeking = rollout.learner == 1
    assert not rollout.idle[seeking].any()
    assert rollout.idle[~seeking].any()
    for number, (name, parts) in enumerate({"fast": ("own", "entities", "count"), "original": ("packed",)}.items()):
        (there,) = Trainer(TrainingConfig(HIDING, name, **usual)).collect().seen.values()
        first = torch.from_numpy(np.flatnonzero(rollout.learner[0] == number))  # actions differ from then on
        one, other = rollout.seen[preset(name).form].select(first), there.select(first)
        assert all(torch.equal(getattr(one, part), getattr(other, part)) for part in parts)
    trainer = make("fast", scenario=HIDING, policies="side", **{"seeker:n_epochs": 7})
    assert [learner.numbers.n_epochs for learner in trainer.learners] == [3, 7]
    rollout = trainer.collect()
    grab = [name for name, _ in trainer.env.action_columns].index("grab")
    hiding, seeking = (rollout.actions[rollout.learner == number][:, grab] for number in (0, 1))
    assert hiding.any()
    assert not seeking.any()  # nothing else is drawn for who lacks the action


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"settings": {"seekr:n_epochs": 4}}, "unknown policy 'seekr'; did you mean seeker"),
        ({"networks": {"finder": Pooled}}, "networks: unknown policy 'finder'; did you mean hider"),
        ({"settings": {"seeker:gamma": 0.9}}, "seeker:gamma: all policies share gamma"),
        ({"settings": SEEKERS, "policies": "shared"}, "of one side need policies of their own: take policies = 'side'"),
        ({"preset": "fast,seeker:paper", "policies": "shared"}, "of one side need policies of their own: take poli"),
        ({"preset": "fast,seekr:paper"}, "preset: unknown policy 'seekr'; did you mean seeker"),
        ({"preset": "seeker:paper"}, "one for all other sides is needed, too, as in fast,seeker:paper"),
        ({"preset": "fast,seeker:paper,seeker:scaled"}, "seeker cannot have both paper and scaled"),
    ],
)
def test_sides_that_cannot_be_are_refused(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Trainer(TrainingConfig(HIDING, **({"preset": "fast", "policies": "side", "worlds": 1, "rollout": 16} | given)))


def test_networks_that_are_not_imported_are_named(tmp_path: Path, monkeypatch) -> None:
    run = train(tmp_path / "run", EACH, networks=Pooled)
    monkeypatch.delattr(f"{OWN}.Pooled")
    with pytest.raises(TrainingError, match=f"networks are {OWN}.Pooled, which are not imported.* --import FILE.py"):
        Player(run.policy)


class NoLogs(Pooled):
    def forward(self, seen: Any, memory: Any = None, begins: Any = None) -> Any:
        logs, values, memory = super().forward(seen, memory, begins)
        return logs + 1, values, memory


class WideValues(Pooled):
    def forward(self, seen: Any, memory: Any = None, begins: Any = None) -> Any:
        logs, values, memory = super().forward(seen, memory, begins)
        return logs, values[:, None], memory


def mean(batch: Any) -> Any:
    return batch.mean(batch.values)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"loss": lambda batch: (batch.returns - batch.values).square().mean()}, "and those of its halves are .* must"),
        ({"loss": lambda batch: 1.0}, "returns 1.0: it must return a tensor without axes"),
        ({"loss": lambda batch: batch.values}, "it must return a tensor without axes"),
        ({"loss": lambda batch: batch.mean(batch.returns)}, "a tensor without axes, computed from the netw"),
        ({"loss": lambda batch: (mean(batch), {"values": batch.values})}, "figure 'values' must be one number"),
        ({"loss": lambda batch: (mean(batch), {"approx_kl": 1.0})}, "figure 'approx_kl', which is always logged"),
        ({"loss": lambda batch: (mean(batch), [1.0])}, r"figures \[1.0\]: they must be a dict by names"),
        ({"loss": lambda batch: (mean(batch), {f"f{id(batch)}": 1.0})}, "returns different figures than before"),
        ({"loss": "squared"}, "loss = 'squared': must be a function that takes a batch"),
        ({"loss": lambda batch: mean(batch), "processes": 2}, r"loss = .*<lambda> cannot be imported"),
        ({"networks": NoLogs}, "NoLogs does not return log probabilities"),
        ({"networks": WideValues}, r"WideValues returns tensors of shapes .* must be"),
        ({"networks": Pooled, "critic": "state"}, "Pooled has a critic that learns from the state: define logs"),
        ({"networks": Rows}, "networks = .*Rows.*: must be a subclass of outlast.training.policies.policy.Networks"),
        ({"networks": lambda *sizes, **given: None}, "networks = .*<lambda> cannot be imported"),
        ({"networks": 3}, "networks = 3: must be a subclass of"),
    ],
)
def test_other_losses_and_networks_are_refused(given: dict[str, Any], words: str) -> None:
    def trained() -> None:
        trainer = make("fast", **given)
        trainer.update(trainer.collect())

    with pytest.raises(TrainingError, match=words):
        trained()


class Watching:
    """Notes what is called; raises an error at a moment."""

    def __init__(self, stop: str = "") -> None:
        self.calls, self.stop = list[tuple[str, int]](), stop

    def on_rollout(self, run: TrainingRun, rollout: Any) -> None:
        assert rollout.learner.size == EACH
        self.note("rollout", run)

    def on_update(self, run: TrainingRun, tags: dict[str, float]) -> None:
        assert tags is run.tags
        run.log.write({"mine/half": tags["train/loss"] / 2}, run.done)
        self.note("update", run)

    def on_checkpoint(self, run: TrainingRun, path: Path) -> None:
        assert path.is_file()
        self.note("checkpoint", run)

    def note(self, moment: str, run: TrainingRun) -> None:
        self.calls.append((moment, run.done // EACH))
        if (moment, len(self.calls) > 3) == (self.stop, True):
            raise RuntimeError("stop")


def test_callbacks_are_called_as_the_run_goes_on(tmp_path: Path) -> None:
    watching = Watching()
    run = train(tmp_path / "a", callbacks=[watching], every=EACH)
    each = [("rollout", 0), ("update", 1), ("checkpoint", 1), ("rollout", 1), ("update", 2), ("checkpoint", 2)]
    assert watching.calls == each
    logged = points(tmp_path / "a")
    assert logged.pop("mine/half") == [(step, value / 2) for step, value in logged["train/loss"]]
    assert train(tmp_path / "b").logged["train/loss"] == run.logged["train/loss"]
    assert points(tmp_path / "b") == logged


@pytest.mark.parametrize(("moment", "saved"), [("rollout", 1), ("update", 2), ("checkpoint", 2)])
def test_an_error_in_a_callback_ends_the_run_which_is_saved(moment: str, saved: int, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="stop"):
        train(tmp_path / "parts", 4 * EACH, callbacks=[Watching(moment)], every=EACH)
    assert names(tmp_path / "parts")[-1] == CHECKPOINT.format(saved * EACH)
    train(tmp_path / "parts", 3 * EACH, resume=True)
    train(tmp_path / "whole", 3 * EACH)
    whole, parts = (points(tmp_path / name)["train/loss"] for name in ("whole", "parts"))
    assert whole == parts


@pytest.mark.parametrize("callbacks", [[print], [type("Wrong", (), {"on_rolout": print})()], Watching()])
def test_what_is_no_callback_is_refused(callbacks: Any, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="callbacks"):
        train(tmp_path / "run", callbacks=callbacks)
    assert not (tmp_path / "run").exists()
