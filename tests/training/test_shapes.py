"""What a GPU needs, on a CPU: shapes that repeat give the same numbers, and no tensor is on the wrong device."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from outlast import variant

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training import rows  # noqa: E402
from outlast.training.config import TrainingConfig  # noqa: E402
from outlast.training.learner import Learner  # noqa: E402
from outlast.training.minibatches import Samples  # noqa: E402
from outlast.training.rows import FILL, Rows, concatenated  # noqa: E402
from outlast.training.run import Trainer  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
needs_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
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


def nearly(one: list[Any], other: list[Any], tolerance: float = 1e-6) -> None:
    for value, expected in zip(one, other, strict=True):
        torch.testing.assert_close(value.detach().cpu(), expected.detach().cpu(), rtol=tolerance, atol=tolerance)


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


def test_filled_rows_are_joined_without_those_of_nobody(played: tuple[Trainer, Any]) -> None:
    seen = played[1].seen
    parts = [seen.select(part) for part in torch.arange(len(seen)).tensor_split(5)]
    joined = concatenated([part.filled() for part in parts])
    assert isinstance(joined, Rows)
    assert torch.equal(joined.entities[: len(seen.entities)], seen.entities)
    assert torch.equal(joined.count, seen.count)
    assert joined.room is not None


def test_who_sees_nothing_plays_with_filled_rows(played: tuple[Trainer, Any]) -> None:
    policy, seen = played[0].policies[0], played[1].seen
    blind = Rows(seen.own[:3], seen.entities[:0], torch.zeros(3, dtype=torch.long))
    nearly(gradients(policy, blind.filled()), gradients(policy, blind))


def test_a_run_with_filled_rows_gives_the_same_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Collecting and updating as on a GPU, with opponents."""
    plain, other = (trainer(opponents={"self": 0.5, "past": 0.2, "scripted": 0.3}, snapshots=1) for _ in range(2))
    for _ in range(2):
        plain.update(plain.collect())
    monkeypatch.setattr(rows.Rows, "to", lambda seen, device: seen if seen.room is not None else seen.filled())
    for _ in range(2):
        other.update(other.collect())
    nearly(list(other.policies[0].parameters()), list(plain.policies[0].parameters()), 1e-5)


def test_no_tensor_is_on_the_wrong_device_and_none_is_waited_for(played: tuple[Trainer, Any]) -> None:
    """A minibatch and its gradients on the device without numbers: asking for one fails there, and so does mixing."""
    one, rollout = played
    learner = Learner(deepcopy(one.policies[0]), one.learners[0].numbers, torch.Generator())
    learner.policy.to(META)
    learner.parameters, learner.device = list(learner.policy.parameters()), META
    samples, shapes = Samples(rollout, 0, META), set()
    for part in torch.randperm(rollout.learner.size).tensor_split(4):
        seen = samples.seen.select(part)
        shapes.add((len(seen.entities), len(seen.pairs[0])))
        figures = learner._differentiate(samples, part)
        assert {parameter.grad.device for parameter in learner.parameters} == {figures.device} == {META}
        torch.nn.utils.clip_grad_norm_(learner.parameters, 0.5)
    assert all(size % FILL == 0 for shape in shapes for size in shape)


@needs_gpu
@pytest.mark.parametrize("preset", ["fast", "original"])
def test_a_gpu_gives_nearly_the_same_numbers(preset: str) -> None:
    configs = (
        TrainingConfig(variant("ffa_2"), preset, worlds=16, rollout=512, device=name) for name in ("cpu", "cuda")
    )
    plain, gpu = (Trainer(config) for config in configs)
    one, other = plain.collect(), gpu.collect()
    np.testing.assert_allclose(other.values, one.values, rtol=1e-3, atol=1e-4)
    plain.update(one)
    gpu.update(other)
    nearly(list(gpu.policies[0].parameters()), list(plain.policies[0].parameters()), 1e-3)


@needs_gpu
def test_nothing_waits_for_a_gpu_in_an_update() -> None:
    gpu = Trainer(TrainingConfig(variant("ffa_2"), "fast", worlds=16, rollout=512, device="cuda"))
    rollout = gpu.collect()
    gpu.update(rollout)
    torch.cuda.set_sync_debug_mode("error")
    try:
        samples_of_an_update(gpu, rollout)
    finally:
        torch.cuda.set_sync_debug_mode("default")


def samples_of_an_update(gpu: Trainer, rollout: Any) -> None:
    """The minibatches of an update, without what is read at its end."""
    learner = gpu.learners[0]
    samples = Samples(rollout, 0, learner.device)
    for part in torch.arange(rollout.learner.size).tensor_split(2):
        learner._differentiate(samples, part)
        torch.nn.utils.clip_grad_norm_(learner.parameters, 0.5)
        learner.optimizer.step()
