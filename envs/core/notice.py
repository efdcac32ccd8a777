"""One line when something takes long for a reason the user cannot see."""

import contextlib
import sys
import time
from collections.abc import Iterator

from outlast.ecs import Worlds
from outlast.ecs.cache import cache_folder


@contextlib.contextmanager
def announce_compilation(worlds: Worlds, name: str) -> Iterator[None]:
    """Say on stderr that the tick is being compiled, if it is, and how long it took."""
    if worlds.compiled:
        yield
        return
    print(
        f"outlast: compiling the tick of {name} for this machine, once (about 20 s); "
        f"machine code is kept in {cache_folder()}",
        file=sys.stderr,
        flush=True,
    )
    start = time.perf_counter()
    yield
    print(f"outlast: compiled in {time.perf_counter() - start:.0f} s", file=sys.stderr, flush=True)
