"""A learner: a policy, its optimiser, and updates from rollouts; on a GPU, without launching kernels one by one."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim.adam import adam

from ..base.config import name_of
from ..base.errors import TrainingError
from ..base.presets import Hyperparameters
from ..policies.policy import Networks
from ..policies.rows import Rows
from ..policies.torch_settings import INDEX
from .crew import Crew
from .loss import ALWAYS, Loss, evaluated, imitation_loss, ppo_loss
from .minibatches import Batch, Minibatch, Samples
from .rollout import Rollout

Array = np.ndarray[Any, Any]
Parts = Iterable[list[Tensor] | None]
Shared = Callable[[Callable[[int], list[Tensor] | None], Iterable[int]], Parts]
CPU = torch.device("cpu")
SHARE = 2048  # samples of a minibatch that are computed at once; for fewer, calls cost more than sums
KL_STOP = 1.5  # times target_kl, as in Stable-Baselines3
OUR_LOSSES: tuple[Loss, ...] = ppo_loss, imitation_loss  # nothing in them waits for a GPU
ADAM: dict[str, Any] = {"fused": True, "amsgrad": False, "maximize": False, "weight_decay": 0.0}
ADAM |= {"beta1": 0.9, "beta2": 0.999, "eps": 1e-5}  # eps, added to the root of the second moment: Stable-Baselines3's
NAMES = "step", "exp_avg", "exp_avg_sq"  # entries of a parameter's moments
SUMS = 1e-3  # tolerance between the loss of a minibatch and the sum of its shares' losses, relative to these
MOST = 64  # shapes remembered, with or without a graph
Gradients = tuple[Tensor, Sequence[Tensor]]
Compute = Callable[[Minibatch], Gradients]


@dataclass(frozen=True)
class Captured:
    """A CUDA graph, the tensors that it reads, and those that it writes."""

    graph: Any
    given: Sequence[Tensor]
    found: Gradients


class GraphedGradients:
    """The figures and gradients of minibatches of Rows on a GPU: one CUDA graph for each shape.

    A GPU runs the 250 kernels of a minibatch in less time than a CPU needs to launch them. A graph is launched at once,
    but has fixed shapes; lists of rows are padded to few lengths, so few graphs are enough. A shape gets its graph when
    it comes again, as capturing takes longer than computing.
    """

    def __init__(self, device: torch.device) -> None:
        self.device, self.graphs = device, dict[Any, Captured | None]()
        self.memory = torch.cuda.graph_pool_handle()  # shared by all graphs, as they run one after the other

    def __call__(self, compute: Compute, batch: Minibatch) -> Gradients:
        """Compute both by `compute`, which must not wait for the GPU. The next call overwrites gradients."""
        tensors = _batch_tensors(batch)
        shapes = cast(Rows, batch.seen).room, *(each.shape for each in tensors)
        met = shapes in self.graphs
        one = self.graphs.pop(shapes, None)
        with torch.cuda.device(self.device):
            if met and one is None:
                one = _capture(compute, batch, self.memory)
            self.graphs[shapes] = one  # moves to the end: the first one is the least recently used
            if len(self.graphs) > MOST:
                del self.graphs[next(iter(self.graphs))]
            if one is None:
                return compute(batch)
            for own, values in zip(one.given, tensors, strict=True):
                own.copy_(values, non_blocking=True)
            one.graph.replay()
            figures, gradients = one.found
            return figures.clone(), gradients


def _capture(compute: Compute, batch: Minibatch, memory: Any) -> Captured:
    """Capture a graph of a function of a minibatch. memory: Shared by all graphs."""
    here = torch.cuda.current_stream()
    side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    side.wait_stream(here)
    with torch.cuda.stream(side):
        compute(_copy(batch))  # the first call initialises libraries, which cannot be captured
    here.wait_stream(side)
    given, graph = _copy(batch), torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=memory):
        found = compute(given)
    return Captured(graph, _batch_tensors(given), found)


def _copy(batch: Minibatch) -> Minibatch:
    """Return a copy in separate memory, without cached results."""
    seen, rest = ({name: each.clone() for name, each in _named(one).items()} for one in (batch.seen, batch))
    return replace(batch, seen=replace(cast(Rows, batch.seen), **seen), **rest)


def _batch_tensors(batch: Minibatch) -> list[Tensor]:
    """Return all tensors of a minibatch, in a fixed order."""
    return [*_named(batch.seen).values(), *_named(batch).values()]


def _named(one: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are tensors, by name."""
    return {each.name: value for each in fields(one) if isinstance(value := getattr(one, each.name), Tensor)}


class Adam:
    """Adam (Kingma and Ba, arXiv:1412.6980), by torch.optim's function.

    The class `torch.optim.Adam` imports PyTorch's compiler, which is not used here: 800 modules, 80 MB, seconds.

    moments: Of each parameter: steps taken, float32 without axes, and averages of gradients and of their squares.
    """

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        self.parameters = list(parameters)
        self.moments = [
            {"step": torch.zeros((), dtype=torch.float32, device=each.device)}
            | {name: torch.zeros_like(each, requires_grad=False) for name in NAMES[1:]}
            for each in self.parameters
        ]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Change the parameters by their gradients, at a learning rate."""
        gradients = [each.grad for each in self.parameters if each.grad is not None]
        steps, averages, squares = ([own[name] for own in self.moments] for name in NAMES)
        adam(self.parameters, gradients, averages, squares, [], steps, lr=rate, **ADAM)

    def restore(self, moments: Sequence[Mapping[str, Tensor]]) -> None:
        """Restore copies of such moments, which may be on another device."""
        for own, given in zip(self.moments, moments, strict=True):
            for name, values in own.items():
                values.copy_(given[name])


class Learner:
    """A policy, and its training.

    Attributes:
        policy: The policy that plays and is saved, on the CPU.
        trained: The policy whose gradients are computed: the same one or, on another device, a copy during updates.
        epochs: Epochs begun so far, in all updates.
        figures: Names of the figures that the loss returns; () before its first call.
    """

    def __init__(
        self,
        policy: Networks,
        numbers: Hyperparameters,
        generator: torch.Generator,
        number: int = 0,
        crew: Crew | None = None,
        device: torch.device = CPU,
        loss: Loss = ppo_loss,
    ) -> None:
        """Create a learner that trains a policy on a device by minimising a loss.

        generator: Shuffles samples; on the CPU. number: Marks its samples, see Rollout.learner. crew: Processes with
        equal policies and generators, which form the same minibatches; each computes gradients of its own samples.
        """
        self.crew, self.loss, self.figures, self.agreed = crew or Crew(), loss, tuple[str, ...](), False
        self.policy, self.numbers, self.generator, self.number = policy, numbers, generator, number
        self.device, self.trained = device, policy if device.type == "cpu" else deepcopy(policy).to(device)
        self.parameters = list(self.trained.parameters())
        # shares of a minibatch seldom have the same size, and a user's loss may wait for the GPU
        graphed = device.type == "cuda" and self.crew.size == 1 and loss in OUR_LOSSES
        self.graphs = GraphedGradients(device) if graphed else None
        self.optimizer = Adam(self.parameters)
        self.epochs = 0

    def update(
        self,
        rollout: Rollout,
        left: float = 1.0,
        on_epoch: Callable[[int], None] = lambda epoch: None,
        shared: Shared = map,
    ) -> dict[str, float]:
        """Train on a rollout.

        left, on_epoch: See Trainer.update. shared: Calls a function for each share of a minibatch, as `map` does, maybe
        on several threads; shares, and the sums of their gradients, do not depend on the number of threads. Returns the
        values to log, by tag; empty if fewer than two samples are this learner's.
        """
        chosen = np.flatnonzero(rollout.learner == self.number)
        if len(chosen) < 2:
            return {}
        rate = self.numbers.learning_rate * (left if self.numbers.anneal_lr else 1)
        self._copy(self.policy, self.trained)
        samples = Samples(rollout, self.number, self.policy, self.device)
        units, wanted = samples.units, max(1, round(len(chosen) / self.numbers.batch_size))
        batches = max(1, min(wanted, len(units) // 2))  # a single sample has no spread for the normalisation
        limit = KL_STOP * self.numbers.target_kl  # if it is 0, the loop does not wait for a GPU

        def parts() -> Iterator[Tensor]:
            for epoch in range(1, self.numbers.n_epochs + 1):
                on_epoch(epoch)
                self.epochs += 1
                yield from units[torch.randperm(len(units), generator=self.generator, **INDEX)].tensor_split(batches)

        found, steps = list[Tensor](), 0
        for part in parts():
            found.append(self._differentiate(samples, part, shared))
            if limit and found[-1][ALWAYS.index("approx_kl")] > limit:
                break
            nn.utils.clip_grad_norm_(self.parameters, self.numbers.max_grad_norm)
            self.optimizer.step(rate)
            steps += 1
        self._copy(self.trained, self.policy)
        means = zip(self.figures, torch.stack(found).double().mean(0).tolist(), strict=True)
        return {f"train/{name}": mean for name, mean in means} | {
            "train/epochs": steps / batches,
            "train/learning_rate": rate,
            "train/explained_variance": explained_variance(rollout, chosen),
        }

    def _copy(self, source: Networks, target: Networks) -> None:
        """Copy one of the two policies to the other, including the scales of inputs."""
        if source is not target:
            tensors = ((*policy.parameters(), *policy.buffers()) for policy in (source, target))
            with torch.no_grad():
                for values, kept in zip(*tensors, strict=True):
                    kept.copy_(values)

    def _differentiate(self, samples: Samples, part: Tensor, shared: Shared = map) -> Tensor:
        """Return the figures of the loss of the units `part`; its gradients are stored in the parameters."""
        shares = max(1, len(part) * samples.length // (SHARE * self.crew.size)) if self.device.type == "cpu" else 1
        calls = shared if shares > 1 else map  # one share does not need threads, and a GPU's graphs stay in this one
        parts = [each for each in calls(lambda share: self._share(samples, part, share, shares), range(shares)) if each]
        if not self.agreed:
            self._agree(samples, part)
        none = torch.zeros(len(self.figures), dtype=torch.float32, device=self.device)
        found, *others = parts or [[none, *map(torch.zeros_like, self.parameters)]]  # if others have all samples
        for other in others:
            for total, more in zip(found, other, strict=True):
                total += more
        self.crew.sum(found)
        figures, *gradients = found
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        return figures

    def _share(self, samples: Samples, part: Tensor, share: int, shares: int) -> list[Tensor] | None:
        """Return the figures of the loss of a share of the units, and all gradients; None if it is empty."""
        batch = samples.select(part, share, shares)
        if batch is None:  # all of its samples belong to other processes
            return None
        if self.graphs is not None and isinstance(batch.seen, Rows):
            figures, gradients = self.graphs(self._gradients, batch)
        else:
            figures, gradients = self._gradients(batch)
        return [figures, *gradients]

    def _gradients(self, batch: Minibatch) -> tuple[Tensor, Sequence[Tensor]]:
        """Return the figures of the loss of a minibatch, and the gradients of all parameters."""
        logs, values, _ = self.trained(batch.seen, batch.memory, batch.begins)
        given = Batch(**vars(batch), network=self.trained, numbers=self.numbers, logs=logs, values=values)
        loss, figures = evaluated(self.loss, given)
        if self.figures not in ((), names := (*figures,)):
            raise TrainingError(f"loss {name_of(self.loss)} returns different figures than before: {', '.join(names)}")
        self.figures = names
        return torch.stack([*figures.values()]), torch.autograd.grad(loss, self.parameters, materialize_grads=True)

    def _agree(self, samples: Samples, part: Tensor) -> None:
        """Agree with all processes on the names of figures, and check that the shares of a loss add up."""
        names = self.crew.gather_values(self.figures)
        self.figures, self.agreed = next((*own,) for own in names if own), True
        if self.loss in OUR_LOSSES:
            return
        total, *halves = (self._share(samples, part, *which) for which in ((0, 1), (0, 2), (1, 2)))
        each = [float(half[0][0]) for half in halves if half]
        if total and abs(float(total[0][0]) - sum(each)) > SUMS * sum(map(abs, each)) + SUMS**2:
            raise TrainingError(
                f"loss {name_of(self.loss)} of a minibatch is {float(total[0][0]):.4g}, and those of its halves are "
                f"{' and '.join(f'{half:.4g}' for half in each)}: they must add up to it, so take batch.mean(x) in "
                "place of x.mean() and x.sum(), multiply other terms by batch.weights.sum(), and do not draw numbers"
            )


def explained_variance(rollout: Rollout, chosen: Array) -> float:
    """Return the share of the variance of returns that values explain; NaN if returns do not vary, but for rounding."""
    returns, values = rollout.returns.ravel()[chosen], rollout.values.ravel()[chosen]
    rounding = float(np.finfo(np.float32).eps * max(np.abs(returns).max(), np.abs(values).max()))
    with np.errstate(over="ignore", invalid="ignore"):  # check_learned reports infinite losses
        variance = returns.var()
        if variance <= rounding**2:
            return float("nan")
        return float(1 - rollout.advantages.ravel()[chosen].var() / variance)
