"""Files with known effects (crash, exception, excessive memory, none), as a test of the fuzzer itself."""

import os
import signal
from pathlib import Path
from random import Random
from typing import ClassVar

import numpy as np

from outlast.envs.errors import StateError

BEHAVIOURS = (b"works", b"refuses", b"raises", b"crashes", b"eats", b"eats and refuses")


class Traps:
    """A file has the effect that its content names."""

    refusals: ClassVar = (StateError,)
    valid = b"works"

    def mutate(self, rng: Random) -> bytes:
        return rng.choice(BEHAVIOURS)

    def use(self, path: Path) -> None:
        match path.read_bytes():
            case b"refuses":
                raise StateError
            case b"raises":
                raise KeyError("another one")
            case b"crashes":
                os.kill(os.getpid(), signal.SIGSEGV)
            case b"eats":
                np.zeros(2**33, np.uint8)
            case b"eats and refuses":
                try:
                    np.zeros(2**33, np.uint8)
                except MemoryError as error:
                    raise StateError from error
