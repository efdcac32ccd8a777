"""Every row of the paper's two tables: how long a step takes, beside the paper's and the original's numbers.

    python -m perf.step [--worlds 1 64 256 1024] [--save MACHINE]

A step is the whole of it: actions checked, physics, cameras, observations, rewards, statistics, autoreset. Of the rows
without cameras the original's simulation step alone was measured; in these, ours leaves out the observations, too.
Microseconds a world-step, best of five rounds. `outlast` is the best batch size; the last column is the original's
time by that.
"""

import numpy as np
from tqdm import tqdm

from perf.measure import micros, simulator, stepper
from perf.rows import ROWS, Row
from perf.table import Table, options


def main() -> None:
    """Measure all rows and print the table."""
    parser = options(__doc__)
    parser.add_argument("--worlds", type=int, nargs="+", default=[1, 64, 256, 1024], help="batch sizes")
    parser.add_argument("--threads", type=int, default=1)
    given = parser.parse_args()
    table = Table("step", "row", "paper", "original", *(f"{n} worlds" for n in given.worlds), "outlast", "times faster")
    gains = []
    for row in tqdm(ROWS, unit="row"):
        ours = [measure(row, worlds, given.threads) for worlds in given.worlds]
        gains.append(row.original / min(ours))
        table.add(row.name, row.paper, row.original, *ours, min(ours), gains[-1])
    table.add("geometric mean", "", "", *[""] * len(given.worlds), "", float(np.exp(np.mean(np.log(gains)))))
    table.finish(given.save)


def measure(row: Row, worlds: int, threads: int) -> float:
    """Microseconds a world-step of one row."""
    return micros((simulator if row.simulation_only else stepper)(row.scenario, worlds, threads), worlds)


if __name__ == "__main__":
    main()
