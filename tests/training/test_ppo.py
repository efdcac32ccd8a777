"""Rollouts: advantages, scaled rewards, actions that can change nothing. Updates: against Stable-Baselines3's."""

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import pytest
import torch

from outlast import make_vec, variant
from outlast.ecs import Entity
from outlast.training.base import presets
from outlast.training.base.config import TrainingConfig
from outlast.training.base.presets import Hyperparameters
from outlast.training.ppo import learner
from outlast.training.ppo.learner import Adam, explained_variance
from outlast.training.ppo.rollout import RewardScale
from outlast.training.ppo.trainer import Trainer
from tests.helpers.execution_modes import short
from tests.helpers.goal import won_at_the_limit
from tests.helpers.trainers import SHORT, STEPS, WORLDS, in_float64, make, weights

GAMMA, LAMBDA = 0.99, 0.95
Row = dict[str, Any]


class Plain:
    """The same worlds, stepped one by one in plain Python with the actions of a rollout."""

    def __init__(self, trainer: Trainer, dead: str) -> None:
        self.trainer, self.dead, self.worlds = trainer, dead, []
        state = trainer.env.get_state()
        for w in range(WORLDS):
            env = make_vec(trainer.env.scenario, 1, autoreset_mode="Disabled")
            env.set_state(state[w])
            self.worlds.append(env)
        self.sums = [[0.0] * env.num_agents for env in self.worlds]  # of the discounted rewards of each agent
        self.all_sums: list[float] = []

    def values(self, env: Any) -> Any:
        with torch.no_grad():
            return self.trainer.policies[0](self.trainer.lane.packer(env.observe()))[1].numpy()

    def rollout(self, w: int, actions: Any) -> list[Row]:
        """A row for each step of world `w`: rewards, values, and what comes after, (agents,) each."""
        env, rows = self.worlds[w], []
        agents = env.worlds.span("agent")
        for t in range(STEPS):
            alive, values = env.worlds[Entity].alive[0, agents] != 0, self.values(env)
            _, rewards, terminated, truncated, _ = env.step(actions[t, w][None])
            goes_on = np.full(len(alive), not terminated[0])
            if self.dead == "drop":
                goes_on &= env.worlds[Entity].alive[0, agents] != 0
            row = {"alive": alive, "values": values, "rewards": rewards[0].copy(), "next": self.values(env) * goes_on}
            rows.append(row | {"chain": goes_on & (not truncated[0]), "cut off": bool(truncated[0])})
            for i, reward in enumerate(rewards[0]):
                self.sums[w][i] = float(reward) + GAMMA * self.sums[w][i]
                self.all_sums.append(self.sums[w][i])
                self.sums[w][i] *= bool(rows[-1]["chain"][i])
            if terminated[0] or truncated[0]:
                env.reset()
        return rows

    def deviation(self) -> float:
        """The standard deviation of the discounted sums so far, of all agents after each step."""
        mean = sum(self.all_sums) / len(self.all_sums)
        return math.sqrt(sum((each - mean) ** 2 for each in self.all_sums) / len(self.all_sums))


def advantages(rows: list[Row], divisor: float) -> list[Any]:
    """Generalized advantage estimates by their definition: discounted sums of the errors that follow."""
    found = []
    for t in range(len(rows)):
        total, weight = np.zeros(len(rows[0]["values"])), np.ones(len(rows[0]["values"]))
        for row in rows[t:]:
            total += weight * (row["rewards"] / divisor + GAMMA * row["next"] - row["values"])
            weight = weight * GAMMA * LAMBDA * row["chain"]
        found.append(total)
    return found


@pytest.mark.parametrize(("preset", "dead", "scaled"), [("original", "keep", False), ("scaled", "drop", True)])
def test_advantages_are_those_of_a_plain_loop(preset: str, dead: str, scaled: bool) -> None:
    trainer = make(preset, dead=dead, scale_rewards=scaled)
    plain = Plain(trainer, dead)
    for _ in range(2):  # the second rollout starts in the middle of episodes
        rollout, ends = trainer.collect(), 0
        actions = rollout.actions.reshape(STEPS, WORLDS, 4, -1)
        worlds = [plain.rollout(w, actions) for w in range(WORLDS)]
        divisor = plain.deviation() if scaled else 1
        for w, rows in enumerate(worlds):
            mine, alive = slice(w * 4, w * 4 + 4), np.array([row["alive"] for row in rows])
            kept = alive | (dead == "keep")
            assert np.array_equal(rollout.alive[:, mine], alive)
            assert np.array_equal(rollout.learner[:, mine], np.where(kept, 0, -1))
            values = np.array([row["values"] for row in rows])
            if trainer.policies[0].apart:
                values[~kept] = 0  # nobody learns from these
            np.testing.assert_allclose(rollout.values[:, mine], values, rtol=1e-4, atol=1e-4)
            expected = np.array(advantages(rows, divisor))
            np.testing.assert_allclose(rollout.advantages[:, mine][kept], expected[kept], rtol=1e-3, atol=1e-3)
            ends += sum(not row["chain"].any() for row in rows)
        np.testing.assert_allclose(rollout.returns, rollout.advantages + rollout.values, atol=1e-5)
        assert ends >= WORLDS
        assert any(row["cut off"] for rows in worlds for row in rows)
        assert (~rollout.alive).sum() > 20
    assert not scaled or abs(divisor - 1) > 0.5


@pytest.mark.parametrize("preset", ["original", "paper", "fast"])
def test_actions_have_the_probabilities_that_the_rollout_says(preset: str) -> None:
    trainer = make(preset)
    rollout = trainer.collect()
    assert (rollout.idle is None) == (preset != "fast")  # presets that copy the paper draw all actions
    some = torch.arange(0, rollout.alive.size, 3)
    with torch.no_grad():
        logs, values, _ = trainer.policies[0](rollout.seen[trainer.preset.form].select(some))
        actions = torch.from_numpy(rollout.actions.reshape(rollout.alive.size, -1))[some]
        free = None if rollout.idle is None else torch.from_numpy(~rollout.idle.reshape(rollout.alive.size, -1))[some]
        found = trainer.policies[0].choices.of(actions, logs, free)
    np.testing.assert_allclose(values, rollout.values.ravel()[some], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found, rollout.log_probs.ravel()[some], rtol=1e-4, atol=1e-4)


def test_older_sums_count_as_so_many_of_the_newest_at_most(monkeypatch) -> None:
    monkeypatch.setattr(RewardScale, "MEMORY", 2.0)
    rng, agents, steps = np.random.default_rng(0), 3, 5
    scale, running = RewardScale(agents, 0.9), [0.0] * agents
    weighted: list[tuple[float, float]] = []
    for k in range(6):
        rewards = rng.normal(k, 1 + k, (steps, agents)).astype(np.float32)
        ends, new = rng.random((steps, agents)) < 0.2, []
        for t in range(steps):
            for i in range(agents):
                running[i] = 0.9 * running[i] + float(rewards[t, i])
                new.append((1.0, running[i]))
                running[i] *= not ends[t, i]
        before = sum(weight for weight, _ in weighted)
        fade = min(1, 2 * len(new) / before) if before else 1
        weighted = [(weight * fade, value) for weight, value in weighted] + new
        total = sum(weight for weight, _ in weighted)
        mean = sum(weight * value for weight, value in weighted) / total
        variance = sum(weight * (value - mean) ** 2 for weight, value in weighted) / total
        assert scale.update(rewards, ends) == pytest.approx(math.sqrt(variance), rel=1e-9)


def test_rewards_without_a_spread_stay_as_they_are() -> None:
    scale, nothing, ends = RewardScale(2, 0.9), np.zeros((4, 2), np.float32), np.ones((4, 2), bool)
    first = scale.update(nothing, ends)
    scale.variance, scale.mean = 1e-300, 0.0
    assert not (nothing / np.float32(first)).any()
    assert not (nothing / np.float32(scale.update(nothing, ends))).any()
    scale = RewardScale(2, 0.0)
    assert scale.update(np.ones((8, 2), np.float32), np.zeros((8, 2), bool)) == 1  # then 18 ones and 2 zeros
    found = scale.update(np.eye(2, dtype=np.float32), np.zeros((2, 2), bool))
    assert found == pytest.approx(0.3)  # of 18 ones and 2 zeros


def test_an_end_by_the_rule_in_the_last_tick_is_not_cut_off() -> None:
    """Nothing comes after it, whatever the time limit says."""
    trainer = make(scenario=won_at_the_limit())
    trainer.collect()
    samples = trainer.lane.samples
    assert samples.ends.any()
    assert (samples.later == 0).all()


@pytest.mark.parametrize("options", [{}, {"memory": 8, "rollout": 6 * 48}, {"opponents": {"self": 1.0, "random": 1.0}}])
def test_idle_actions_are_noop_as_the_worlds_say(options: dict[str, Any], monkeypatch) -> None:
    """Compared with the masks of environments. Opponents, whose samples nobody learns from, draw as they like."""
    trainer, said = make("fast", **options), list[Any]()
    act, env = trainer.lane.act, trainer.env

    def watched(*given: Any) -> Any:
        allowed = np.split(env.action_masks(), np.cumsum(env.action_sizes)[:-1], 2)
        said.append(np.stack([each.sum(2) == 1 for each in allowed], 2))
        return act(*given)

    monkeypatch.setattr(trainer.lane, "act", watched)
    rollout = trainer.collect()
    idle = np.stack(said).reshape(rollout.actions.shape)
    assert rollout.idle is not None
    np.testing.assert_array_equal(rollout.idle, idle)
    learns = rollout.learner >= 0
    noop = np.broadcast_to(trainer.env.noop, idle.shape)
    assert (rollout.actions == noop)[idle & learns[..., None]].all()
    assert 0.05 < idle[learns].mean() < 0.95
    assert (rollout.actions != noop)[~idle & learns[..., None]].any()


@pytest.mark.parametrize(
    ("preset", "options", "close"),
    [  # close: of the parameters, in proportion to how far they move
        ("original", {}, 1e-5),
        ("paper", {}, 1e-12),
        ("paper", {"ent_coef": 0.01, "dead": "drop", "scenario": short("teams_3+steering")}, 1e-12),
        ("fast", {"ent_coef": 0.01, "n_epochs": 5, "batch_size": 200, "target_kl": 0.0}, 1e-12),  # with idle actions
        ("original", {"ent_coef": 1.0, "n_epochs": 5, "batch_size": 200}, 1e-12),
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


def parts_of(trainer: Trainer, monkeypatch) -> list[Any]:
    """The numbers of the samples of each minibatch, as updates go on."""
    parts, inner = list[Any](), trainer.learners[0]._differentiate

    def noted(*given: Any) -> Any:
        parts.append(given[1])
        return inner(*given)

    monkeypatch.setattr(trainer.learners[0], "_differentiate", noted)
    return parts


@pytest.mark.parametrize(
    "options", [{"preset": "fast"}, {"preset": "paper", "memory": 8, "rollout": 192}, {"critic": "state"}], ids=str
)
def test_results_do_not_depend_on_threads(options: dict[str, Any], monkeypatch) -> None:
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
def test_an_epoch_takes_every_sample_once(dead: str, monkeypatch) -> None:
    trainer = make(dead=dead, batch_size=100, n_epochs=2, target_kl=0.0)
    rollout, parts = trainer.collect(), parts_of(trainer, monkeypatch)
    trainer.update(rollout)
    expected = np.flatnonzero(rollout.alive | (dead == "keep"))
    first, second = (torch.cat(parts[k : k + len(parts) // 2]).numpy() for k in (0, len(parts) // 2))
    for drawn in (first, second):
        assert np.array_equal(np.sort(drawn), expected)
        assert not np.array_equal(drawn, expected)
    assert not np.array_equal(first, second)
    assert {len(part) // 10 for part in parts} <= {9, 10, 11}


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 7])
def test_few_samples_make_no_minibatch_of_one(count: int, monkeypatch) -> None:
    trainer = make("paper", batch_size=2, n_epochs=1)
    rollout, parts, before = trainer.collect(), parts_of(trainer, monkeypatch), weights(trainer.policies[0])
    owner = np.full(rollout.learner.shape, -1, np.int8)
    owner.ravel()[10 : 10 + count] = 0
    report = trainer.update(dataclasses.replace(rollout, learner=owner))
    assert bool(report) == bool(parts) == (count > 1) == (not torch.equal(before, weights(trainer.policies[0])))
    assert all(len(part) > 1 for part in parts)
    assert bool(weights(trainer.policies[0]).isfinite().all())


def test_rounding_is_no_variance_that_values_could_explain() -> None:
    trainer = make("fast")
    rollout = trainer.collect()
    values = np.linspace(-0.1, 0.1, rollout.values.size, dtype=np.float32).reshape(rollout.values.shape)
    for varies in (0.0, 1e-3):
        returns = np.float32(1 / 3) + np.float32(varies) * rollout.alive
        same = dataclasses.replace(rollout, values=values, advantages=returns - values)
        assert same.returns.var() > 0
        assert np.isnan(explained_variance(same, np.arange(values.size))) == (not varies)


TEXTS = "learning_rate=1e-4 anneal_lr=true batch_size=200 n_epochs=2 gamma=0.9 gae_lambda=0.5 clip_range=1e-3"
TEXTS += " ent_coef=0.01 vf_coef=0.1 max_grad_norm=0.01 target_kl=1e-6 scale_rewards=true"
OTHERS = dict(text.split("=") for text in TEXTS.split())


@functools.cache
def updated(**settings: Any) -> Any:
    """All parameters after one update with half of the run left, in a row."""
    trainer = make("paper", **settings)
    trainer.update(trainer.collect(), 0.5)
    return weights(trainer.policies[0])


@pytest.mark.parametrize("name", OTHERS)
def test_every_number_that_can_be_set_changes_an_update(name: str) -> None:
    changed, same = (presets.parse_hyperparameters([text]) for text in (f"{name}={OTHERS[name]}", "ent_coef=0"))
    assert torch.equal(updated(), updated(**same))
    assert not torch.equal(updated(), updated(**changed))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"device": "abacus"}, "device abacus does not exist here; take cpu"),
        ({"dead": "bury"}, "dead = 'bury': allowed are 'keep', 'drop'"),
        ({"worlds": 8, "rollout": 100}, "100 steps cannot be shared evenly by 8 worlds: .* such as --rollout 96"),
        ({"target_kl": None}, "target_kl = None: a finite number .* is needed"),
        ({"anneal_lr": 1}, "anneal_lr = 1: True or False is needed"),
        ({"vf_coef": True}, "vf_coef = True: a finite number .* is needed"),
        ("gamma=2", "gamma = 2.0: must be >= 0 and <= 1"),
        ("clip_range=nan", "clip_range = nan: a finite number .* is needed"),
        ("batch_size=1", "batch_size = 1: must be >= 2"),
        ("batch_size=64.5", "batch_size = 64.5: an integer .* is needed"),
        ("anneal_lr=perhaps", "anneal_lr = 'perhaps': True or False is needed"),
        ("normalise=1", "PPO has no hyperparameter 'normalise'; known: learning_rate, anneal_lr, batch_size"),
        ("gamma", "gamma = '': a finite number .* is needed"),
        ("gamma=0.9 gamma=0.99", "gamma is given twice"),
    ],
)
def test_what_cannot_be_is_refused(given: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make(**given) if isinstance(given, dict) else presets.parse_hyperparameters(given.split())


def test_numbers_of_ppo() -> None:
    parsed = presets.parse_hyperparameters(["batch_size=1e4", "n_epochs=3"])
    config = TrainingConfig(SHORT, steps=1e3, settings={"batch_size": 64.0})  # type: ignore[arg-type]
    found = parsed["batch_size"], parsed["n_epochs"], config.steps, config.numbers.batch_size
    assert found == (10_000, 3, 1000, 64)
    assert {type(number) for number in found} == {int}
    assert presets.KINDS.keys() == OTHERS.keys()
    assert TrainingConfig(SHORT, "original").numbers == Hyperparameters()
    assert torch.equal(updated(anneal_lr=True, learning_rate=2e-4), updated(learning_rate=1e-4))


@pytest.mark.nightly
def test_every_one_of_many_learners_is_trained() -> None:
    crowd = variant("ffa_2").replace(n_agents=140, spawn_grid_cells=20, n_heals=1)
    trainer = Trainer(TrainingConfig(crowd, worlds=1, rollout=16, policies="agent", steps=1), 1)
    before = [policy.actor.last.weight.clone() for policy in trainer.policies]
    rollout = trainer.collect()
    trainer.update(rollout)
    assert np.unique(rollout.learner).tolist() == [*range(140)]
    assert not any(torch.equal(policy.actor.last.weight, own) for policy, own in zip(trainer.policies, before))
