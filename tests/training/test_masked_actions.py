"""Actions that can change nothing are not drawn, have no entropy and get no gradient, but in the paper's presets."""

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base.presets import PRESETS  # noqa: E402
from outlast.training.policies.policy import MultiCategorical  # noqa: E402
from outlast.training.ppo.minibatches import Samples  # noqa: E402
from tests.helpers.trainers import make  # noqa: E402

SIZES = (3, 2, 4)


def test_presets_that_copy_the_paper_draw_all_actions() -> None:
    assert {name for name, preset in PRESETS.items() if preset.masked} == {"fast"}
    assert make("paper").collect().idle is None


@pytest.mark.parametrize(
    "options", [{}, {"memory": 8, "rollout": 6 * 48}, {"halves": True}, {"opponents": {"self": 1.0, "random": 1.0}}]
)
def test_idle_actions_are_noop_as_the_worlds_say(options: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Compared with the masks of environments. Opponents, whose samples nobody learns from, draw as they like."""
    trainer, said = make("fast", **options), list[Any]()
    for lane in trainer.collector.lanes:
        act = lane.act

        def watched(*given: Any, act: Any = act, env: Any = lane.env) -> Any:
            allowed = np.split(env.action_masks(), np.cumsum(env.action_sizes)[:-1], 2)
            said.append((env.first_world, np.stack([each.sum(2) == 1 for each in allowed], 2)))
            return act(*given)

        monkeypatch.setattr(lane, "act", watched)
    rollout = trainer.collect()
    firsts = sorted({first for first, _ in said})
    parts = [np.stack([each for own, each in said if own == first]) for first in firsts]
    idle = np.concatenate(parts, 1).reshape(rollout.actions.shape)
    assert rollout.idle is not None
    np.testing.assert_array_equal(rollout.idle, idle)
    learns = rollout.learner >= 0
    noop = np.broadcast_to(trainer.env.noop, idle.shape)
    assert (rollout.actions == noop)[idle & learns[..., None]].all()
    assert 0.05 < idle[learns].mean() < 0.95
    assert (rollout.actions != noop)[~idle & learns[..., None]].any()


def test_log_probabilities_are_of_what_was_drawn() -> None:
    trainer = make("fast")
    rollout = trainer.collect()
    (learner,) = trainer.learners
    batch = Samples(rollout, 0, learner.device).select(torch.arange(rollout.learner.size))
    assert batch is not None
    assert batch.free is not None
    with torch.no_grad():
        logs, _ = learner.policy.logs(batch.seen)
    chosen = logs.gather(0, batch.actions.T[None])[0].T
    torch.testing.assert_close(batch.old_log_probs, (chosen * batch.free).sum(1), rtol=1e-4, atol=1e-4)


def test_idle_actions_get_no_gradient() -> None:
    """Of a loss with all that learners take from logits: those of idle actions get 0."""
    choices, generator = MultiCategorical(SIZES), torch.Generator().manual_seed(0)
    free = torch.rand(40, len(SIZES), generator=generator) < 0.5
    actions = torch.stack([torch.randint(size, (40,), generator=generator) for size in SIZES], 1)
    inner = torch.randn(40, 5, generator=generator)
    head = torch.nn.Linear(5, sum(SIZES))
    logits = head(inner).detach()
    found = choices.log_probabilities(inner, head).detach().requires_grad_()
    (choices.of(actions, found, free).exp().sum() + choices.entropy(found, free).square().sum()).backward()
    assert found.grad is not None
    idle = ~free.T[None].expand_as(found)
    assert not found.grad[idle].any()
    assert found.grad[~idle].any()
    each = [torch.distributions.Categorical(logits=part) for part in logits.split(SIZES, 1)]
    entropy = torch.stack([one.entropy() for one in each], 1)
    torch.testing.assert_close(choices.entropy(found, free).detach(), (entropy * free).sum(1))
