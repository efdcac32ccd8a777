"""Processes that train together on a Ray cluster: one is this process, the others are tasks of the cluster."""

import contextlib
from collections.abc import Callable
from typing import Any

import ray
from ray.exceptions import GetTimeoutError, RayError

import outlast
from outlast.envs.errors import ClusterError
from outlast.envs.rollout.ray import connected

from .crew import GRACE, Crew, CrewProcess, Others, join, listening


def recruit_on_cluster(address: str, size: int, work: Callable[..., None], *arguments: Any) -> Crew:
    """Return a crew as `crew.recruit` does, on a cluster (see envs.rollout.ray.connected). Raises ClusterError."""
    with contextlib.ExitStack() as opened:
        opened.enter_context(connected(address))
        cores = int(ray.cluster_resources().get("CPU", 0))
        if cores < size - 1:
            raise ClusterError(f"the cluster has {cores} cores: {size} processes need {size - 1}, and one here")
        here = ray.util.get_node_ip_address()
        store = listening(here)
        run = ray.remote(num_cpus=1, max_retries=0)(_join_from_worker)
        given = (outlast.__version__, here, store.port, work, *arguments)
        tasks = [run.remote(rank, size, *given) for rank in range(1, size)]
        return CrewProcess(0, size, here, store, Tasks(tasks, store, opened.pop_all()))


class Tasks(Others):
    """The other processes of the crew, as tasks that run on the cluster."""

    def __init__(self, tasks: list[Any], store: Any, opened: contextlib.ExitStack) -> None:
        """Take Ray's references to the results of tasks. opened: Closed when they are stopped."""
        super().__init__(len(tasks) + 1, store)
        self.tasks, self.opened = tasks, opened

    def ended(self) -> bool:
        """See Others."""
        return bool(ray.wait(self.tasks, timeout=0)[0])

    def reason(self) -> str:
        """See Others."""
        ray.wait(self.tasks, timeout=GRACE)  # until the first of them ends
        if wrong := self.reported():
            return wrong
        for rank, task in enumerate(self.tasks, 1):
            try:
                ray.get(task, timeout=0)
            except GetTimeoutError:  # it still runs
                continue
            except RayError as error:
                wrong = f"was lost ({type(error).__name__})"
                return f"process {rank + 1} of {self.size} {wrong}; continue with --resume"
        return ""

    def stop(self) -> None:
        """Close the connection; the tasks end when they lose this process."""
        with self.opened:
            ray.wait(self.tasks, num_returns=len(self.tasks), timeout=GRACE)


def _join_from_worker(rank: int, size: int, version: str, first: str, port: int, work: Any, *arguments: Any) -> None:
    if version != outlast.__version__:
        raise ClusterError(f"a worker has outlast {outlast.__version__}, the first process {version}: install the same")
    join(rank, size, ray.util.get_node_ip_address(), first, port, work, *arguments)
