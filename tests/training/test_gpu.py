"""Training on a GPU, where there is one: the numbers of a CPU. And what it needs of shapes, checked on a CPU."""

import contextlib
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from outlast import variant
from outlast.envs.rollout.saved import checkpoints
from outlast.training.base.config import TrainingConfig
from outlast.training.policies.player import Player
from outlast.training.policies.rows import FILL, Rows
from outlast.training.ppo import learner as learning
from outlast.training.ppo.learner import Adam, Learner
from outlast.training.ppo.minibatches import Samples
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs.run import TrainingRun
from tests.helpers.trainers import nearly

OPTIONS: list[dict[str, Any]] = [{}, {"preset": "original"}, {"preset": "paper"}, {"memory": 16}, {"critic": "state"}]
OPTIONS += [{"policies": "side"}, {"dead": "drop"}, {"warm_start": "scripted:1000"}]
OPTIONS += [{"opponents": {"self": 0.4, "past": 0.3, "scripted": 0.3}, "snapshots": 1}]
EACH = 16 * 32  # steps of a rollout
on_gpu = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")
some_options = pytest.mark.parametrize("changes", [{}, {"memory": 16}, {"critic": "state"}], ids=str)


def config(device: str, *, preset: str = "fast", settings: dict[str, Any] | None = None, **changes: Any) -> Any:
    given = changes | {"settings": {"batch_size": 256} | (settings or {})}
    return TrainingConfig(variant("ffa_2"), preset, worlds=16, rollout=EACH, device=device, **given)


def parameters(trainer: Trainer) -> list[Any]:
    return [each for policy in trainer.policies for each in policy.parameters()]


@on_gpu
@pytest.mark.parametrize("changes", OPTIONS, ids=str)
def test_the_numbers_are_those_of_a_cpu(changes: dict[str, Any]) -> None:
    plain, gpu = (Trainer(config(device, **changes)) for device in ("cpu", "cuda"))
    for trainer in (plain, gpu):
        trainer.imitate(lambda done, tags: None)
    one, other = plain.collect(), gpu.collect()
    np.testing.assert_allclose(other.values, one.values, rtol=1e-3, atol=1e-3)
    first = [each.clone() for each in parameters(gpu)]
    logged, expected = gpu.update(other), plain.update(one)
    assert logged["train/loss"] == pytest.approx(expected["train/loss"], rel=1e-2, abs=1e-2)
    nearly(parameters(gpu), parameters(plain), 2e-3)
    assert all(each.device.type == "cpu" for each in parameters(gpu))
    assert not all(torch.equal(*pair) for pair in zip(first, parameters(gpu), strict=True))


@on_gpu
@pytest.mark.parametrize("devices", [("cuda", "cpu"), ("cpu", "cuda")], ids="-".join)
def test_a_run_goes_on_on_another_device(devices: tuple[str, str], tmp_path: Path) -> None:
    for k, device in enumerate(devices):
        run = config(device, memory=16, settings={"anneal_lr": False}, steps=2 * EACH * (k + 1))
        TrainingRun(run, tmp_path / "run", resume=k > 0).train()
    last = Player(str(checkpoints(tmp_path / "run")[-1]))
    whole = Trainer(config("cpu", memory=16, settings={"anneal_lr": False}))
    for _ in devices:
        whole.update(whole.collect())
    nearly([each for policy in last.policies for each in policy.parameters()], parameters(whole), 1e-2)


@on_gpu
def test_a_saved_policy_plays_against_learners_on_a_gpu(tmp_path: Path) -> None:
    TrainingRun(replace(config("cuda"), steps=2 * EACH), tmp_path / "run").train()
    saved = str(checkpoints(tmp_path / "run")[-1])
    gpu, plain = (Trainer(config(device, opponents={saved: 1.0})) for device in ("cuda", "cpu"))
    for trainer in (gpu, plain):
        trainer.update(trainer.collect())
    nearly(parameters(gpu), parameters(plain), 2e-3)


META = torch.device("meta")


def trainer(**changes: Any) -> Trainer:
    return Trainer(TrainingConfig(variant("teams_2"), "fast", worlds=16, rollout=EACH, **changes))


@pytest.fixture(scope="module")
def played() -> tuple[Trainer, Any]:
    """A trainer, and a rollout of it, which can be differentiated."""
    one = trainer()
    rollout = one.collect()
    ((form, seen),) = rollout.seen.items()
    return one, replace(rollout, seen={form: seen.select(torch.arange(len(seen)))})


def gradients(policy: Any, seen: Any) -> list[Any]:
    """Outputs and gradients of a loss, in float64, where no order of summation shows."""
    policy = deepcopy(policy).double()
    seen = Rows(seen.own.double(), seen.entities.double(), seen.count, seen.known, seen.room)
    logs, values, _ = policy(seen)
    policy.zero_grad()
    (logs.square().mean() + values.square().mean()).backward()
    return [logs, values, *(parameter.grad.clone() for parameter in policy.parameters())]


@pytest.mark.parametrize("size", [1, 100, 512])
def test_minibatches_of_filled_rows_are_those_of_others(played: tuple[Trainer, Any], size: int) -> None:
    policy, (seen,) = played[0].policies[0], played[1].seen.values()
    blind = Rows(seen.own, seen.entities[:0], torch.zeros(len(seen), dtype=torch.long))
    part = torch.randperm(len(seen), generator=torch.Generator().manual_seed(size))[:size]
    for rows in (seen, blind):
        one, other = rows.filled().select(part), rows.select(part)
        assert (len(one.entities) % FILL, len(one.pairs[0]) % FILL) == (0, 0)
        assert torch.equal(one.entities[: len(other.entities)], other.entities)
        nearly(gradients(policy, one), gradients(policy, other))


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
        self.compute, self.given, self.found = compute, given, compute(learning._copy(given))

    def replay(self) -> None:
        figures, gradients = self.compute(learning._copy(self.given))
        for kept, values in zip((self.found[0], *self.found[1]), (figures, *gradients), strict=True):
            kept.copy_(values)


@some_options
def test_graphs_read_the_minibatch_that_they_are_asked_for(changes: dict[str, Any], monkeypatch) -> None:
    captured = []

    def capture(compute: Any, batch: Any, memory: Any) -> Any:
        captured.append(one := Recomputed(compute, given := learning._copy(batch)))
        return learning.Captured(one, learning._batch_tensors(given), one.found)

    monkeypatch.setattr(learning, "_capture", capture)
    monkeypatch.setattr(torch.cuda, "graph_pool_handle", lambda: None)
    monkeypatch.setattr(torch.cuda, "device", contextlib.nullcontext)
    one = trainer(**changes)
    learner, rollout = one.learners[0], one.collect()
    samples = Samples(rollout, 0, learner.policy, torch.device("cpu"))
    samples.seen = samples.seen.filled()
    graphed = learning.GraphedGradients(torch.device("cpu"))
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
    samples, shapes = Samples(rollout, 0, learner.policy, META), set()
    for part in torch.randperm(rollout.learner.size).tensor_split(4):
        seen = samples.seen.select(part)
        shapes.add((len(seen.entities), len(seen.pairs[0])))
        figures = learner._differentiate(samples, part, map)
        assert {parameter.grad.device for parameter in learner.parameters} == {figures.device} == {META}
        torch.nn.utils.clip_grad_norm_(learner.parameters, 0.5)
    assert all(size % FILL == 0 for shape in shapes for size in shape)
