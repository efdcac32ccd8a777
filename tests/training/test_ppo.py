"""Collecting and updating: advantages against a plain loop over a second batch of worlds, and the minibatches."""

import functools
from typing import Any

import numpy as np
import pytest

from outlast import make_vec
from outlast.ecs import Entity
from tests.helpers.execution_modes import short

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[train]")

from stable_baselines3.common.logger import Logger  # noqa: E402

from outlast.training import hyperparameters  # noqa: E402
from outlast.training.ppo import SharedPPO  # noqa: E402
from outlast.training.presets import preset  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
WORLDS, STEPS = 6, 40  # steps of each world in a rollout
SHORT = short("teams_3").replace(ending_limit=22)  # ends both ways, early
GAMMA, LAMBDA = 0.99, 0.95


def make(dead: str = "keep", seed: int = 5, **options: Any) -> SharedPPO:
    size = {"worlds": WORLDS, "steps": WORLDS * STEPS, "batch_size": 96}
    model = SharedPPO(SHORT, preset("original"), seed=seed, dead=dead, **(size | options))
    model.set_logger(Logger(None, []))
    model._update_current_progress_remaining(0, 1)
    return model


class Plain:
    """The same worlds, stepped one by one in plain Python with the actions of a rollout."""

    def __init__(self, model: SharedPPO) -> None:
        self.model, self.layout = model, model.rollout_buffer.layout
        self.worlds = []
        model.start()
        state = model.base_env.get_state()
        for w in range(WORLDS):
            env = make_vec(model.base_env.scenario, 1, autoreset_mode="Disabled")
            env.set_state(state[w])
            self.worlds.append(env)

    def values(self, env: Any) -> Any:
        packed = np.zeros((1, env.num_agents, self.layout.size), np.float32)
        env.observe(out=self.layout.views(packed))
        with torch.no_grad():
            return self.model.policy.predict_values(torch.from_numpy(packed[0])).numpy()

    def rollout(self, w: int, dead: str) -> list[dict[str, Any]]:
        """A row for each step of world `w`: rewards, values, and what comes after, (agents,) each."""
        env, rows = self.worlds[w], []
        actions = self.model.rollout_buffer.actions.reshape(STEPS, WORLDS, env.num_agents, -1)
        agents = env.worlds.span("agent")
        for t in range(STEPS):
            alive, values = env.worlds[Entity].alive[0, agents] != 0, self.values(env)
            _, rewards, terminated, truncated, _ = env.step(actions[t, w][None])
            after = env.worlds[Entity].alive[0, agents] != 0
            goes_on = np.full(len(alive), not terminated[0])
            if dead == "drop":
                goes_on &= after
            rows.append(
                {"alive": alive, "values": values, "rewards": rewards[0].copy(), "next": self.values(env) * goes_on}
            )
            rows[-1]["chain"] = goes_on & (not truncated[0])
            if terminated[0] or truncated[0]:
                env.reset()
        return rows


def advantages(rows: list[dict[str, Any]]) -> list[Any]:
    """Generalized advantage estimates by their definition: discounted sums of the errors that follow."""
    found = []
    for t in range(len(rows)):
        total, weight = np.zeros(len(rows[0]["values"])), np.ones(len(rows[0]["values"]))
        for row in rows[t:]:
            total += weight * (row["rewards"] + GAMMA * row["next"] - row["values"])
            weight = weight * GAMMA * LAMBDA * row["chain"]
        found.append(total)
    return found


@pytest.mark.parametrize("dead", ["keep", "drop"])
def test_advantages_are_those_of_a_plain_loop(dead: str) -> None:
    model = make(dead)
    plain = Plain(model)
    for _ in range(2):  # the second rollout starts in the middle of episodes
        model.collect()
        buffer, ends = model.rollout_buffer, 0
        for w in range(WORLDS):
            rows = plain.rollout(w, dead)
            mine = slice(w * 4, w * 4 + 4)
            kept = np.array([row["alive"] for row in rows]) | (dead == "keep")
            assert np.array_equal(buffer.alive[:, mine], np.array([row["alive"] for row in rows]))
            np.testing.assert_allclose(buffer.values[:, mine], [row["values"] for row in rows], rtol=1e-4, atol=1e-4)
            expected = np.array(advantages(rows))
            np.testing.assert_allclose(buffer.advantages[:, mine][kept], expected[kept], rtol=1e-3, atol=1e-3)
            ends += sum(not row["chain"].any() for row in rows)
        returns = buffer.advantages + buffer.values
        np.testing.assert_allclose(buffer.returns, returns, atol=1e-5)
        assert ends >= WORLDS
        assert (~buffer.alive).sum() > 20


@pytest.mark.parametrize("dead", ["keep", "drop"])
def test_an_epoch_takes_every_sample_once(dead: str) -> None:
    model = make(dead)
    model.collect()
    buffer = model.rollout_buffer
    count = buffer.alive.sum() if dead == "drop" else buffer.alive.size
    buffer.advantages[:] = np.arange(buffer.alive.size).reshape(buffer.alive.shape)
    parts = list(buffer.get(100))
    drawn = torch.cat([part.advantages for part in parts]).long().numpy()
    assert len(drawn) == len(set(drawn)) == count
    assert dead == "keep" or buffer.alive.ravel()[drawn].all()
    assert {len(part.advantages) // 10 for part in parts} <= {9, 10, 11}
    first = parts[0]
    packed = buffer.observations[:-1].reshape(-1, buffer.layout.size)[drawn[: len(first.actions)]]
    assert np.array_equal(first.observations.numpy(), packed)
    assert not np.array_equal(drawn, np.sort(drawn))


def test_actions_have_the_probabilities_that_the_buffer_says() -> None:
    model = make()
    model.collect()
    part = next(iter(model.rollout_buffer.get(10_000)))
    values, logs, _ = model.policy.evaluate_actions(part.observations, part.actions)
    torch.testing.assert_close(values, part.old_values, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(logs, part.old_log_prob, rtol=1e-4, atol=1e-4)


def test_the_divergence_ends_an_update() -> None:
    strict, lax = make(batch_size=64, n_epochs=3, target_kl=1e-9), make(batch_size=64, n_epochs=3, target_kl=None)
    for model in (strict, lax):
        model.collect()
        model.train()
    epochs = [model.logger.name_to_value["train/epochs"] for model in (strict, lax)]
    assert epochs[0] < 0.2
    assert epochs[1] == pytest.approx(3)


# What each number is changed to, beside the base: small ones, so that an update is quick.
BASE = {"batch_size": 96, "n_epochs": 3}
OTHERS = {
    "learning_rate": 1e-4,
    "batch_size": 200,
    "n_epochs": 2,
    "gamma": 0.9,
    "gae_lambda": 0.5,
    "clip_range": 1e-3,
    "ent_coef": 0.01,
    "vf_coef": 0.1,
    "max_grad_norm": 0.01,
    "target_kl": 1e-6,
}


@functools.cache
def updated(**settings: Any) -> Any:
    """All parameters after one update, in a row."""
    model = make(**(BASE | settings))
    model.collect()
    model.train()
    return torch.nn.utils.parameters_to_vector(model.policy.parameters()).detach()


@pytest.mark.parametrize("name", hyperparameters.PAPER)
def test_every_number_that_can_be_set_changes_an_update(name: str) -> None:
    assert not torch.equal(updated(), updated(**hyperparameters.parse_hyperparameters([f"{name}={OTHERS[name]}"])))


def test_a_number_that_stays_as_it_is_changes_nothing() -> None:
    """So that what the test above sees is the number's doing."""
    assert torch.equal(updated(), updated(**hyperparameters.parse_hyperparameters(["ent_coef=0"])))


def plainly(policy: Any) -> Any:
    """evaluate_actions as Stable-Baselines3 has it: a torch.distributions.Categorical of each action's own logits."""

    def evaluate(packed: Any, actions: Any) -> tuple[Any, Any, Any]:
        known = [extractor(packed) for extractor in policy.extractors]
        logits = policy.actor(known[0]).split(sizes, 1)
        each = [torch.distributions.Categorical(logits=part) for part in logits]
        logs = sum(one.log_prob(actions[:, k]) for k, one in enumerate(each))
        return policy.critic(known[-1]), logs, sum(one.entropy() for one in each)

    sizes = [int((policy.choices.never.view(policy.choices.count, -1)[k] == 0).sum()) for k in range(6)]
    return evaluate


@pytest.mark.parametrize("coefficient", [0.0, 0.01, 1.0])
@pytest.mark.parametrize("ablation", ["", "+steering"])
def test_an_update_is_that_of_stable_baselines(coefficient: float, ablation: str, monkeypatch: Any) -> None:
    """With entropies and their gradients by PyTorch's own distributions, also of actions of different sizes."""
    scenario, after = short(f"teams_3{ablation}").replace(ending_limit=22), []
    monkeypatch.setattr("tests.training.test_ppo.SHORT", scenario)
    for plain in (False, True):
        model = make(batch_size=480, n_epochs=1, ent_coef=coefficient, target_kl=None, learning_rate=1e-3)
        if plain:
            monkeypatch.setattr(model.policy, "evaluate_actions", plainly(model.policy))
        model.collect()
        model.train()
        after.append(torch.nn.utils.parameters_to_vector(model.policy.parameters()).detach())
        after.append(model.logger.name_to_value["train/entropy_loss"])
    torch.testing.assert_close(after[0], after[2], rtol=0, atol=1e-5)
    assert after[1] == pytest.approx(after[3], rel=1e-5)


def test_a_seed_decides_everything() -> None:
    def trained(seed: int) -> tuple[Any, Any]:
        model = make(seed=seed, n_epochs=2)
        for _ in range(2):
            model.collect()
            model.train()
        return model.rollout_buffer.rewards.copy(), model.policy.critic.last.weight.detach().clone()

    (rewards, weight), (again, same), (other, _) = trained(5), trained(5), trained(6)
    assert np.array_equal(rewards, again)
    assert torch.equal(weight, same)
    assert not np.array_equal(rewards, other)


def test_stable_baselines_own_loop_runs_it() -> None:
    model = make(n_epochs=1)
    model.learn(3 * WORLDS * STEPS * 4)
    assert model.num_timesteps == 3 * WORLDS * STEPS * 4


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
def test_a_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match="there is no cuda here; take cpu"):
        make(device="cuda")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dead": "bury"}, "dead = 'bury': allowed are 'keep', 'drop'"),
        ({"steps": 100}, "of 100 steps cannot be shared"),
        ({"gamma": 2}, "gamma=2: a finite number from 0 to 1 is needed"),
    ],
)
def test_what_cannot_be_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SharedPPO(SHORT, preset("paper"), **({"worlds": 8} | options))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gamma=2", "gamma=2.0: a finite number from 0 to 1 is needed"),
        ("gae_lambda=-0.1", "gae_lambda=-0.1: a finite number from 0 to 1 is needed"),
        ("learning_rate=0", "learning_rate=0.0: a finite number above 0 is needed"),
        ("clip_range=nan", "clip_range=nan: a finite number above 0 is needed"),
        ("target_kl=inf", "target_kl=inf: a finite number above 0 is needed"),
        ("ent_coef=-1", "ent_coef=-1.0: a finite number of at least 0 is needed"),
        ("vf_coef=-1", "vf_coef=-1.0: a finite number of at least 0 is needed"),
        ("batch_size=1", "batch_size=1: a finite number of at least 2 is needed"),
        ("n_epochs=0", "n_epochs=0: a finite number of at least 1 is needed"),
        ("max_grad_norm=0", "max_grad_norm=0.0: a finite number above 0 is needed"),
        ("n_epochs=many", "n_epochs=many: a number like 400 is needed"),
        ("normalise=1", "PPO has no number 'normalise'; it has: learning_rate, batch_size"),
    ],
)
def test_numbers_of_ppo_that_cannot_be_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        hyperparameters.parse_hyperparameters([text])


def test_every_number_has_a_range_in_which_the_papers_is() -> None:
    assert hyperparameters.RANGES.keys() == hyperparameters.PAPER.keys() == OTHERS.keys()
    hyperparameters.check_ranges(hyperparameters.PAPER)
