"""The tick in machine code: it takes a few worlds at a time through all units (see compilation.tick).

The state of these worlds stays in the processor's cache meanwhile. Each unit also prefetches a part of the state of the
next ones, a few cache lines for each of its worlds: more lines at once would wait for each other. Lines that no tick
touches are left out.
"""

from ..kernels.jit import kernel, loader, storer
from ..kernels.machine_code import call_address, prefetch
from .arguments import AHEAD, STRIDE

NO_RESULT, DONE = -2, 0  # statuses of compiled functions that raised nothing
UNITS, FAILED, FIRST_WORLD, EXCEPTION, CALLER, CHUNK, TABLE = range(7)  # words of a frame, see run_units
NONE = -1  # the word FAILED, if no unit has failed
RUN, CALL = "run_units", "call"  # labels
read_word, write_word = loader("int64"), storer("int64")


@kernel
def run_units(frame: int, start: int, stop: int) -> int:
    """The tick of the worlds from `start` to `stop`, in machine code.

    Args:
        frame: Address of int64 words, see the names above: the number of units; the index of the one that raised an
            exception, or NONE, the first of its worlds, and the exception; a word for the use of a function that runs
            the tick as a part of its own work; how many worlds go through all units together; and for each unit the
            address of its function and of its arguments.
        start: The first world.
        stop: One after the last world.

    Returns:
        0, or 1 if a unit raised an exception.
    """
    units, chunk = read_word(frame + 8 * UNITS), read_word(frame + 8 * CHUNK)
    write_word(frame + 8 * FAILED, NONE)
    for first in range(start, stop, chunk):
        last = min(first + chunk, stop)
        for k in range(units):
            entry = frame + 8 * (TABLE + 2 * k)
            status = call_address(read_word(entry), read_word(entry + 8), first, last, frame + 8 * EXCEPTION)
            if status != DONE and status != NO_RESULT:
                write_word(frame + 8 * FAILED, k)
                write_word(frame + 8 * FIRST_WORLD, first)
                return 1
    return 0


@kernel
def call(function: int, arguments: int, first: int, last: int, error: int) -> int:
    """Call a part from Python: see `call_address`."""
    return int(call_address(function, arguments, first, last, error))


@kernel
def begin_fetch(arguments: int, first: int) -> int:
    """The address of the state of the world that comes a chunk after `first`, even if there is no such world."""
    return int(read_word(arguments + 8 * AHEAD) + first * read_word(arguments + 8 * STRIDE))


@kernel
def fetch(world: int, offsets: int, count: int) -> None:
    """Begin to load the cache lines of a world's state that lie at `count` offsets, an int64 each."""
    for k in range(count):
        prefetch(world + read_word(offsets + 8 * k))
