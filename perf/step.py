"""Time a step in every row of the paper's two tables, and in the original.

    python -m perf.step [--worlds 1 64 256 1024] [--original PYTHON:CHECKOUT]
        [--save MACHINE]

A step is a whole step: action checks, physics, cameras, observations, rewards,
statistics, autoreset. In the rows without cameras it is the simulation alone,
without observations and checks, as the paper's first table timed it. Times are
microseconds of CPU time per world-step, in the best of five rounds. `outlast`
is the best batch size. `paper` was measured by the paper's authors on a laptop,
so it must not be divided by our times.

With --original (docs/performance.md says how to get it), a second table
compares both implementations. In every round, the original's env.step is timed
first, then ours, over the first 100 steps of episodes, with random actions.
Rows without cameras are not in it, as the original's env.step needs cameras.
`times faster` is the original's best round divided by our best one, and `round
by round` the range of this ratio over the rounds.
"""

import time
from contextlib import nullcontext

import numpy as np
from tqdm import tqdm

from perf.measure import LIMIT, in_turn, simulator, stepper, timer
from perf.original import NotTheOriginal, Original
from perf.rows import ROWS, Row
from perf.table import Table, options, positive

STEPS = 3000  # steps of the original in a round


def main() -> None:
    """Measure all rows and print the tables."""
    parser = options(__doc__)
    text = "numbers of worlds in a batch, each measured (default 1 64 256 1024)"
    parser.add_argument("--worlds", type=positive, nargs="+", default=[1, 64, 256, 1024], help=text)
    parser.add_argument(
        "--original",
        metavar="PYTHON:CHECKOUT",
        help="also time the original, of the folder CHECKOUT, run by the interpreter PYTHON",
    )
    given = parser.parse_args()
    try:
        with Original(given.original) if given.original else nullcontext() as original:
            step, beside = measured(given.worlds, original)
    except NotTheOriginal as problem:
        parser.error(f"argument --original: {problem}")
    step.finish(given.save)
    if original:
        beside.finish(given.save, f"the original: {original.about}")


def measured(sizes: list[int], original: Original | None) -> tuple[Table, Table]:
    """Our steps by batch size, and the original's beside the best of ours; without an original, that table is empty."""
    step = Table("step", "row", "paper", *(f"{n} worlds" for n in sizes), "outlast")
    beside = Table("original", "row", "original", "outlast", "times faster", "round by round")
    gains = []
    for row in tqdm(ROWS, unit="row"):
        theirs, ours = rounds(row, sizes, original)
        best = ours.min(axis=0)
        step.add(row.name, row.paper, *map(float, best), float(best.min()))
        if theirs is not None:
            gain, each = float(theirs.min() / best.min()), theirs / ours[:, best.argmin()]
            gains += [] if row.counts else [gain]
            spread = f"{each.min():.4g} to {each.max():.4g}"
            beside.add(row.name, float(theirs.min()), float(best.min()), gain, spread)
    if gains:
        beside.add("geometric mean of the variants", "", "", float(np.exp(np.mean(np.log(gains)))), "")
    return step, beside


def rounds(row: Row, sizes: list[int], original: Original | None) -> tuple[np.ndarray | None, np.ndarray]:
    """Microseconds of CPU time a world-step in each round: the original's, (rounds,), and ours, (rounds, sizes)."""
    make = stepper if row.experiment else simulator
    timers = [timer(make(row.scenario, worlds), clock=time.process_time) for worlds in sizes]
    if not (original and row.experiment):
        return None, in_turn(timers) / sizes * 1e6
    both = in_turn([original.timer(row.experiment, row.counts, STEPS, LIMIT), *timers]) * 1e6
    return both[:, 0], both[:, 1:] / sizes


if __name__ == "__main__":
    main()
