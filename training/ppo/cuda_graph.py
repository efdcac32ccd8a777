"""Gradients on a GPU without launching kernels one by one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ..policies.rows import Rows
from .minibatches import Minibatch

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
    """The figures and gradients of minibatches of Rows: one CUDA graph for each shape.

    A minibatch takes about 250 kernels, and a GPU runs them in less time than a CPU needs to launch them. A graph is
    launched at once, but its shapes are fixed. Few graphs are enough, as lists of rows are padded to few lengths. New
    shapes get no graph yet: capturing one takes longer than computing without it.
    """

    def __init__(self, device: torch.device) -> None:
        """Capture on `device`, a GPU."""
        self.device, self.graphs = device, dict[Any, Captured | None]()
        self.memory = torch.cuda.graph_pool_handle()  # shared by all graphs, as they run one after the other

    def __call__(self, compute: Compute, batch: Minibatch) -> Gradients:
        """Compute the figures and gradients of a minibatch. The next call overwrites the gradients.

        compute: Computes the figures of a minibatch and the gradients of all parameters. It must always be the same
        function, and must not wait for the GPU.
        """
        tensors = _tensors(batch)
        shapes = _rows(batch).room, *(each.shape for each in tensors)
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
    """Capture a graph of a function of a minibatch. memory: The memory that all graphs share."""
    here = torch.cuda.current_stream()
    side = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    side.wait_stream(here)
    with torch.cuda.stream(side):
        compute(_copy(batch))  # the first call initialises libraries, which cannot be captured
    here.wait_stream(side)
    given, graph = _copy(batch), torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, pool=memory):
        found = compute(given)
    return Captured(graph, _tensors(given), found)


def _copy(batch: Minibatch) -> Minibatch:
    """Return a copy in separate memory, without cached results."""
    seen, rest = ({name: each.clone() for name, each in _named(one).items()} for one in (batch.seen, batch))
    return replace(batch, seen=replace(_rows(batch), **seen), **rest)


def _tensors(batch: Minibatch) -> list[Tensor]:
    """Return all tensors of a minibatch, in a fixed order."""
    return [*_named(_rows(batch)).values(), *_named(batch).values()]


def _named(one: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are tensors, by name."""
    return {each.name: value for each in fields(one) if isinstance(value := getattr(one, each.name), Tensor)}


def _rows(batch: Minibatch) -> Rows:
    if not isinstance(batch.seen, Rows):
        raise TypeError(f"minibatches must be of Rows, not of {type(batch.seen).__name__}")
    return batch.seen
