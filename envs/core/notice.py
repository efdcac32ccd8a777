"""A message when something takes long and the user cannot see why."""

import contextlib
import logging
import time
from collections.abc import Iterator

from outlast.ecs import Worlds
from outlast.ecs.cache_files import cache_folder

LOGGER = logging.getLogger("outlast")


@contextlib.contextmanager
def announce_compilation(worlds: Worlds, name: str) -> Iterator[None]:
    """If the tick is being compiled, log this at level INFO, and how long it took."""
    if worlds.compiled:
        yield
        return
    LOGGER.info(
        "compiling the tick of %s for this machine, once (about 10 s); machine code is kept in %s", name, cache_folder()
    )
    start = time.perf_counter()
    yield
    LOGGER.info("compiled in %.0f s", time.perf_counter() - start)
