"""PPO's functions of tensors against plain forms, PyTorch's distributions and Stable-Baselines3's buffer."""

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base.hyperparameters import Hyperparameters  # noqa: E402
from outlast.training.policies.policy import MultiCategorical  # noqa: E402
from outlast.training.ppo.loss import advantages, evaluated, ppo_loss  # noqa: E402
from outlast.training.ppo.minibatches import Batch, normalised  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def test_advantages_are_those_of_stable_baselines() -> None:
    buffers = pytest.importorskip("stable_baselines3.common.buffers", reason="needs stable_baselines3: outlast[sb3]")
    from gymnasium import spaces

    rng, steps, agents = np.random.default_rng(0), 30, 7
    rewards, values = (rng.normal(size=(steps, agents)).astype(np.float32) for _ in range(2))
    ends, last = rng.random((steps, agents)) < 0.2, rng.normal(size=agents).astype(np.float32)
    buffer = buffers.RolloutBuffer(
        steps, spaces.Box(-1, 1, (1,)), spaces.Discrete(2), "cpu", gae_lambda=0.9, gamma=0.97, n_envs=agents
    )
    buffer.rewards, buffer.values = rewards, values
    buffer.episode_starts[1:] = ends[:-1]
    buffer.compute_returns_and_advantage(torch.from_numpy(last), ends[-1])
    found = advantages(rewards, values, ends, last, 0.97, 0.9)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, buffer.advantages, rtol=1e-5, atol=1e-5)


def samples(count: int) -> dict[str, Any]:
    """What a loss is computed from, in float64, with ratios on both sides of the clip."""
    generator = torch.Generator().manual_seed(1)
    names = ("log_probs", "values", "entropy", "old_log_probs", "advantages", "returns")
    return {name: torch.randn(count, generator=generator, dtype=torch.float64) / 3 for name in names}


class Given:
    """Takes log probabilities and entropies as they are given, for a network and for its distributions."""

    of = staticmethod(lambda actions, logs, free: logs[0])
    entropy = staticmethod(lambda logs, free: logs[1])

    @property
    def choices(self) -> "Given":
        return self


def loss_of(given: dict[str, Any], weights: Any) -> tuple[Any, dict[str, Any]]:
    """The loss and its figures."""
    rest: dict[str, Any] = {name: given[name] for name in ("values", "old_log_probs", "returns")}
    rest |= dict.fromkeys(("seen", "actions", "old_values"))  # which PPO's loss does not read
    rest |= {"network": Given(), "numbers": Hyperparameters(ent_coef=0.1)}
    rest |= {"advantages": normalised(given["advantages"], weights), "weights": weights}
    return evaluated(ppo_loss, Batch(**rest, logs=torch.stack([given["log_probs"], given["entropy"]])))


def test_the_loss_is_that_of_a_loop_over_samples() -> None:
    given, count = samples(40), 40
    given["log_probs"].requires_grad_()
    _, found = loss_of(given, torch.full((count,), 1 / count, dtype=torch.float64))
    rows = {name: values.tolist() for name, values in given.items()}
    mean = sum(rows["advantages"]) / count
    spread = (sum((each - mean) ** 2 for each in rows["advantages"]) / (count - 1)) ** 0.5
    ratios = [np.exp(new - old) for new, old in zip(rows["log_probs"], rows["old_log_probs"], strict=True)]
    gains = [
        min(ratio * (each - mean) / spread, min(max(ratio, 0.8), 1.2) * (each - mean) / spread)
        for ratio, each in zip(ratios, rows["advantages"], strict=True)
    ]
    value = sum((a - b) ** 2 for a, b in zip(rows["returns"], rows["values"], strict=True)) / count
    policy, entropy = -sum(gains) / count, sum(rows["entropy"]) / count
    divergence = sum(ratio - 1 - np.log(ratio) for ratio in ratios) / count
    clipped = sum(abs(ratio - 1) > 0.2 for ratio in ratios) / count
    expected = {"loss": policy + 0.5 * value - 0.1 * entropy, "policy_loss": policy, "value_loss": value}
    expected |= {"entropy": entropy, "approx_kl": divergence, "clip_fraction": clipped}
    assert {name: float(figure) for name, figure in found.items()} == pytest.approx(expected, rel=1e-6)
    assert 0.2 < clipped < 0.8


def test_samples_that_are_masked_are_as_if_they_were_not_there() -> None:
    """Whatever they hold, in the loss and its gradients."""
    given = samples(40)
    counts = torch.arange(40) % 3 > 0
    whole = {name: values.clone() for name, values in given.items()}
    for values in whole.values():
        values[~counts] = 7.0
    some = {name: values[counts] for name, values in given.items()}
    gradients = []
    for each, weights in ((whole, counts / counts.sum().double()), (some, torch.full((26,), 1 / 26).double())):
        each["log_probs"].requires_grad_()
        loss, figures = loss_of(each, weights)
        loss.backward()
        gradients.append((figures, each["log_probs"].grad))
    torch.testing.assert_close(gradients[0][0], gradients[1][0], rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(gradients[0][1][counts], gradients[1][1], rtol=1e-6, atol=1e-9)
    assert not gradients[0][1][~counts].any()


def test_the_entropy_and_its_gradient_are_those_of_pytorchs_distributions() -> None:
    sizes = (3, 2, 4, 1)
    choices, head = MultiCategorical(sizes), torch.nn.Linear(5, sum(sizes)).double()
    features, actions = (
        torch.randn(9, 5, dtype=torch.float64),
        torch.tensor([[2, 1, 3, 0], [0, 0, 1, 0], [1, 1, 0, 0]] * 3),
    )
    found = []
    for plain in (False, True):
        head.zero_grad()
        if plain:
            each = [torch.distributions.Categorical(logits=part) for part in head(features).split(sizes, 1)]
            entropy = sum(one.entropy() for one in each)
            logs = sum(one.log_prob(actions[:, k]) for k, one in enumerate(each))
        else:
            all_logs = choices.log_probabilities(features, head)
            entropy, logs = choices.entropy(all_logs), choices.of(actions, all_logs)
        (entropy.sum() + logs.square().sum()).backward()
        found.append((entropy.detach(), logs.detach(), head.weight.grad.clone()))
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)
