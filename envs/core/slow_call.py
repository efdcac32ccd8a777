"""A message when something takes long and the user cannot see why."""

import contextlib
import logging
import time
from collections.abc import Iterator

from outlast.ecs import Worlds
from outlast.ecs.kernels.cache_files import cache_folder

LOGGER = logging.getLogger("outlast")


@contextlib.contextmanager
def announce_compilation(worlds: Worlds, name: str) -> Iterator[None]:
    """Log at level INFO how many systems are compiled, and how long it took (the cache logs the progress)."""
    if not (count := len(worlds.uncompiled)):
        yield
        return
    kept = f"kept in {folder}" if (folder := cache_folder()) else "not kept"
    systems = f"{count} system{'s' * (count > 1)}"
    LOGGER.info("compiling %s of %s for this machine; machine code is %s", systems, name, kept)
    start = time.perf_counter()
    yield
    LOGGER.info("compiled in %.0f s", time.perf_counter() - start)
