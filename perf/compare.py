"""Compare what a step costs in two checkouts, before and after a change.

    python -m perf.compare OLD NEW [--variants ffa_1 teams_3] [--worlds 1024]
        [--threads 1] [--specialize] [--save MACHINE]

OLD and NEW are folders with a checkout each, such as one that
`git worktree add ../before HEAD~1` makes. Each runs in a process of its own,
with this Python and its libraries. Both processes run on the same processor, as
two processors of a machine can differ, and new ones are started four times, as
every process keeps its luck with memory. Each pair of processes has four
rounds; in a round, each process in turn steps all worlds for over half a
second, in changing order, with random actions and copy=False.

`old` and `new` are microseconds of CPU time per world-step in the best round.
(With several threads it is wall time, and they use all processors.) `change` is
the median of the ratios new / old of single rounds, and `round by round` their
range: a change that is smaller than that range is none. Comparing a checkout
with itself shows the noise.
"""

import os
import subprocess
import sys
from argparse import ArgumentTypeError
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np
from tqdm import tqdm

from perf.table import Table, options, positive

STARTS, ROUNDS, SECONDS = 4, 4, 0.6  # how often processes are started; rounds of each start; seconds of a round
WORKER = """
import inspect, os, sys, time
import numpy as np
import outlast

from perf.rows import scenario

worlds, threads = map(int, sys.argv[2:4])
if threads == 1 and hasattr(os, "sched_setaffinity"):  # both on one, as two processors can differ by more than a change
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
known = inspect.signature(outlast.make_vec).parameters
clock = time.process_time if threads == 1 else time.perf_counter
more = {"copy": False, "specialize": sys.argv[4] == "True"}
more = {k: more[k] for k in more if k in known}
env = outlast.make_vec(scenario(sys.argv[1]), worlds, seed=0, threads=threads, **more)
env.reset()
generator = np.random.default_rng(0)
draws = [generator.integers(0, env.action_sizes, (worlds, env.num_agents, len(env.action_sizes))) for _ in range(50)]
for line in map(int, sys.stdin):
    start = clock()
    for k in range(line):
        env.step(draws[k % 50])
    print((clock() - start) / line / worlds * 1e6, flush=True)
"""


class Checkout:
    """A process that steps a variant with the code of a checkout."""

    def __init__(self, folder: Path, *given: object) -> None:
        path = os.pathsep.join(filter(None, (str(folder / ".src"), os.environ.get("PYTHONPATH"))))
        self.process = subprocess.Popen(
            [sys.executable, "-c", WORKER, *map(str, given)],
            cwd=folder,  # it imports perf.rows from there
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def time(self, steps: int) -> float:
        """Microseconds a world-step, over `steps` steps of all worlds."""
        assert self.process.stdin
        assert self.process.stdout
        self.process.stdin.write(f"{steps}\n")
        self.process.stdin.flush()
        return float(self.process.stdout.readline() or sys.exit("it has ended: what it printed is above"))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.communicate()


def checkout(text: str) -> Path:
    """The folder of a checkout, for command lines."""
    folder = Path(text).resolve()
    if not (folder / ".src" / "outlast" / "__init__.py").exists():
        raise ArgumentTypeError(f"{text} is no checkout of outlast: there is no .src/outlast in it")
    return folder


def compared(old: Path, new: Path, variant: str, worlds: int, threads: int, specialize: bool) -> np.ndarray:
    """Microseconds a world-step of the old and of the new checkout, (rounds, 2)."""
    pairs = [(old, new), (new, old)]  # the process that starts first may get the better memory
    times = [started(*pairs[k % 2], variant, worlds, threads, specialize)[:, :: (1, -1)[k % 2]] for k in range(STARTS)]
    return np.concatenate(times)


def summary(times: np.ndarray) -> tuple[float, float, float, str]:
    """Cells of a table: the best of each, and the median and the range of their ratios in single rounds."""
    old, new = times.min(0)
    each = times[:, 1] / times[:, 0]
    return float(old), float(new), float(np.median(each)), f"{each.min():.4g} to {each.max():.4g}"


def started(one: Path, other: Path, variant: str, worlds: int, threads: int, specialize: bool) -> np.ndarray:
    """Microseconds a world-step of both checkouts, (ROUNDS, 2), from two new processes."""
    with ExitStack() as stack:
        both = [stack.enter_context(Checkout(folder, variant, worlds, threads, specialize)) for folder in (one, other)]
        slow = max(each.time(5) for each in both)  # this also compiles
        slow = min(slow, *(each.time(20) for each in both))
        steps = max(1, round(SECONDS / (slow * worlds * 1e-6)))
        times = np.zeros((ROUNDS, 2))
        for k in range(ROUNDS):
            for i in (0, 1) if k % 2 else (1, 0):
                times[k, i] = both[i].time(steps)
        return times


def main() -> None:
    """Compare, and print a table."""
    parser = options(__doc__)
    parser.add_argument("old", type=checkout, metavar="OLD", help="folder of the checkout before the change")
    parser.add_argument("new", type=checkout, metavar="NEW", help="folder of the checkout after the change")
    text = "variants, or rows of perf.step, to play (default ffa_1 ffa_3 teams_3)"
    parser.add_argument("--variants", nargs="+", default=["ffa_1", "ffa_3", "teams_3"], help=text)
    parser.add_argument("--worlds", type=positive, default=1024, help="number of worlds in a batch (default 1024)")
    parser.add_argument("--threads", type=positive, default=1, help="threads that share the worlds (default 1)")
    parser.add_argument(
        "--specialize", action="store_true", help="use make_vec(specialize=True) where a checkout has that"
    )
    given = parser.parse_args()
    table = Table("compare", "variant", "old", "new", "change", "round by round")
    for variant in tqdm(given.variants, unit="variant"):
        how = given.worlds, given.threads, given.specialize
        table.add(variant, *summary(compared(given.old, given.new, variant, *how)))
    table.finish(given.save)


if __name__ == "__main__":
    main()
