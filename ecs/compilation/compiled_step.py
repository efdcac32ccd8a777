"""The tick and the step in machine code: one call from Python for any number of worlds.

A step checks and takes actions, runs the tick, and determines which episodes are over (`step`). The tick runs a few
worlds at a time through all units (`run_units`, see compilation.tick), so that their state stays in the processor's
cache. Each unit also prefetches a part of the state of the next worlds, a few cache lines for each of its worlds: more
lines at once would wait for each other. Lines that no tick touches are left out.
"""

from ..kernels.jit import kernel, loader, storer
from ..kernels.machine_code import call_address, prefetch
from ..memory.episode import RESET, SKIP, STEP
from .arguments import AHEAD, STRIDE

WHOLE_STEP, RUN = "step", "run_units"  # labels
NO_RESULT, DONE_UNIT = -2, 0  # statuses of compiled functions without an exception
UNITS, FAILED, FIRST_WORLD, EXCEPTION, STEP_BLOCK, CHUNK, MODES, TABLE = range(8)  # words of a frame, see run_units
ENTRY_WORDS = 3  # of each unit in the table
NONE = -1  # the word FAILED, if no unit has failed
BEGIN, TICK, FINISH, CUT_SHORT = (1 << k for k in range(4))  # parts of a step; the last: finish a tick that failed
WORDS = (  # of the block of a step, int64
    *("worlds", "rows", "columns"),  # counts; rows: acting entities of a world; columns: actions of each
    # 1 or 0, whether to: check ranges; reset worlds that ended; begin the next episode at once
    *("ranges", "resets", "at_once"),
    # int64 (worlds, rows, columns); (columns,): how many values; which of them means 0
    *("actions", "sizes", "zeros"),
    *("taken", "taken_bytes"),  # actions for the tick, (columns, worlds, rows); bytes of each action
    *("where", "mode", "running", "ended", "stopped", "faulty"),  # a byte for each world
    # lists of columns and their lengths: columns that end an episode, and that report a fault
    *("ends", "end_columns", "faults", "fault_columns"),
)
PLACES = range(0, 8 * len(WORDS), 8)  # offset of each word, in bytes
WORLDS, ROWS, COLUMNS, RANGES, RESETS, AT_ONCE, ACTIONS, SIZES, ZEROS, TAKEN, TAKEN_BYTES = PLACES[:11]
WHERE, MODE, RUNNING, ENDED, STOPPED, FAULTY, ENDS, END_COLUMNS, FAULTS, FAULT_COLUMNS = PLACES[11:]
ADDRESS, NEXT_WORLD, BYTES, ENTRY = range(0, 32, 8)  # in an entry of a list of columns: first world; stride; in each
NOT_RUNNING, HAS_ENDED, OUT_OF_RANGE, DONE, FAULT = (1 << k for k in range(5))
TILE = 64  # rows whose actions fit into the first-level cache while they are taken column by column

read, read_byte = loader("int64"), loader("uint8")
write, write_byte, write_short, write_int = map(storer, ("int64", "int8", "int16", "int32"))


@kernel
def check(block: int) -> int:
    """Check a step, and set the modes: SKIP where `where` is 0. Return the reason of a refusal, then unchanged."""
    worlds, columns, where = read(block + WORLDS), read(block + COLUMNS), read(block + WHERE)
    running, ended, stopped = read(block + RUNNING), read(block + ENDED), read(block + STOPPED)
    rows = worlds * read(block + ROWS)
    actions, sizes = read(block + ACTIONS), read(block + SIZES)
    for w in range(worlds):
        if read_byte(where + w) and not read_byte(running + w):
            return NOT_RUNNING
    if not read(block + RESETS):
        for w in range(worlds):
            if read_byte(where + w) and read_byte(ended + w) | read_byte(stopped + w):
                return HAS_ENDED
    if read(block + RANGES):
        outside = 0  # errors are collected, to avoid a branch for each action
        for first in range(0, rows, TILE):
            for k in range(columns):
                most = read(sizes + 8 * k) - 1
                for row in range(first, min(first + TILE, rows)):
                    action = read(actions + 8 * (row * columns + k))
                    outside |= int(action < 0) | int(action > most)
        if outside:
            return OUT_OF_RANGE
    mode = read(block + MODE)
    for w in range(worlds):
        write_byte(mode + w, STEP + (read_byte(ended + w) | read_byte(stopped + w)) if read_byte(where + w) else SKIP)
    return 0


@kernel
def take(block: int, start: int, stop: int) -> None:
    """Take the actions of the worlds from `start` to `stop`."""
    columns, rows, actions = read(block + COLUMNS), read(block + ROWS), read(block + ACTIONS)
    all_rows = read(block + WORLDS) * rows
    zeros, taken, size = read(block + ZEROS), read(block + TAKEN), read(block + TAKEN_BYTES)
    for first in range(start * rows, stop * rows, TILE):
        for k in range(columns):
            zero, column = read(zeros + 8 * k), taken + size * k * all_rows
            for row in range(first, min(first + TILE, stop * rows)):
                action, at = read(actions + 8 * (row * columns + k)) - zero, column + size * row
                if size == 1:
                    write_byte(at, action)
                elif size == 2:
                    write_short(at, action)
                else:
                    write_int(at, action)


@kernel
def gather(columns: int, count: int, worlds: int, found: int) -> int:
    """Set `found` to 1 for worlds in which a byte of one of the columns is not 0, else to 0. Return whether any is."""
    for w in range(worlds):
        write_byte(found + w, 0)
    some = 0
    for entry in range(columns, columns + count * ENTRY, ENTRY):
        address, stride, size = read(entry + ADDRESS), read(entry + NEXT_WORLD), read(entry + BYTES)
        for w in range(worlds):
            byte = 0
            for k in range(size):
                byte |= read_byte(address + w * stride + k)
            if byte:
                write_byte(found + w, 1)
                some = 1
    return some


@kernel
def finish(block: int, complete: bool) -> int:
    """Record which episodes are over, and which worlds run, after a tick of the worlds whose mode is not SKIP.

    After one that was not complete, they no longer run. Returns flags: whether some are DONE, or report a FAULT.
    """
    worlds, mode, running = read(block + WORLDS), read(block + MODE), read(block + RUNNING)
    ended, stopped, at_once = read(block + ENDED), read(block + STOPPED), read(block + AT_ONCE)
    gather(read(block + ENDS), read(block + END_COLUMNS), worlds, ended)
    done = 0
    for w in range(worlds):
        if read_byte(mode + w) != SKIP:
            if complete:
                write_byte(stopped + w, 0)
            write_byte(running + w, complete and not (at_once and read_byte(ended + w)))
        done |= read_byte(ended + w) | read_byte(stopped + w)
    faulty = gather(read(block + FAULTS), read(block + FAULT_COLUMNS), worlds, read(block + FAULTY))
    return (DONE if done else 0) | (FAULT if faulty else 0)


@kernel
def run_units(frame: int, start: int, stop: int) -> int:
    """Return the tick of the worlds from `start` to `stop`, in machine code; in a step, also take their actions.

    A frame has int64 words, see the names above: the number of units; the index of the unit that raised an exception,
    or NONE, the first of its worlds, and the exception; the block of the step, 0 for none; the number of worlds that go
    through all units together; the address of the modes; and for each unit the address of its function and of its
    arguments, and whether it only runs in resets, which most calls do not have. Returns 1 if a unit raised an
    exception, otherwise 0.
    """
    units, chunk, block = read(frame + 8 * UNITS), read(frame + 8 * CHUNK), read(frame + 8 * STEP_BLOCK)
    modes = read(frame + 8 * MODES)
    write(frame + 8 * FAILED, NONE)
    if block:
        take(block, start, stop)
    for first in range(start, stop, chunk):
        last = min(first + chunk, stop)
        resets = False
        for w in range(first, last):
            resets |= read_byte(modes + w) == RESET
        for k in range(units):
            entry = frame + 8 * (TABLE + ENTRY_WORDS * k)
            if read(entry + 16) and not resets:
                continue
            status = call_address(read(entry), read(entry + 8), first, last, frame + 8 * EXCEPTION)
            if status != DONE_UNIT and status != NO_RESULT:
                write(frame + 8 * FAILED, k)
                write(frame + 8 * FIRST_WORLD, first)
                return 1
    return 0


@kernel
def begin_fetch(arguments: int, first: int) -> int:
    """Return the address of the state of the world a chunk after `first`, even if that world does not exist."""
    return int(read(arguments + 8 * AHEAD) + first * read(arguments + 8 * STRIDE))


@kernel
def fetch(world: int, offsets: int, count: int) -> None:
    """Begin to load the cache lines of a world's state that lie at `count` offsets, an int64 each."""
    for k in range(count):
        prefetch(world + read(offsets + 8 * k))


@kernel
def step(frame: int, function: int, argument: int, worlds: int, block: int, parts: int) -> int:
    """Run some parts of a step, or all. Unused addresses are 0.

    Args:
        frame: See run_units.
        function: The address of the function of the tick: run_units, or one that spreads it over threads.
        argument: Its first argument.
        worlds: Number of worlds.
        block: See WORDS.
        parts: BEGIN: check the step, take its actions. TICK. FINISH: see `finish`; with CUT_SHORT, if the tick failed.

    Returns:
        The result of `check`, if not 0; -1 if a system raised an exception; otherwise the result of `finish`.
    """
    if parts & BEGIN:
        refused = check(block)
        if refused:
            return refused
        if not parts & TICK:
            take(block, 0, worlds)
    complete = not parts & CUT_SHORT
    if parts & TICK:
        write(frame + 8 * STEP_BLOCK, block)
        call_address(function, argument, 0, worlds, frame + 8 * EXCEPTION)
        complete = read(frame + 8 * FAILED) == NONE
    flags = finish(block, complete) if parts & FINISH else 0
    return -1 if parts & TICK and not complete else flags
