"""Processes that train together: each plays in a share of the worlds, and their results are summed up."""

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from datetime import timedelta
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch import distributed as dist

import outlast
from outlast.envs.errors import ClusterError, needed
from outlast.envs.storage.interrupts import ignored

from ..base.errors import TrainingError
from ..base.processes import GUARD, spawning

Array = np.ndarray[Any, Any]
HOST = "127.0.0.1"
TIMEOUT = timedelta(minutes=30)  # wait of the others for one process that compiles or writes files
POLL, GRACE = 0.02, 5.0  # seconds: between checks of starting processes; grace period of a failed process
BEGUN, JOINS, WRONG = "begun {}", "joins {}", "wrong {}"  # keys that process {} sets in the store; WRONG: its error
LOST = 75  # exit status of a process whose only fault is that it lost another one


class Crew:
    """The processes that train together; one that is alone sends nothing. rank: 0 for the one that logs and writes."""

    def __init__(
        self, rank: int = 0, size: int = 1, host: str = HOST, store: Any = None, others: "Others | None" = None
    ) -> None:
        """Create a member, which joins at its first message. host: Its address. others: Those that it started."""
        self.rank, self.size = rank, size
        self._host, self._store, self._others = host, store, others
        self._joined: Any = None  # the group of processes

    def share(self, count: int) -> range:
        """Return the range of this process among `count` worlds."""
        return range(count * self.rank // self.size, count * (self.rank + 1) // self.size)

    def sum(self, tensors: Sequence[Tensor]) -> None:
        """Replace tensors, of one type, by their sums over all processes; those of a GPU are sent through the CPU."""
        if self.size == 1:
            return
        flat = torch.cat([tensor.detach().flatten() for tensor in tensors]).cpu()
        self._run(lambda group: group.allreduce([flat]))
        for tensor, total in zip(tensors, torch.split(flat, [tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(total.view_as(tensor))

    def gather(self, array: Array, axis: int = 0) -> Array:
        """Return the arrays of all processes, joined along an axis in order of rank."""
        if self.size == 1:
            return array
        rows = np.ascontiguousarray(np.moveaxis(array, axis, 0))
        lengths = self._gather(np.array([len(rows)], np.int64).view(np.uint8)).view(np.int64)[:, 0]
        each = rows.itemsize * math.prod(rows.shape[1:])  # bytes of a row
        padded = np.zeros(max(lengths) * each, np.uint8)
        padded[: rows.nbytes] = rows.reshape(-1).view(np.uint8)
        parts = [part[: length * each] for part, length in zip(self._gather(padded), lengths, strict=True)]
        joined = np.concatenate(parts).view(rows.dtype).reshape(sum(lengths), *rows.shape[1:])
        return np.moveaxis(joined, 0, axis)

    def gather_values(self, own: Any) -> list[Any]:
        """Return the values of all processes: numbers, texts, lists and dicts of these (tuples become lists)."""
        if self.size == 1:
            return [own]
        sent = f"{json.dumps(own)}\n".encode()  # received data is never executed
        return [json.loads(line) for line in self.gather(np.frombuffer(sent, np.uint8)).tobytes().splitlines()]

    @contextlib.contextmanager
    def first_ahead(self) -> Iterator[None]:
        """Yield a context that the first process goes through before all others: it compiles, they load."""
        if self.rank:
            self._gather(np.zeros(1, np.uint8))
        yield
        if not self.rank and self.size > 1:
            self._gather(np.zeros(1, np.uint8))

    def close(self) -> None:
        """Leave the others; the first process stops them."""
        self._joined = None
        if self._others is not None:
            self._others.stop()

    def _gather(self, own: Array) -> Array:
        """Return the bytes of all processes, the same number from each: uint8 (processes, bytes)."""
        found = torch.zeros((self.size, len(own)), dtype=torch.uint8, device="cpu")
        self._run(lambda group: group.allgather([list(found)], [torch.from_numpy(own)]))
        return found.numpy()

    def _run(self, begin: Callable[[Any], Any]) -> None:
        """Run a collective operation of PyTorch's gloo over TCP. Raises TrainingError if a process is lost."""
        try:
            if self._joined is None:
                if self._others is not None:
                    self._others.wait()
                else:
                    self._store.set(JOINS.format(self.rank), "")
                options = dist.ProcessGroupGloo._Options()  # type: ignore[attr-defined]
                options._devices = [dist.ProcessGroupGloo.create_device(hostname=self._host)]
                options._timeout = TIMEOUT
                self._joined = dist.ProcessGroupGloo(self._store, self.rank, self.size, options)
            begin(self._joined).wait()
        except RuntimeError as error:
            reason = self._others.reason() if self._others is not None else ""
            text = reason or f"the processes that train together lost each other: {error}"
            raise TrainingError(text, lost=True) from error


class Others:
    """The processes that the first one has started: `size` of them with itself, which find each other in a store."""

    def __init__(self, size: int, store: Any) -> None:
        self.size, self.store = size, store

    def wait(self) -> None:
        """Wait until all are about to join. Raises TrainingError if one ended instead."""
        while not all(self.store.check([JOINS.format(rank)]) for rank in range(1, self.size)):
            if self.ended():
                raise TrainingError(self.reason(), lost=True)
            time.sleep(POLL)

    def reason(self) -> str:
        """Return the error that one of them reports, or how it ended; "" if none has failed. May wait for GRACE."""
        end = time.monotonic() + GRACE
        while time.monotonic() < end:
            for find in (self.reported, self.fault):
                for rank in range(1, self.size):
                    if found := find(rank):
                        return f"process {rank + 1} of {self.size}{self.reported(rank) or found}"
            time.sleep(POLL)
        return ""

    def reported(self, rank: int) -> str:
        """Return the error that a process reports; "" if it does not."""
        return f": {self.store.get(WRONG.format(rank)).decode()}" if self.store.check([WRONG.format(rank)]) else ""

    def ended(self) -> bool:
        """Return whether one of them has ended."""
        raise NotImplementedError

    def fault(self, rank: int) -> str:
        """Return how a process ended, and the cure; "" if it runs, or has only lost another one."""
        raise NotImplementedError

    def stop(self) -> None:
        """End them."""
        raise NotImplementedError


class Children(Others):
    """Processes on the same machine, which end with this one."""

    def __init__(self, size: int, work: Callable[..., None], arguments: Sequence[Any], store: Any) -> None:
        super().__init__(size, store)
        context = spawning()
        self.processes = [
            context.Process(target=join, args=(rank, size, HOST, HOST, store.port, work, *arguments), daemon=True)
            for rank in range(1, size)
        ]
        with ignored("SIGINT", "SIGUSR1"):  # a terminal sends Ctrl-C to all processes, and this one handles it
            for process in self.processes:
                process.start()

    def ended(self) -> bool:
        """See Others."""
        return any(not process.is_alive() for process in self.processes)

    def fault(self, rank: int) -> str:
        """See Others."""
        process = self.processes[rank - 1]
        if process.is_alive() or (code := process.exitcode or 0) == LOST:
            return ""
        how = f" was ended by signal {-code}" if code < 0 else f" ended with status {code}"
        imported = code < 0 or self.store.check([BEGUN.format(rank)])
        cure = "; continue with --resume" if imported else f" before it began to train: {GUARD}"
        return how + cure

    def stop(self) -> None:
        """Kill them: they own no files, and may be waiting for each other."""
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.join()


def recruit(size: int, work: Callable[..., None], *arguments: Any) -> Crew:
    """Return a crew of processes: this one, and others that it starts.

    work: Run by the others with their crew and `arguments`; picklable, as a function of a module.
    """
    if size == 1:
        return Crew()
    store = listening(HOST)
    return Crew(0, size, HOST, store, Children(size, work, arguments, store))


def listening(host: str) -> Any:
    """Open the store where the processes of a crew find each other: a server in this process, at a free port."""
    if not dist.is_available():
        raise TrainingError("this PyTorch was built without torch.distributed, which several processes need")
    return dist.TCPStore(host, 0, is_master=True, wait_for_workers=False)  # type: ignore[attr-defined]


def join(rank: int, size: int, host: str, first: str, port: int, work: Callable[..., None], *arguments: Any) -> None:
    """Join the crew and do the work, see `recruit`. host, first: Addresses of this and the first process."""
    store = dist.TCPStore(first, port, is_master=False)  # type: ignore[attr-defined]
    store.set(BEGUN.format(rank), "")
    crew = Crew(rank, size, host, store)
    try:
        work(crew, *arguments)
    except Exception as error:
        if isinstance(error, TrainingError) and error.lost:
            raise SystemExit(LOST) from None
        with contextlib.suppress(RuntimeError):  # if the first process has ended
            store.set(WRONG.format(rank), f"{error}" or type(error).__name__)
        raise SystemExit(1) from None
    finally:
        crew.close()


class Tasks(Others):
    """The other processes of the crew, as tasks that run on a Ray cluster."""

    def __init__(self, ray: Any, tasks: list[Any], store: Any, opened: contextlib.ExitStack) -> None:
        """Take Ray's references to the results of tasks. opened: Closed when they are stopped."""
        super().__init__(len(tasks) + 1, store)
        self.ray, self.tasks, self.opened = ray, tasks, opened

    def ended(self) -> bool:
        """See Others."""
        return bool(self.ray.wait(self.tasks, timeout=0)[0])

    def fault(self, rank: int) -> str:
        """See Others."""
        try:
            self.ray.get(self.tasks[rank - 1], timeout=0)
        except self.ray.exceptions.GetTimeoutError:  # it still runs
            return ""
        except self.ray.exceptions.RayError as error:
            return f" was lost ({type(error).__name__}); continue with --resume"
        return ""

    def stop(self) -> None:
        """Close the connection; the tasks end when they lose this process."""
        with self.opened:
            self.ray.wait(self.tasks, num_returns=len(self.tasks), timeout=GRACE)


def recruit_on_cluster(address: str, size: int, work: Callable[..., None], *arguments: Any) -> Crew:
    """Return a crew of this process and tasks on a Ray cluster. Raises ClusterError or TrainingError."""
    with needed("ray", "a Ray cluster needs {}", TrainingError):
        import ray  # takes seconds to load

        from outlast.envs.rollout.ray import connected
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
        return Crew(0, size, here, store, Tasks(ray, tasks, store, opened.pop_all()))


def _join_from_worker(rank: int, size: int, version: str, first: str, port: int, work: Any, *arguments: Any) -> None:
    import ray

    if version != outlast.__version__:
        raise ClusterError(f"a worker has outlast {outlast.__version__}, the first process {version}: install the same")
    join(rank, size, ray.util.get_node_ip_address(), first, port, work, *arguments)
