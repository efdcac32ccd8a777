"""Every row of the paper's two tables: how long a step takes, beside the paper's and the original's numbers.

    python -m perf.step [--worlds 1 64 1024] [--csv perf/results/MACHINE.csv]

A step is the whole of it: actions checked, physics, cameras, observations, rewards, statistics, autoreset. Of the rows
without cameras the original's simulation step alone was measured; in these, ours leaves out the observations, too.
"""

import argparse
import csv
import math
from pathlib import Path

from tqdm import tqdm

from perf.measure import simulation_time, step_time
from perf.rows import ROWS


def main() -> None:
    """Measure all rows and print the table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--worlds", type=int, nargs="+", default=[1, 64, 1024], help="batch sizes")
    options.add_argument("--threads", type=int, default=1)
    options.add_argument("--csv", type=Path, help="also write the numbers here")
    given = options.parse_args()
    times = {
        (row.name, worlds): (simulation_time if row.simulation_only else step_time)(
            row.scenario, worlds, threads=given.threads
        )
        for row in tqdm(ROWS, unit="row")
        for worlds in given.worlds
    }
    print_table(given.worlds, times)
    if given.csv:
        write(given.csv, given.worlds, times)


def print_table(batches: list[int], times: dict[tuple[str, int], float]) -> None:
    """Microseconds a world-step by batch size, and how many times faster than the original the best is."""
    print(f"{'microseconds a world-step':<44} {'paper':>6} {'original':>9} ", end="")
    print(" ".join(f"{f'{n} worlds':>12}" for n in batches), f"{'faster':>8}")
    gains = []
    for row in ROWS:
        ours = [times[row.name, n] for n in batches]
        gains.append(row.original / min(ours))
        print(f"{row.name:<44} {row.paper:>6.0f} {row.original:>9.0f} ", end="")
        print(" ".join(f"{t:>12.2f}" for t in ours), f"{gains[-1]:>7.0f}x")
    print(f"{'geometric mean':<61}", " " * 13 * len(batches), end="")
    print(f"{math.exp(sum(map(math.log, gains)) / len(gains)):>6.0f}x")


def write(path: Path, batches: list[int], times: dict[tuple[str, int], float]) -> None:
    """The same as CSV."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["row", "paper_us", "original_us", *(f"worlds_{n}_us" for n in batches)])
        for row in ROWS:
            ours = (f"{times[row.name, n]:.3f}" for n in batches)
            table.writerow([row.name, row.paper, row.original, *ours])


if __name__ == "__main__":
    main()
