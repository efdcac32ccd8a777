"""How many CPU seconds training takes to the level of the paper's policies.

    python -m perf.training.race ffa_2 teams_2 teams_3 [--seeds 0 1 2 3 4] [--preset fast] [--ppo NAME=VALUE]
        [--steps 10e6] [--every 30] [--limit 300] [--out runs/race] [--save MACHINE]

Each run trains on one thread and is stopped every so many CPU seconds, on a clock that then stands still, to play
against the policy of `docs/results/VARIANT-original-0.zip`. It is at the paper's level with a win rate of 60 % and, in
self-play, episodes as long as that policy's.
"""

import csv
import time
from pathlib import Path
from typing import Any

import torch

from outlast import variant
from outlast.training import checkpoint
from outlast.training.config import TrainingConfig
from outlast.training.evaluation.evaluation import Evaluation, contenders
from outlast.training.hyperparameters import parse_hyperparameters
from outlast.training.presets import PRESETS
from outlast.training.resume import capture
from outlast.training.trainer import Trainer
from perf.table import Table, options

RESULTS = Path(__file__).parents[2] / "docs" / "results"
WINS, LENGTH = 0.6, 0.97  # win rate; length of an episode as a share of that of the reference, for its errors are 2 %
SHOWN = {"train/entropy": "entropy", "rollout/heals_used": "heals", "rollout/deaths_melee": "melee"}
EPISODES, WORLDS = 400, 200  # of a duel


def main() -> None:
    """Train, compare and print a table."""
    parser = options(__doc__)
    parser.add_argument("variants", nargs="+")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--preset", choices=PRESETS, default="fast")
    parser.add_argument("--ppo", action="append", default=[])
    parser.add_argument("--steps", type=float, default=10e6)
    parser.add_argument("--worlds", type=int, default=0)
    parser.add_argument("--rollout", type=int, default=0)
    parser.add_argument("--every", type=float, default=30, help="CPU seconds between duels")
    parser.add_argument("--limit", type=float, default=300, help="CPU seconds of a run")
    parser.add_argument("--out", type=Path, default=Path("runs/race"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = Table("training_race", "variant", "seed", "CPU s", "agent-steps", "wins", "length", "level after")
    for name in given.variants:
        for seed in given.seeds:
            config = TrainingConfig(
                variant(name), given.preset, int(given.steps), seed, given.worlds, given.rollout,
                settings=parse_hyperparameters(given.ppo),
            )  # fmt: skip
            rows = race(config, given.every, given.limit, given.out / f"{name}-{given.preset}-{seed}")
            reached = next((row["cpu"] for row in rows if row["reached"]), None)
            last = rows[-1]
            table.add(
                name, seed, f"{last['cpu']:.0f}", f"{last['steps']:,}", f"{last['wins']:.0%}", f"{last['length']:.0f}",
                f"{reached:.0f}" if reached else "not reached",
            )  # fmt: skip
    table.finish(given.save)


def race(config: TrainingConfig, every: float, limit: float, folder: Path) -> list[dict[str, Any]]:
    """A run; a row for each duel."""
    folder.mkdir(parents=True, exist_ok=True)
    trainer, clock, rows = Trainer(config), 0.0, list[dict[str, Any]]()
    due = every
    while trainer.steps < config.steps and clock < limit:
        start = time.process_time()
        rollout = trainer.collect()
        tags = trainer.report() | trainer.update(rollout, 1 - trainer.steps / config.steps)
        clock += time.process_time() - start
        if clock >= due or trainer.steps >= config.steps:
            due += every
            path = folder / checkpoint.NAME.format(trainer.steps)
            checkpoint.write_checkpoint(path, capture(trainer, config.header()))
            row = {"cpu": clock, "steps": trainer.steps} | duel(config, path, reference(config.scenario.name))
            row["reached"] = row["wins"] >= WINS and row["length"] >= LENGTH * row["its_length"]
            row |= {name: tags.get(tag, 0.0) for tag, name in SHOWN.items()}
            rows.append(row)
            print(config.scenario.name, config.seed, {key: round(value, 3) for key, value in row.items()}, flush=True)
            with (folder / "race.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, row)
                writer.writeheader()
                writer.writerows(rows)
    return rows


def reference(name: str) -> Path:
    return RESULTS / f"{name}-original-0.zip"


def duel(config: TrainingConfig, path: Path, other: Path) -> dict[str, float]:
    """The win rate of a checkpoint against another, and the length of its episodes against itself."""
    evaluation = Evaluation(
        config.scenario, contenders([str(path), str(other)]), episodes=EPISODES, worlds=WORLDS, seed=1
    )
    try:
        wins = evaluation.play_pair((0, 1)).estimates(0)["wins"][0]
        length, its_length = (evaluation.play_pair((k, k)).estimates(0)["length"][0] for k in range(2))
    finally:
        evaluation.close()
    return {"wins": wins, "length": length, "its_length": its_length}


if __name__ == "__main__":
    main()
