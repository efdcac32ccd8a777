"""Compare our episodes under random actions with the original's, for docs/paper.md: python docs/compare.py.

It writes docs/statistics.csv, from the episodes that tests/mechanics/test_statistics.py plays, and takes half a minute.
"""

import csv
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
FIELDS = ("variant", "quantity", "original", "episodes", "outlast", "our episodes", "errors apart")


def main() -> None:
    """Play every variant and write the table."""
    sys.path.insert(0, str(DOCS.parent))
    from tests.mechanics.test_statistics import EPISODES, TABLE, VARIANTS, errors_apart, play

    with (DOCS / "statistics.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(FIELDS)
        for variant in VARIANTS:
            samples = play(variant)
            for row in (row for row in TABLE if row["variant"] == variant):
                ours = samples[row["quantity"]]
                apart = errors_apart(row, ours)
                numbers = (row["mean"], row["episodes"], f"{ours.mean():.4g}", EPISODES, f"{apart:+z.1f}")
                writer.writerow((variant, row["quantity"], *numbers))
            print(variant)


if __name__ == "__main__":
    main()
