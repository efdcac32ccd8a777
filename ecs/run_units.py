"""The tick in machine code: it takes a few worlds at a time through all units (see ecs.tick).

Their state stays in the processor's cache meanwhile, and that of the next ones is fetched.
"""

from .jit import kernel, loader, storer
from .layout import ALIGN
from .machine_code import call_address, prefetch

CHUNK = 32  # worlds that go through all units together
NO_RESULT, DONE = -2, 0  # statuses of compiled functions that raised nothing
UNITS, FAILED, FIRST_WORLD, EXCEPTION, STATE, WORLD_BYTES, TABLE = range(7)  # words of a frame, see run_units
NONE = -1  # FAILED, if no unit did
read_word, write_word = loader("int64"), storer("int64")


@kernel
def run_units(frame: int, start: int, stop: int) -> int:
    """The tick of the worlds from `start` to `stop`, in machine code.

    Args:
        frame: Address of int64 words, see the names above: how many units; the index of the one that raised an
            exception, or NONE, the first of its worlds, and the exception; the address of the worlds' state, and the
            bytes of a world; and for each unit the address of its function and that of its arguments.
        start: The first world.
        stop: One after the last world.

    Returns:
        0, or 1 if a unit raised an exception.
    """
    units = read_word(frame + 8 * UNITS)
    state, world_bytes = read_word(frame + 8 * STATE), read_word(frame + 8 * WORLD_BYTES)
    for first in range(start, stop, CHUNK):
        last = min(first + CHUNK, stop)
        ahead = state + last * world_bytes
        share = -(-(min(last + CHUNK, stop) - last) * world_bytes // (ALIGN * units)) * ALIGN
        for k in range(units):
            for address in range(ahead, ahead + share, ALIGN):
                prefetch(address)
            ahead += share
            entry = frame + 8 * (TABLE + 2 * k)
            status = call_address(read_word(entry), read_word(entry + 8), first, last, frame + 8 * EXCEPTION)
            if status != DONE and status != NO_RESULT:
                write_word(frame + 8 * FAILED, k)
                write_word(frame + 8 * FIRST_WORLD, first)
                return 1
    return 0
