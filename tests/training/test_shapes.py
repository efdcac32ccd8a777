"""What a GPU needs of shapes and tensors, checked on a CPU; what one computes is in test_gpu.py."""

import contextlib
from copy import deepcopy
from dataclasses import replace
from typing import Any

import pytest

from outlast import variant

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.policies import rows  # noqa: E402
from outlast.training.policies.rows import FILL, Rows  # noqa: E402
from outlast.training.ppo import cuda_graph  # noqa: E402
from outlast.training.ppo.adam import Adam  # noqa: E402
from outlast.training.ppo.learner import Learner  # noqa: E402
from outlast.training.ppo.minibatches import Chunks, Samples  # noqa: E402
from outlast.training.runs.run import Trainer  # noqa: E402
from tests.helpers.trainers import nearly  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
META = torch.device("meta")


def trainer(name: str = "teams_2", **changes: Any) -> Trainer:
    return Trainer(TrainingConfig(variant(name), "fast", worlds=16, rollout=16 * 32, **changes))


@pytest.fixture(scope="module")
def played() -> tuple[Trainer, Any]:
    """A trainer, and a rollout of it, which can be differentiated."""
    one = trainer()
    rollout = one.collect()
    everything = torch.arange(len(rollout.seen))
    return one, replace(rollout, seen=rollout.seen.select(everything))


def gradients(policy: Any, seen: Any) -> list[Any]:
    """Outputs and gradients of a loss, in float64, where no order of summation shows."""
    policy = deepcopy(policy).double()
    seen = Rows(seen.own.double(), seen.entities.double(), seen.count, seen.known, seen.room)
    logs, values, _ = policy(seen)
    policy.zero_grad()
    (logs.square().mean() + values.square().mean()).backward()
    return [logs, values, *(parameter.grad.clone() for parameter in policy.parameters())]


def test_rows_of_nobody_change_no_number(played: tuple[Trainer, Any]) -> None:
    policy, seen = played[0].policies[0], played[1].seen
    filled = seen.filled()
    assert (len(filled.entities) % FILL, len(filled.pairs[0]) % FILL) == (0, 0)
    assert len(filled.entities) > len(seen.entities)
    nearly(gradients(policy, filled), gradients(policy, seen))


@pytest.mark.parametrize("size", [1, 2, 100, 512])
def test_minibatches_of_filled_rows_are_those_of_others(played: tuple[Trainer, Any], size: int) -> None:
    policy, seen = played[0].policies[0], played[1].seen
    part = torch.randperm(len(seen), generator=torch.Generator().manual_seed(size))[:size]
    one, other = seen.filled().select(part), seen.select(part)
    assert (len(one.entities) % FILL, len(one.pairs[0]) % FILL) == (0, 0)
    assert torch.equal(one.entities[: len(other.entities)], other.entities)
    nearly(gradients(policy, one), gradients(policy, other))


def test_who_sees_nothing_plays_with_filled_rows(played: tuple[Trainer, Any]) -> None:
    policy, seen = played[0].policies[0], played[1].seen
    blind = Rows(seen.own[:3], seen.entities[:0], torch.zeros(3, dtype=torch.long))
    nearly(gradients(policy, blind.filled()), gradients(policy, blind))


def test_a_run_with_filled_rows_gives_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Updating as on a GPU, with opponents."""
    plain, other = (trainer(opponents={"self": 0.5, "past": 0.2, "scripted": 0.3}, snapshots=1) for _ in range(2))
    for _ in range(2):
        plain.update(plain.collect())
    monkeypatch.setattr(rows.Rows, "to", lambda seen, device: seen if seen.room is not None else seen.filled())
    for _ in range(2):
        other.update(other.collect())
    nearly(list(other.policies[0].parameters()), list(plain.policies[0].parameters()), 1e-5)


@pytest.mark.parametrize("changes", [{}, {"memory": 16}, {"policies": "agent"}], ids=str)
def test_a_copy_that_is_trained_elsewhere_gives_the_same_bits(changes: dict[str, Any]) -> None:
    plain, other = (trainer(**changes) for _ in range(2))
    for learner in other.learners:
        learner.trained = deepcopy(learner.policy)
        learner.parameters = list(learner.trained.parameters())
        learner.optimizer = Adam(learner.parameters)
    for _ in range(2):
        for one in (plain, other):
            one.update(one.collect())
    for one, two in zip(plain.policies, other.policies, strict=True):
        assert all(map(torch.equal, one.parameters(), two.parameters()))


class Recomputed:
    """What a CUDA graph does: the same again, from tensors that are there to tensors that are there."""

    def __init__(self, compute: Any, given: Any) -> None:
        self.compute, self.given, self.found = compute, given, compute(cuda_graph._copy(given))

    def replay(self) -> None:
        figures, gradients = self.compute(cuda_graph._copy(self.given))
        for kept, values in zip((self.found[0], *self.found[1]), (figures, *gradients), strict=True):
            kept.copy_(values)


@pytest.mark.parametrize("changes", [{}, {"memory": 16}, {"critic": "state"}], ids=str)
def test_graphs_read_the_minibatch_that_they_are_asked_for(
    changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    captured = []

    def capture(compute: Any, batch: Any, memory: Any) -> Any:
        captured.append(one := Recomputed(compute, given := cuda_graph._copy(batch)))
        return cuda_graph.Captured(one, cuda_graph._tensors(given), one.found)

    monkeypatch.setattr(cuda_graph, "_capture", capture)
    monkeypatch.setattr(torch.cuda, "graph_pool_handle", lambda: None)
    monkeypatch.setattr(torch.cuda, "device", contextlib.nullcontext)
    one = trainer(**changes)
    learner, rollout = one.learners[0], one.collect()
    samples = (Chunks if learner.policy.memory else Samples)(rollout, 0, torch.device("cpu"))
    samples.seen = samples.seen.filled()
    graphed = cuda_graph.GraphedGradients(torch.device("cpu"))
    parts = torch.randperm(len(samples.units), generator=torch.Generator().manual_seed(0)).tensor_split(4)
    for k in range(3):
        for part in parts:
            figures, gradients = graphed(learner._gradients, batch := samples.select(part))
            expected = learner._gradients(batch)
            nearly([figures, *gradients], [expected[0], *expected[1]])
        assert k or len(captured) < len(parts)  # not at the first time
    assert len(captured) == len(graphed.graphs)


def test_no_tensor_is_on_the_wrong_device_and_none_is_waited_for(played: tuple[Trainer, Any]) -> None:
    """A minibatch and its gradients on the device without numbers: asking for one fails there, and so does mixing."""
    one, rollout = played
    learner = Learner(deepcopy(one.policies[0]), one.learners[0].numbers, torch.Generator(), device=META)
    samples, shapes = Samples(rollout, 0, META), set()
    for part in torch.randperm(rollout.learner.size).tensor_split(4):
        seen = samples.seen.select(part)
        shapes.add((len(seen.entities), len(seen.pairs[0])))
        figures = learner._differentiate(samples, part, map)
        assert {parameter.grad.device for parameter in learner.parameters} == {figures.device} == {META}
        torch.nn.utils.clip_grad_norm_(learner.parameters, 0.5)
    assert all(size % FILL == 0 for shape in shapes for size in shape)
