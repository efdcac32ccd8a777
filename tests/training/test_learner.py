"""Updates: against Stable-Baselines3's, their minibatches, and what each number of PPO does."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest

from tests.helpers.execution_modes import short

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base import hyperparameters  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.hyperparameters import Hyperparameters  # noqa: E402
from outlast.training.ppo import learner  # noqa: E402
from outlast.training.ppo.adam import Adam  # noqa: E402
from outlast.training.ppo.learner import explained_variance  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from tests.helpers.trainers import SHORT, in_float64, make, weights  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


# ---- Stable-Baselines3


@pytest.mark.parametrize(
    ("preset", "options", "close"),
    [  # close: of the parameters, in proportion to how far they move
        ("original", {}, 1e-5),
        ("paper", {}, 1e-12),
        ("paper", {"ent_coef": 0.01, "dead": "drop", "scenario": short("teams_3+steering")}, 1e-12),
        ("original", {"ent_coef": 1.0, "n_epochs": 5, "batch_size": 200}, 1e-12),
        ("fast", {"ent_coef": 0.01, "n_epochs": 5, "batch_size": 200, "target_kl": 0.0}, 1e-12),
    ],
)
@pytest.mark.by_day(3)
def test_an_update_is_that_of_stable_baselines(preset: str, options: dict[str, Any], close: float) -> None:
    """With the paper's numbers: 400 epochs unless the divergence ends them. 1e-5: with the rounding of float32."""
    pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[sb3]")
    from tests.helpers import sb3_oracle

    trainer = make(preset, **({"batch_size": 512, "n_epochs": 400, "learning_rate": 3e-4} | options))
    rollout = trainer.collect()
    if close < 1e-6:
        trainer.policies[0].double()
        trainer.learners[0].optimizer = Adam(trainer.learners[0].parameters)  # whose moments are float64, too
        rollout = in_float64(rollout)
    before, sizes = weights(trainer.policies[0]), [int(size) for size in trainer.env.action_sizes]
    expected, logged = sb3_oracle.update(trainer.learners[0], rollout, sizes)
    report = trainer.update(rollout)
    moved = weights(expected) - before
    assert float((weights(trainer.policies[0]) - before - moved).norm()) < close * float(moved.norm())
    assert trainer.learners[0].epochs == logged["train/n_updates"]
    assert trainer.learners[0].epochs == 5 or (1 < report["train/epochs"] < 100)
    same = {"entropy": -logged["train/entropy_loss"], "policy_loss": logged["train/policy_gradient_loss"]}
    same |= {name: logged[f"train/{name}"] for name in ("value_loss", "clip_fraction", "learning_rate")}
    if not options.get("dead"):  # of whose samples it takes all
        same["explained_variance"] = logged["train/explained_variance"]
    assert {name: report[f"train/{name}"] for name in same} == pytest.approx(same, rel=1e-4, abs=1e-6)


# ---- minibatches


def parts_of(trainer: Trainer, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The numbers of the samples of each minibatch, as updates go on."""
    parts: list[Any] = []
    inner = trainer.learners[0]._differentiate
    monkeypatch.setattr(
        trainer.learners[0],
        "_differentiate",
        lambda samples, part, shared: (parts.append(part), inner(samples, part, shared))[1],
    )
    return parts


@pytest.mark.parametrize(
    "options", [{"preset": "fast"}, {"preset": "paper", "memory": 8, "rollout": 192}, {"critic": "state"}], ids=str
)
def test_results_do_not_depend_on_threads(options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Bit for bit; and minibatches that are not cut into shares have the same gradients, up to rounding."""

    def trained(threads: int, share: int) -> torch.Tensor:
        monkeypatch.setattr(learner, "SHARE", share)
        trainer = make(threads=threads, **({"target_kl": 0.0} | options))
        for _ in range(2):
            trainer.update(trainer.collect())
        return weights(trainer.policies[0])

    one, two, three = (trained(threads, 20) for threads in (1, 2, 3))
    assert torch.equal(one, two)
    assert torch.equal(one, three)
    whole, began = trained(1, 10**6), weights(make(**options).policies[0])
    assert not torch.equal(one, whole)
    assert float((one - whole).norm()) < 1e-3 * float((whole - began).norm())


@pytest.mark.parametrize("dead", ["keep", "drop"])
def test_an_epoch_takes_every_sample_once(dead: str, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = make(dead=dead, batch_size=100, n_epochs=2, target_kl=0.0)
    rollout, parts = trainer.collect(), parts_of(trainer, monkeypatch)
    begun: list[int] = []
    trainer.update(rollout, on_epoch=begun.append)
    assert begun == [1, 2]
    count = int(rollout.alive.sum()) if dead == "drop" else rollout.alive.size
    first, second = (torch.cat(parts[k : k + len(parts) // 2]).numpy() for k in (0, len(parts) // 2))
    for drawn in (first, second):
        assert len(drawn) == len(set(drawn)) == count
        assert dead == "keep" or rollout.alive.ravel()[drawn].all()
        assert not np.array_equal(drawn, np.sort(drawn))
    assert not np.array_equal(first, second)
    assert {len(part) // 10 for part in parts} <= {9, 10, 11}


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 7])
def test_few_samples_make_no_minibatch_of_one(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whose advantage has no spread."""
    trainer = make("paper", batch_size=2, n_epochs=1)
    rollout, parts, before = trainer.collect(), parts_of(trainer, monkeypatch), weights(trainer.policies[0])
    owner = np.full(rollout.learner.shape, -1, np.int8)
    owner.ravel()[10 : 10 + count] = 0
    report = trainer.update(dataclasses.replace(rollout, learner=owner))
    assert bool(report) == bool(parts) == (count > 1) == (not torch.equal(before, weights(trainer.policies[0])))
    assert all(len(part) > 1 for part in parts)
    assert bool(weights(trainer.policies[0]).isfinite().all())


def test_a_learner_takes_its_own_samples_alone() -> None:
    """What others hold changes nothing."""
    after = []
    for noise in (0.0, 100.0):
        trainer = make("fast")
        rollout = trainer.collect()
        learner = (np.arange(rollout.learner.size).reshape(rollout.learner.shape) % 2).astype(np.int8)
        rollout.advantages[learner == 1] += noise
        trainer.update(dataclasses.replace(rollout, learner=learner))
        after.append(weights(trainer.policies[0]))
    assert torch.equal(*after)


def test_rounding_is_no_variance_that_values_could_explain() -> None:
    trainer = make("fast")
    rollout = trainer.collect()
    values = np.linspace(-0.1, 0.1, rollout.values.size, dtype=np.float32).reshape(rollout.values.shape)
    for varies in (0.0, 1e-3):
        returns = np.float32(1 / 3) + np.float32(varies) * rollout.alive
        same = dataclasses.replace(rollout, values=values, advantages=returns - values)
        assert same.returns.var() > 0
        assert np.isnan(explained_variance(same, np.arange(values.size))) == (not varies)


def test_the_divergence_ends_an_update() -> None:
    strict, lax = make(batch_size=64, target_kl=1e-9), make(batch_size=64, target_kl=0.0)
    epochs = [trainer.update(trainer.collect())["train/epochs"] for trainer in (strict, lax)]
    assert epochs[0] < 0.2
    assert epochs[1] == pytest.approx(3)


# ---- the numbers of PPO


OTHERS = {
    "learning_rate": "1e-4",
    "anneal_lr": "true",
    "batch_size": "200",
    "n_epochs": "2",
    "gamma": "0.9",
    "gae_lambda": "0.5",
    "clip_range": "1e-3",
    "ent_coef": "0.01",
    "vf_coef": "0.1",
    "max_grad_norm": "0.01",
    "target_kl": "1e-6",
    "scale_rewards": "true",
}


@functools.cache
def updated(**settings: Any) -> Any:
    """All parameters after one update with half of the run left, in a row."""
    trainer = make("paper", **settings)
    trainer.update(trainer.collect(), 0.5)
    return weights(trainer.policies[0])


@pytest.mark.parametrize("name", OTHERS)
def test_every_number_that_can_be_set_changes_an_update(name: str) -> None:
    assert not torch.equal(updated(), updated(**hyperparameters.parse_hyperparameters([f"{name}={OTHERS[name]}"])))


def test_a_number_that_stays_as_it_is_changes_nothing() -> None:
    """So that what the test above sees is the number's doing."""
    assert torch.equal(updated(), updated(**hyperparameters.parse_hyperparameters(["ent_coef=0"])))


def test_an_annealed_rate_is_that_of_a_smaller_one() -> None:
    assert torch.equal(updated(anneal_lr=True, learning_rate=2e-4), updated(learning_rate=1e-4))


def test_a_seed_decides_everything() -> None:
    def trained(seed: int) -> tuple[Any, Any]:
        trainer = make("fast", seed=seed, n_epochs=2)
        for _ in range(2):
            rollout = trainer.collect()
            trainer.update(rollout)
        return rollout.advantages, weights(trainer.policies[0])

    (found, weight), (again, same), (other, _) = trained(5), trained(5), trained(6)
    assert np.array_equal(found, again)
    assert torch.equal(weight, same)
    assert not np.array_equal(found, other)


# ---- refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        pytest.param(
            {"device": "cuda"},
            "there is no cuda here; take cpu",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="there is one"),
        ),
        ({"device": "abacus"}, "there is no abacus here; take cpu"),
        ({"dead": "bury"}, "dead = 'bury': allowed are 'keep', 'drop'"),
        (
            {"worlds": 8, "rollout": 100},
            "of 100 steps cannot be shared evenly by 8 worlds: take a multiple of 8, such as --rollout 96",
        ),
        ({"gamma": 2}, "gamma=2: a finite number from 0 to 1 is needed"),
        ({"target_kl": None}, "target_kl=None: a number like 0.01 is needed"),
        ({"n_epochs": 2.5}, "n_epochs=2.5: a whole number like 400 is needed"),
        ({"anneal_lr": 1}, "anneal_lr=1: true or false is needed"),
        ({"vf_coef": True}, "vf_coef=True: a number like 0.5 is needed"),
        ({"gama": 1}, "PPO has no number 'gama'; did you mean gamma"),
        ({"preset": "big"}, "there is no preset 'big'"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gamma=2", "gamma=2.0: a finite number from 0 to 1 is needed"),
        ("gae_lambda=-0.1", "gae_lambda=-0.1: a finite number from 0 to 1 is needed"),
        ("learning_rate=0", "learning_rate=0.0: a finite number above 0 is needed"),
        ("clip_range=nan", "clip_range=nan: a finite number above 0 is needed"),
        ("target_kl=inf", "target_kl=inf: a finite number of at least 0 is needed"),
        ("ent_coef=-1", "ent_coef=-1.0: a finite number of at least 0 is needed"),
        ("vf_coef=-1", "vf_coef=-1.0: a finite number of at least 0 is needed"),
        ("batch_size=1", "batch_size=1: a finite number of at least 2 is needed"),
        ("n_epochs=0", "n_epochs=0: a finite number of at least 1 is needed"),
        ("max_grad_norm=0", "max_grad_norm=0.0: a finite number above 0 is needed"),
        ("n_epochs=many", "n_epochs=many: a whole number like 400 is needed"),
        ("batch_size=64.5", "batch_size=64.5: a whole number like 512 is needed"),
        ("anneal_lr=perhaps", "anneal_lr=perhaps: true or false is needed"),
        ("scale_rewards=2", "scale_rewards=2: true or false is needed"),
        ("normalise=1", "PPO has no number 'normalise'; known: learning_rate, anneal_lr, batch_size"),
        ("gamma", "gamma: a number like 0.99 is needed"),
    ],
)
def test_numbers_of_ppo_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hyperparameters.parse_hyperparameters([text])


def test_whole_numbers_may_be_written_as_floats() -> None:
    texts = ["batch_size=1e4", "n_epochs=3"]
    assert hyperparameters.parse_hyperparameters(texts) == {"batch_size": 10_000, "n_epochs": 3}
    config = TrainingConfig(SHORT, steps=1e3, settings={"batch_size": 64.0})  # type: ignore[arg-type]
    found = config.steps, config.numbers.batch_size
    assert found == (1000, 64)
    assert {type(number) for number in found} == {int}


def test_every_number_has_a_range_in_which_the_papers_is() -> None:
    names = [each.name for each in dataclasses.fields(Hyperparameters)]
    truths = {name for name in names if isinstance(getattr(Hyperparameters, name), bool)}
    assert hyperparameters.RANGES.keys() | truths == OTHERS.keys() == set(names)
    assert TrainingConfig(SHORT, "original").numbers == Hyperparameters()
