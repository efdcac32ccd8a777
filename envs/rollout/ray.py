"""Rollouts spread over a Ray cluster: they give the same numbers as on one machine, wherever worlds run."""

import contextlib
import os
import socket
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import ray
from ray.exceptions import RayError, RayTaskError

import outlast
from outlast.ecs.kernels.errors import OutlastError

from ..errors import ClusterError
from .local import RolloutTask, run_task, split_worlds
from .summary import Summary

MAX_RETRIES = 5  # retries of a batch of worlds whose worker was lost
GRACE = 2.0  # seconds in which running batches may end before they are stopped
CONNECT_TIMEOUT = 10.0  # seconds in which the head of a cluster has to answer


@contextlib.contextmanager
def connected(address: str = "") -> Iterator[None]:
    """Connect to the Ray cluster at `address`, unless this process is connected to one already, or raise ClusterError.

    The address "" stands for the cluster that $RAY_ADDRESS names or that runs on this machine; without one, a new
    cluster runs on this machine as long as the connection is open.
    """
    if ray.is_initialized():
        yield
        return
    address = address or os.environ.get("RAY_ADDRESS", "")
    try:
        _check_listening(address)
        ray.init(address or None, logging_level="warning")
    except (OSError, ValueError, RuntimeError) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise ClusterError(f"no Ray cluster at {address or 'this machine'}: {reason}") from error
    try:
        yield
    finally:
        ray.shutdown()


def rollout_on_cluster(
    task: RolloutTask, worlds: int, progress: Callable[[Summary], None] = lambda summary: None
) -> Summary:
    """Return the summary of `worlds` worlds, in batches spread over the connected cluster (see `connected`).

    It is the same as on one machine. A batch counts once, when all of it is done; if its worker is lost, it starts
    again elsewhere, and too often is a ClusterError.

    progress: Called with a summary that has the numbers of episodes and world-steps done, but no sums; before an error
    is raised, with the summary of the finished batches, which after Ctrl-C is the argument of the KeyboardInterrupt.
    """
    remote = ray.remote(max_retries=MAX_RETRIES)(_run_on_worker)
    cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
    ahead = deque(split_worlds(worlds, cores))
    # running batches, up to one per core, by Ray's references to their results
    waiting: dict[Any, tuple[int, int]] = {}
    done: dict[tuple[int, int], Summary] = {}
    try:
        while ahead or waiting:
            while ahead and len(waiting) < cores:
                part = ahead.popleft()
                waiting[remote.remote(outlast.__version__, task, *part)] = part
            ready, _ = ray.wait(list(waiting), timeout=1)
            for reference in ready:
                done[waiting[reference]] = _result(reference, *waiting[reference])
                del waiting[reference]
            progress(
                Summary(
                    episodes=sum(summary.episodes for summary in done.values()),
                    world_steps=sum(summary.world_steps for summary in done.values()),
                )
            )
    except (KeyboardInterrupt, OutlastError) as error:
        summary = _merged(done)
        summary.episodes_per_world = 0  # not unbiased: batches with short episodes are done first
        if isinstance(error, KeyboardInterrupt):
            raise KeyboardInterrupt(summary) from None
        progress(summary)
        raise
    finally:
        if waiting:  # stop only what runs: Ray 2.60 ends this very process for tasks that have not begun, or just end
            _, running = ray.wait(list(waiting), num_returns=len(waiting), timeout=GRACE)
            for reference in running:
                ray.cancel(reference)
    return _merged(done)


def _check_listening(address: str) -> None:
    """Raise OSError if nothing listens at host:port: Ray itself would go on trying for many minutes."""
    host, _, port = address.rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host.removeprefix("ray://").strip("[]"), int(port)), CONNECT_TIMEOUT).close()


def _run_on_worker(version: str, task: RolloutTask, first: int, count: int) -> Summary:
    """Run a task on a worker; the result depends on the arguments only, so it can be repeated on another one."""
    if version != outlast.__version__:
        raise ClusterError(f"a worker has outlast {outlast.__version__}, this machine {version}: install the same")
    return run_task(task, first, count)


def _result(reference: Any, first: int, count: int) -> Summary:
    try:
        return ray.get(reference)
    except RayTaskError as error:
        if isinstance(error.cause, OutlastError):  # raised without Ray's traceback, as on one machine
            raise error.cause from None
        raise
    except RayError as error:
        raise ClusterError(
            f"worlds {first} to {first + count - 1} lost their worker {MAX_RETRIES + 1} times "
            f"({type(error).__name__}); it may have run out of memory: see its log"
        ) from error


def _merged(done: dict[tuple[int, int], Summary]) -> Summary:
    """Merge the summaries in order of the worlds, whichever was done first."""
    return Summary.merge(done[part] for part in sorted(done))
