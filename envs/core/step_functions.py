"""What a step does before and after the tick, as machine code: one call from Python for any number of worlds.

The functions take the address of a block of int64 words (see WORDS), and return flags.
"""

from typing import Any

from outlast.ecs import RESET, SKIP, STEP, kernel
from outlast.ecs.compilation.run_units import CALLER, EXCEPTION, NONE, run_units
from outlast.ecs.compilation.run_units import FAILED as UNIT_FAILED
from outlast.ecs.kernels.jit import loader, storer
from outlast.ecs.kernels.machine_code import call_address

WORDS = (
    *("worlds", "agents", "columns"),  # counts; columns: how many actions an agent has
    # 1 or 0, whether to: check ranges; reset worlds that ended; begin the next episode at once
    *("ranges", "resets", "at_once"),
    # int64 (worlds, agents, columns); (columns,): how many values; which of them means 0
    *("actions", "sizes", "zeros"),
    *("taken", "taken_bytes"),  # actions as the tick reads them, (columns, worlds, agents); bytes of each action
    *("mode", "running", "ended", "stopped", "terminated", "truncated"),  # a byte for each world
    "rewards",  # float32 (worlds, agents)
    # the first world's, and bytes to the next one; 0: there is none
    *("fault", "fault_stride", "unplaced", "unplaced_stride"),
)
PLACES = range(0, 8 * len(WORDS), 8)  # offset of each word, in bytes
WORLDS, AGENTS, COLUMNS, RANGES, RESETS, AT_ONCE, ACTIONS, SIZES, ZEROS, TAKEN, TAKEN_BYTES = PLACES[:11]
MODE, RUNNING, ENDED, STOPPED, TERMINATED, TRUNCATED, REWARDS = PLACES[11:18]
FAULT, FAULT_STRIDE, UNPLACED, UNPLACED_STRIDE = PLACES[18:]
NOT_RUNNING, HAS_ENDED, OUT_OF_RANGE, DONE, FAULTY = (1 << k for k in range(5))
TILE = 64  # agents whose actions fit into the first-level cache while they are taken column by column
FAILED, COMPLETED, LEFT = range(3)  # how a tick went; LEFT: `running` is left as it is

read, read_byte, read_int = loader("int64"), loader("uint8"), loader("int32")
write, write_byte, write_short, write_int = map(storer, ("int64", "int8", "int16", "int32"))


@kernel
def check(block: int) -> int:
    """Check a step, and set the modes. A step that is refused changes nothing.

    Returns:
        0, or the reason for refusing it: NOT_RUNNING, HAS_ENDED or OUT_OF_RANGE.
    """
    worlds, columns = read(block + WORLDS), read(block + COLUMNS)
    running, ended, stopped = read(block + RUNNING), read(block + ENDED), read(block + STOPPED)
    rows = worlds * read(block + AGENTS)
    actions, sizes = read(block + ACTIONS), read(block + SIZES)
    for w in range(worlds):
        if not read_byte(running + w):
            return NOT_RUNNING
    if not read(block + RESETS):
        for w in range(worlds):
            if read_byte(ended + w) | read_byte(stopped + w):
                return HAS_ENDED
    if read(block + RANGES):
        outside = 0  # errors are collected, so that no action needs a branch
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
        write_byte(mode + w, STEP + (read_byte(ended + w) | read_byte(stopped + w)))
    return 0


@kernel
def take(block: int, start: int, stop: int) -> None:
    """Take the actions of the worlds from `start` to `stop`."""
    columns, agents, actions = read(block + COLUMNS), read(block + AGENTS), read(block + ACTIONS)
    rows = read(block + WORLDS) * agents
    zeros, taken, size = read(block + ZEROS), read(block + TAKEN), read(block + TAKEN_BYTES)
    for first in range(start * agents, stop * agents, TILE):
        for k in range(columns):
            zero, column = read(zeros + 8 * k), taken + size * k * rows
            for row in range(first, min(first + TILE, stop * agents)):
                action, at = read(actions + 8 * (row * columns + k)) - zero, column + size * row
                if size == 1:
                    write_byte(at, action)
                elif size == 2:
                    write_short(at, action)
                else:
                    write_int(at, action)


@kernel
def begin(block: int) -> int:
    """Do `check`, and `take` for all worlds."""
    refused = check(block)
    if not refused:
        take(block, 0, read(block + WORLDS))
    return refused


@kernel
def finish(block: int, outcome: int) -> int:
    """Record which episodes are over, and which worlds run, after a tick of the worlds whose mode is not SKIP.

    The tick that starts an episode neither pays nor ends anything, whatever systems write, as there was no action.

    Args:
        block: See WORDS.
        outcome: COMPLETED; FAILED: those worlds no longer run; LEFT: which worlds run is left as it is.

    Returns:
        Flags: DONE if some episode is over, FAULTY if some world is in a state that is not possible.
    """
    mode, running, ended, stopped = (
        read(block + MODE), read(block + RUNNING), read(block + ENDED), read(block + STOPPED)
    )  # fmt: skip
    terminated, truncated, at_once = read(block + TERMINATED), read(block + TRUNCATED), read(block + AT_ONCE)
    fault, fault_stride = read(block + FAULT), read(block + FAULT_STRIDE)
    unplaced, unplaced_stride = read(block + UNPLACED), read(block + UNPLACED_STRIDE)
    rewards, agents = read(block + REWARDS), read(block + AGENTS)
    done = faulty = 0
    for w in range(read(block + WORLDS)):
        if outcome != LEFT and read_byte(mode + w) == RESET:
            write_byte(terminated + w, 0)
            write_byte(truncated + w, 0)
            for i in range(agents):
                write_int(rewards + 4 * (w * agents + i), 0)
        over = read_byte(terminated + w) | read_byte(truncated + w)
        write_byte(ended + w, over)
        if outcome != LEFT and read_byte(mode + w) != SKIP:
            if outcome == COMPLETED:
                write_byte(stopped + w, 0)
            write_byte(running + w, outcome == COMPLETED and not (at_once and over))
        done |= over | read_byte(stopped + w)
        if fault:
            faulty |= read_byte(fault + w * fault_stride)
        if unplaced:
            faulty |= read_int(unplaced + w * unplaced_stride)
    return (DONE if done else 0) | (FAULTY if faulty else 0)


@kernel
def play(frame: int, start: int, stop: int) -> int:
    """Take the actions of the worlds from `start` to `stop`, and run these worlds' tick (see run_units)."""
    take(read(frame + 8 * CALLER), start, stop)
    return run_units(frame, start, stop)


@kernel
def step(block: int, frame: int, function: int, argument: int) -> int:
    """A whole step: check, the tick, finish.

    Args:
        block: See WORDS.
        frame: See ecs.compilation.run_units.
        function: The address of the function that plays all worlds: `play`, or one that spreads it over threads.
        argument: Its first argument.

    Returns:
        What `check` returns, if the step is refused; -1 if a system raised an exception; otherwise what `finish`
        returns.
    """
    refused = check(block)
    if refused:
        return refused
    write(frame + 8 * CALLER, block)
    call_address(function, argument, 0, read(block + WORLDS), frame + 8 * EXCEPTION)
    if read(frame + 8 * UNIT_FAILED) != NONE:
        finish(block, FAILED)
        return -1
    return finish(block, COMPLETED)


FUNCTIONS: dict[str, Any] = {"begin": begin, "finish": finish, "step": step}
PARTS: dict[str, Any] = {"play": play}
