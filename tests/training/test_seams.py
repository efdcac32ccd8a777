"""Losses, networks and callbacks of a user's own: outlast.train(loss=..., networks=..., callbacks=...)."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import outlast
from docs.examples.own_ppo import Pooled, Predicting, kl_penalty, predicting
from outlast.envs.scenarios.hide_and_seek import HIDE_DOOR
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.presets import preset
from outlast.training.policies.player import Player
from outlast.training.policies.policy import ActorCritic
from outlast.training.policies.rows import Rows
from outlast.training.ppo import learner
from outlast.training.ppo.loss import ppo_loss
from outlast.training.ppo.minibatches import Batch
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs.run import TrainingRun
from outlast.training.runs.train import TrainedRun
from tests.helpers.runs import assert_same, points
from tests.helpers.trainers import make, weights

OWN = Pooled.__module__
EACH = 8 * 32 * 2  # agent-steps of a rollout
TINY: dict[str, Any] = {"worlds": 8, "rollout": 8 * 32, "threads": 1, "quiet": True}
TINY["settings"] = {"batch_size": 128, "anneal_lr": False}


class Remembering(Pooled):
    """Mixes what it sees with its memory."""

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


def test_the_clip_can_be_changed_into_a_penalty() -> None:
    """And gradients are the same in shares as in one."""
    after = []
    for share in (10**6, 24):
        trainer = make("fast", loss=kl_penalty, target_kl=0.0, n_epochs=2)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(learner, "SHARE", share)
            logged = trainer.update(trainer.collect())
        after.append(weights(trainer.policies[0]))
        assert {"train/policy_loss", "train/value_loss", "train/loss", "train/approx_kl"} < logged.keys()
    torch.testing.assert_close(*after, rtol=1e-3, atol=1e-4)
    plain = make("fast", target_kl=0.0, n_epochs=2)
    plain.update(plain.collect())
    assert not torch.allclose(weights(plain.policies[0]), after[0], rtol=1e-3, atol=1e-4)


def test_old_values_are_those_of_the_rollout() -> None:
    """And advantages as they were are what returns add to them."""
    seen: list[Batch] = []
    trainer = make("fast", loss=lambda batch: (seen.append(batch), ppo_loss(batch))[1], batch_size=10**6)
    rollout = trainer.collect()
    trainer.update(rollout)
    values, advantages = (torch.from_numpy(each.ravel()) for each in (rollout.values, rollout.advantages))
    for sorted_values, own in ((values, seen[0].old_values), (advantages, seen[0].returns - seen[0].old_values)):
        torch.testing.assert_close(own.sort().values, sorted_values.sort().values)


@pytest.mark.parametrize(
    ("networks", "options"),
    [(Pooled, {"policies": "side", "opponents": "self:1,past:1", "snapshots": 1}), (Remembering, {"memory": 8})],
)
def test_networks_of_ones_own(networks: Any, options: dict[str, Any], tmp_path: Path) -> None:
    run = train(tmp_path / "parts", networks=networks, **options)
    train(tmp_path / "parts", 3 * EACH, networks=networks, resume=True, **options)
    train(tmp_path / "whole", 3 * EACH, networks=networks, **options)
    assert_same(tmp_path / "parts", tmp_path / "whole")
    player = outlast.load_policy(run.policy)
    assert all(isinstance(policy, networks) for policy in player.policies)
    found = outlast.evaluate("ffa_2", [run.policy, "random"], episodes=4)
    assert "random" in str(found)
    more = train(tmp_path / "more", EACH, networks=networks, warm_start=run.policy, **options)
    assert more.steps == EACH
    if not player.memory:
        values, likely, attention = player.explainer()(outlast.make_vec("ffa_2", 2).reset(seed=0)[0])
        assert np.isfinite(values).all()
        assert np.isfinite(likely).all()
        assert not np.any(attention)
    with pytest.raises(TrainingError, match=f"begun with networks = .*{networks.__name__}, not None"):
        train(tmp_path / "parts", 4 * EACH, resume=True, **options)


def test_sides_have_networks_and_numbers_of_their_own(tmp_path: Path) -> None:
    """Seekers lack grab and lock, learn more slowly, and by other networks; a resumed run is the same to the byte."""
    roles = {"hider": outlast.role(2), "seeker": outlast.role(2, without=["grab", "lock"])}
    game = HIDE_DOOR.roles(**roles).replace(ending_limit=20, preparation_ticks=5, handling_reach=3)
    seekers: dict[str, Any] = {
        "seeker:learning_rate": 1e-4,
        "seeker:n_epochs": 3,
        "batch_size": 128,
        "anneal_lr": False,
    }
    own = {"policies": "side", "networks": {"seeker": Pooled}, "opponents": "self:1,past:1", "snapshots": 1}
    options = TINY | own | {"settings": seekers}

    def trained(folder: str, rollouts: int, **more: Any) -> TrainedRun:
        return outlast.train(game, tmp_path / folder, steps=rollouts * 2 * EACH, **(options | more))

    run = trained("parts", 2)
    trained("parts", 3, resume=True)
    trained("whole", 3)
    assert_same(tmp_path / "whole", tmp_path / "parts")
    assert [type(policy) for policy in Player(run.policy).policies] == [ActorCritic, Pooled]
    trainer = make("fast", scenario=game, policies="side", **{"seeker:n_epochs": 7})
    assert [learner.numbers.n_epochs for learner in trainer.learners] == [3, 7]
    rollout = trainer.collect()
    hiding, seeking = (rollout.learner == number for number in (0, 1))
    grab = [name for name, _ in trainer.env.action_columns].index("grab")
    assert (rollout.actions[seeking][:, grab] == 0).all()  # nothing else is drawn for who lacks the action
    assert rollout.actions[hiding][:, grab].any()
    played = outlast.evaluate(game, [run.policy, "random"], episodes=2, worlds=2, quiet=True)
    assert len(played.pairings) == 3
    with pytest.raises(TrainingError, match="begun with settings = "):
        trained("parts", 4, resume=True, settings=seekers | {"seeker:n_epochs": 4})
    for given, words in (
        ({"settings": {"seekr:n_epochs": 4}}, "unknown policy 'seekr'; did you mean seeker"),
        ({"networks": {"finder": Pooled}}, "networks: unknown policy 'finder'; did you mean hider"),
        ({"settings": {"seeker:gamma": 0.9}}, "seeker:gamma: all policies share gamma"),
        ({"policies": "shared"}, "of one side need policies of their own: take policies = 'side'"),
    ):
        with pytest.raises(TrainingError, match=words):
            trained("other", 1, **given)


def test_sides_have_presets_of_their_own(tmp_path: Path) -> None:
    """Each observes, learns and plays as where all have its preset; what a rollout is, the first one says."""
    game = HIDE_DOOR.replace(ending_limit=20, preparation_ticks=5, handling_reach=3)
    mixed, usual = "fast,seeker:original", {"policies": "side", "worlds": 8}
    own: dict[str, Any] = usual | {"preset": mixed, "opponents": "self:1,past:1", "snapshots": 1}

    def trained(folder: str, rollouts: int, **more: Any) -> TrainedRun:
        return outlast.train(game, tmp_path / folder, steps=rollouts * 2 * EACH, **(TINY | own | more))

    run = trained("parts", 2)
    trained("parts", 3, resume=True)
    trained("whole", 3)
    assert_same(tmp_path / "whole", tmp_path / "parts")
    player = Player(run.policy)
    assert [policy.preset.name for policy in player.policies] == ["fast", "original"]
    env = outlast.make_vec(player.scenario(game), 2, seed=0)
    assert env.scenario.numbers()["cameras_mode"] == "revealed"
    values, likely, attention = player.explainer()(env.reset()[0])
    assert np.isfinite(values).all()
    assert np.isfinite(likely).all()
    assert (attention.sum(-1) <= 1 + 1e-6).all()
    assert len(outlast.evaluate(game, [run.policy, "random"], episodes=2, worlds=2, quiet=True).pairings) == 3
    config = TrainingConfig(game, mixed, rollout=8 * 32, **usual)
    assert config.numbers_by_policy["seeker"].target_kl == preset("original").numbers.target_kl
    assert config.numbers_by_policy["seeker"].scale_rewards == config.numbers.scale_rewards
    assert config.size == TrainingConfig(game, "fast", rollout=8 * 32, **usual).size
    rollout = Trainer(config).collect()
    seeking = rollout.learner == 1
    assert not rollout.idle[seeking].any()
    assert rollout.idle[~seeking].any()
    for number, (name, parts) in enumerate({"fast": ("own", "entities", "count"), "original": ("packed",)}.items()):
        (there,) = Trainer(TrainingConfig(game, name, rollout=8 * 32, **usual)).collect().seen.values()
        first = torch.from_numpy(np.flatnonzero(rollout.learner[0] == number))  # actions differ from then on
        one, other = rollout.seen[preset(name).form].select(first), there.select(first)
        assert all(torch.equal(getattr(one, part), getattr(other, part)) for part in parts)
    for given, words in (
        ({"preset": "fast,seekr:paper"}, "preset: unknown policy 'seekr'; did you mean seeker"),
        ({"preset": "seeker:paper"}, "one for all other sides is needed, too, as in fast,seeker:paper"),
        ({"preset": "fast,seeker:paper,seeker:scaled"}, "seeker cannot have both paper and scaled"),
        ({"policies": "shared"}, "of one side need policies of their own: take policies = 'side'"),
    ):
        with pytest.raises(ValueError, match=words):
            trained("other", 1, **given)


def test_networks_that_are_not_imported_are_named(tmp_path: Path, monkeypatch) -> None:
    run = train(tmp_path / "run", EACH, networks=Pooled)
    monkeypatch.delattr(f"{OWN}.Pooled")
    with pytest.raises(TrainingError, match=f"networks are {OWN}.Pooled, which are not imported.* --import FILE.py"):
        Player(run.policy)


def test_a_critic_of_the_state_plays_without_it(tmp_path: Path) -> None:
    run = train(tmp_path / "run", EACH, networks=WithState, critic="state")
    assert np.asarray(Player(run.policy)(outlast.make_vec("ffa_2", 2).reset(seed=0)[0])).shape == (2, 2, 6)
    with pytest.raises(TrainingError, match="Pooled has a critic that learns from the state: define logs"):
        make("fast", networks=Pooled, critic="state")


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
    assert [int(path.stem[6:]) // EACH for path in sorted(tmp_path.glob("parts/steps_*.zip"))][-1] == saved
    train(tmp_path / "parts", 3 * EACH, resume=True)
    train(tmp_path / "whole", 3 * EACH)
    whole, parts = (points(tmp_path / name)["train/loss"] for name in ("whole", "parts"))
    assert whole == parts


@pytest.mark.parametrize("callbacks", [[print], [type("Wrong", (), {"on_rolout": print})()], Watching()])
def test_what_is_no_callback_is_refused(callbacks: Any, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="callbacks"):
        train(tmp_path / "run", callbacks=callbacks)
    assert not (tmp_path / "run").exists()
