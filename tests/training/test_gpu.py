"""Training on a GPU, where there is one: the numbers of a CPU but for rounding."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.envs.rollout.saved import checkpoints  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.policies.player import Player  # noqa: E402
from outlast.training.ppo.cuda_graph import GraphedGradients  # noqa: E402
from outlast.training.ppo.minibatches import Chunks, Samples  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs.run import TrainingRun  # noqa: E402
from tests.helpers.trainers import nearly  # noqa: E402

pytestmark = [
    pytest.mark.usefixtures("one_torch_thread"),
    pytest.mark.filterwarnings("ignore:Synchronization debug mode is a prototype"),
    pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU"),
]
OPTIONS: dict[str, dict[str, Any]] = {
    "fast": {},
    "original": {"preset": "original"},
    "paper": {"preset": "paper"},
    "memory": {"memory": 16},
    "state": {"critic": "state"},
    "sides": {"policies": "side"},
    "drop": {"dead": "drop"},
    "opponents": {"opponents": {"self": 0.4, "past": 0.3, "scripted": 0.3}, "snapshots": 1},
    "imitation": {"warm_start": "scripted:1000"},
}
EACH = 16 * 32  # steps of a rollout
some_options = pytest.mark.parametrize("changes", [{}, {"memory": 16}, {"critic": "state"}], ids=str)


def config(device: str, *, preset: str = "fast", settings: dict[str, Any] | None = None, **changes: Any) -> Any:
    settings = {"batch_size": 256} | (settings or {})
    return TrainingConfig(
        variant("ffa_2"), preset, worlds=16, rollout=EACH, device=device, settings=settings, **changes
    )


def parameters(trainer: Trainer) -> list[Any]:
    return [each for policy in trainer.policies for each in policy.parameters()]


@pytest.mark.parametrize("changes", OPTIONS.values(), ids=OPTIONS)
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


@some_options
def test_graphs_give_the_gradients_of_single_kernels(changes: dict[str, Any]) -> None:
    trainer = Trainer(config("cuda", **changes))
    trainer.update(rollout := trainer.collect())
    learner = trainer.learners[0]
    samples = (Chunks if learner.policy.memory else Samples)(rollout, 0, learner.device)
    graphed = GraphedGradients(learner.device)
    parts = torch.randperm(len(samples.units), generator=torch.Generator().manual_seed(0)).tensor_split(4)
    for part in (*parts, *parts, *parts):
        batch = samples.select(part)
        figures, gradients = graphed(learner._gradients, batch)
        expected = learner._gradients(batch)
        nearly([figures, *gradients], [expected[0], *expected[1]], 1e-4)
    assert 1 <= len(graphed.graphs) <= len(parts)


@some_options
def test_nothing_waits_in_an_update(changes: dict[str, Any]) -> None:
    gpu = Trainer(config("cuda", **changes))
    rollout = gpu.collect()
    gpu.update(rollout)
    learner = gpu.learners[0]
    samples = (Chunks if learner.policy.memory else Samples)(rollout, 0, learner.device)
    parts = torch.arange(len(samples.units)).tensor_split(2)
    for part in (*parts, *parts):
        learner._differentiate(samples, part)  # now these shapes have graphs
    torch.cuda.set_sync_debug_mode("error")
    try:
        for part in parts:
            learner._gradients(samples.select(part))
            learner._differentiate(samples, part)
            torch.nn.utils.clip_grad_norm_(learner.parameters, 0.5)
            learner.optimizer.step(1e-3)
    finally:
        torch.cuda.set_sync_debug_mode("default")


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


def test_a_saved_policy_plays_against_learners_on_a_gpu(tmp_path: Path) -> None:
    TrainingRun(replace(config("cuda"), steps=2 * EACH), tmp_path / "run").train()
    saved = str(checkpoints(tmp_path / "run")[-1])
    gpu, plain = (Trainer(config(device, opponents={saved: 1.0})) for device in ("cuda", "cpu"))
    for trainer in (gpu, plain):
        trainer.update(trainer.collect())
    nearly(parameters(gpu), parameters(plain), 2e-3)
