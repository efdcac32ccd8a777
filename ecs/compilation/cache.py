"""The compile cache: machine code of units is found in memory or on disk, or compiled, on all permitted cores.

Of processes that begin at the same time, such as those of a vector environment, one compiles while the others wait.
Units that another scenario, process or version of this game has compiled are loaded (see cache_key for their
dependencies); an edit recompiles the units of the systems that it touches.
"""

import contextlib
import gc
import logging
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from ..kernels import cache_files
from ..kernels.available import available_cores, available_memory
from ..kernels.cache_files import cache_folders
from ..kernels.jit import compiled, options_of
from ..kernels.machine_code import Code, as_python, compile_function, load_code
from .cache_key import CacheKey
from .compile_errors import explained
from .tick import Unit

ADDRESSES: dict[str, int] = {}  # addresses of loaded units, by key
DIGESTS: WeakKeyDictionary[Any, str] = WeakKeyDictionary()  # digests of kernels at the time when numba compiled them
LOCK = threading.RLock()
LOGGER = logging.getLogger("outlast")
REPORT = 10.0  # seconds between messages of progress
UNITS_PER_PROCESS = 4  # compiling fewer takes less time than starting a process
FORK_MEMORY = 192 * 2**20  # bytes; 100 MiB were measured, besides the memory shared with the parent
ENDING = (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))  # signals that end a fork
CURE = "OUTLAST_CACHE_DIR can name another folder"


class CompiledUnits:
    """The compiled units of a tick, and functions for Python. For errors, see CacheKey.

    Args:
        units: All units of the tick.
        functions: Kernels of int64 arguments by label, for Python to call.
        parts: Kernels of three int64 arguments by label, which machine code calls by their address, like units.

    Attributes:
        compiled: Labels that `load` did not find: compiled here, or by other processes.
    """

    def __init__(self, units: Sequence[Unit], functions: Mapping[str, Any], parts: Mapping[str, Any]) -> None:
        assert len({unit.label for unit in units}) == len(units), [unit.label for unit in units]
        self._python = frozenset(functions)
        self._functions = {**functions, **parts} if compiled() else {}
        self._cache_key = CacheKey({unit.label: unit.kernels for unit in units} | self._functions)
        self._keys = {unit.label: self._cache_key.key(unit.label, unit.source) for unit in units}
        self._keys |= {label: self._cache_key.key(label, "") for label in self._functions}
        self._units = {unit.label: unit for unit in units}
        self.compiled: list[str] = []
        self._found: dict[str, Code] = {}  # code that `missing` has read for `load`

    @property
    def missing(self) -> list[str]:
        """Labels of the units whose machine code is neither loaded nor on disk."""
        pending = [label for label, key in self._keys.items() if key not in ADDRESSES]
        folders = cache_folders().readable if pending else []
        return [label for label in pending if not self._read(label, folders)]

    def load(self) -> None:
        """Load all units, and compile those that are not on disk. Raises errors of numba."""
        with LOCK:
            if missing := self.missing:
                self.compiled += missing
                self._discard_outdated()
                before = gc.get_threshold()
                gc.set_threshold(100_000, 50, 50)  # the compiler makes millions of objects that stay
                try:
                    with cache_files.one_at_a_time():
                        self._compile(sorted(self.missing, key=self._urgency))
                finally:
                    gc.set_threshold(*before)
                cache_files.prune()
            found = {label: code for label, code in self._found.items() if self._keys[label] not in ADDRESSES}
            for label, address in zip(found, load_code(found.values()), strict=True):
                ADDRESSES[self._keys[label]] = address
            self._found.clear()

    def address(self, label: str) -> int:
        """Return the address of a unit's function, or of a part."""
        return ADDRESSES[self._keys[label]]

    def function(self, label: str) -> Any:
        """Return one of the functions, for Python to call; it runs without the GIL."""
        return as_python(self.address(label))

    def _read(self, label: str, folders: Iterable[Path]) -> Code | None:
        """Return the machine code of a unit from disk or from this process."""
        name = cache_files.file_name(label, self._keys[label])
        for folder in folders:
            if label not in self._found and (code := cache_files.read(folder / name)):
                self._found[label] = code
        return self._found.get(label)

    def _urgency(self, label: str) -> tuple[bool, int]:
        """Return a sort key: systems from outside of outlast first, which may have errors; then the large ones."""
        unit = self._units.get(label)
        return not (unit and unit.system and unit.system.outside), -self._cache_key.size(label)

    def _discard_outdated(self) -> None:
        """Discard numba's results for kernels that have changed, or that refer to something changed."""
        for kernel, digest in self._cache_key.kernel_digests():
            if getattr(kernel, "overloads", None) and DIGESTS.get(kernel) != digest:
                kernel._make_finalizer()()
                kernel._reset_overloads()
            DIGESTS[kernel] = digest

    def _compile(self, labels: Sequence[str]) -> None:
        """Compile these units and keep them on disk."""
        folders = cache_folders()
        where = folders.writable
        paths = {label: where and where / cache_files.file_name(label, self._keys[label]) for label in labels}
        if folders.problem:
            cache_files.warn(f"compiled code is kept in {where or 'memory only'}, as {folders.problem}; {CURE}")

        last = time.monotonic()

        def work(label: str) -> None:
            nonlocal last
            self._found[label] = self._compile_one(label)
            cache_files.write(paths[label], self._found[label])
            if time.monotonic() - last >= REPORT:
                last = time.monotonic()
                done = [label in self._found or bool(path and path.exists()) for label, path in paths.items()]
                LOGGER.info("compiled %d of %d systems", sum(done), len(done))

        _spread(labels, work, fork=where is not None)
        for label in labels:
            if not self._read(label, folders.readable):  # a fork has failed
                work(label)

    def _compile_one(self, label: str) -> Code:
        unit = self._units.get(label)
        kernel = unit.kernels[0] if unit else self._functions[label]
        function = unit.function() if unit else kernel.py_func
        options = options_of(getattr(kernel, "py_func", kernel))
        name, qualified = function.__name__, function.__qualname__
        function.__name__ = function.__qualname__ = f"unit_{self._keys[label]}"  # makes its symbol unique
        try:
            with explained(unit.system if unit else None):
                return compile_function(function, options, python=label in self._python)
        finally:
            function.__name__, function.__qualname__ = name, qualified


def _spread(labels: Sequence[str], work: Callable[[str], None], fork: bool = True) -> None:
    """Call `work` for each label, in this process and, if possible, in forks; each takes the next label from a pipe.

    The results of a fork are only on disk. Labels at which a fork fails remain.
    """
    fork &= sys.platform == "linux" and threading.active_count() == 1  # others could hold a lock that a fork waits for
    processes = min(_cores(), len(labels) // UNITS_PER_PROCESS) if fork else 1
    owner, children = os.getpid(), list[int]()
    queue, source = os.pipe()
    os.write(source, b"".join(k.to_bytes(2, "little") for k in range(len(labels))))
    os.close(source)

    def take() -> None:
        while owner in (os.getpid(), os.getppid()) and (index := os.read(queue, 2)):
            work(labels[int.from_bytes(index, "little")])

    try:
        with contextlib.suppress(OSError):  # no more processes are allowed
            while len(children) < processes - 1:
                children.append(_fork(take))
        take()
        while children:
            with contextlib.suppress(ChildProcessError):  # SIGCHLD is ignored, or other code has waited for the child
                os.waitpid(children[-1], 0)
            children.pop()
    finally:
        os.close(queue)
        for child in children:  # after Ctrl-C, or an error here
            with contextlib.suppress(ChildProcessError):
                if os.waitpid(child, os.WNOHANG) == (0, 0):
                    os.kill(child, signal.SIGKILL)
                    os.waitpid(child, 0)


def _fork(work: Callable[[], None]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python and JAX warn of threads; no Python thread is running
        child = os.fork()
    if child == 0:
        status = 1
        try:
            for number in signal.valid_signals():
                if callable(signal.getsignal(number)):  # a handler of the program would run twice
                    signal.signal(number, signal.SIG_DFL if number in ENDING else signal.SIG_IGN)
            logging.disable()
            warnings.simplefilter("ignore")
            gc.freeze()  # memory without garbage collection is not copied
            work()
            status = 0
        finally:
            os._exit(status)
    return child


def _cores() -> int:
    """Return the number of processes that may compile, limited by cores and memory."""
    return 1 + int(min(available_cores() - 1, available_memory() // FORK_MEMORY))
