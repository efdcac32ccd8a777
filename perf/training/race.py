"""Measure in how many CPU seconds training gets as good as the paper's policies.

    python -m perf.training.race ffa_2 teams_2 teams_3 [--seeds 0 1 2 3 4]
        [--preset fast] [--ppo NAME=VALUE] [--steps 10e6] [--every 15]
        [--limit 300] [--whole] [--unmasked] [--out runs/race] [--save MACHINE]

Each run trains on one thread. Every so many CPU seconds of training it stops,
and so does its clock, to play against the reference: the policy of
results/policies/VARIANT/original-0.safetensors. A run is as good as the reference
when it wins 60 % of these games and its episodes of self-play last as long as
the reference's. Then it ends, unless --whole asks for all of its steps.
"""

import contextlib
import csv
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from outlast import variant
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.envs.scenarios.scenario import Scenario
from outlast.training.arena.evaluation import Evaluation
from outlast.training.arena.players import contenders
from outlast.training.base.config import TrainingConfig
from outlast.training.base.presets import PRESETS, parse_hyperparameters
from outlast.training.policies import checkpoint
from outlast.training.ppo.trainer import Trainer, capture
from perf.table import Table, options

RESULTS = Path(__file__).parents[2] / "results" / "policies"
WINS, LENGTH = 0.6, 0.97  # win rate; episode length as a share of the reference's, as lengths have errors of 2 %
SHOWN = {"train/entropy": "entropy", "rollout/heals_used": "heals", "rollout/deaths_melee": "melee"}
EPISODES, WORLDS = 300, 100  # of each duel with the reference


def main() -> None:
    """Train, compare and print a table."""
    parser = options(__doc__)
    parser.add_argument("variants", nargs="+", help="variants to train in")
    parser.add_argument(
        "--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4], help="a run for each (default 0 1 2 3 4)"
    )
    parser.add_argument("--preset", choices=PRESETS, default="fast", help="as in `outlast train` (default fast)")
    parser.add_argument("--ppo", action="append", default=[], metavar="NAME=VALUE", help="change a number of PPO")
    parser.add_argument("--steps", type=float, default=10e6, help="agent-steps of a run, at most (default 10e6)")
    parser.add_argument("--worlds", type=int, default=0, help="worlds (default: as the preset has it)")
    text = "environment steps of a rollout (default: as the preset has it)"
    parser.add_argument("--rollout", type=int, default=0, help=text)
    parser.add_argument(
        "--every", type=float, default=15, help="CPU seconds of training between two duels (default 15)"
    )
    parser.add_argument(
        "--limit", type=float, default=300, help="CPU seconds of training after which a run ends (default 300)"
    )
    parser.add_argument("--whole", action="store_true", help="go on when a run is as good as the reference")
    parser.add_argument("--unmasked", action="store_true", help="also draw actions that can change nothing")
    parser.add_argument("--out", type=Path, default=Path("runs/race"), help="folder of the runs (default runs/race)")
    given = parser.parse_args()
    torch.set_num_threads(1)
    if given.unmasked:
        PRESETS[given.preset] = replace(PRESETS[given.preset], masked=False)
    table = Table(
        "training_race", "variant", "seed", "CPU s", "agent-steps", "wins", "length", "its length", "level after"
    )
    for name in given.variants:
        long = length(variant(name), reference(name))
        for seed in given.seeds:
            config = TrainingConfig(
                variant(name), given.preset, int(given.steps), seed, given.worlds, given.rollout,
                settings=parse_hyperparameters(given.ppo),
            )  # fmt: skip
            folder = given.out / f"{name}-{given.preset}-{seed}"
            rows = race(config, given.every, given.limit, folder, LENGTH * long, given.whole)
            reached, last = next((row["cpu"] for row in rows if row["reached"]), None), rows[-1]
            table.add(
                name, seed, f"{last['cpu']:.0f}", f"{last['steps']:,}", f"{last['wins']:.0%}", f"{last['length']:.0f}",
                f"{long:.0f}", f"{reached:.0f}" if reached else "not reached",
            )  # fmt: skip
    table.finish(given.save)


def race(
    config: TrainingConfig, every: float, limit: float, folder: Path, long: float, whole: bool
) -> list[dict[str, Any]]:
    """Train a run; returns a row for each duel. long: Ticks of an episode at the level of the reference."""
    folder.mkdir(parents=True, exist_ok=True)
    trainer, clock, due, rows = Trainer(config), 0.0, every, list[dict[str, Any]]()
    while trainer.steps < config.steps and clock < limit and (whole or not any(row["reached"] for row in rows)):
        start = time.process_time()
        left = 1 - trainer.steps / config.steps
        rollout = trainer.collect()
        tags = trainer.report() | trainer.update(rollout, left)
        clock += time.process_time() - start
        if clock >= due or trainer.steps >= config.steps:
            due += every
            path = folder / CHECKPOINT.format(trainer.steps)
            checkpoint.write_checkpoint(path, capture(trainer, config.header()))
            row = {"cpu": clock, "steps": trainer.steps, "wins": wins(config.scenario, path)}
            row["length"] = length(config.scenario, path)
            row["reached"] = row["wins"] >= WINS and row["length"] >= long
            rows.append(row | {name: tags.get(tag, 0.0) for tag, name in SHOWN.items()})
            print(config.scenario.name, config.seed, {key: round(value, 3) for key, value in row.items()}, flush=True)
            with (folder / "race.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, rows[0])
                writer.writeheader()
                writer.writerows(rows)
    return rows


def reference(name: str) -> Path:
    return RESULTS / name / "original-0.safetensors"


def wins(scenario: Scenario, path: Path) -> float:
    """The win rate of a checkpoint against the reference."""
    return estimate(scenario, [path, reference(scenario.name)], (0, 1), "wins")


def length(scenario: Scenario, path: Path) -> float:
    """Ticks of an episode of a checkpoint against itself."""
    return estimate(scenario, [path], (0, 0), "length")


def estimate(scenario: Scenario, paths: list[Path], pair: tuple[int, int], name: str) -> float:
    evaluation = Evaluation(scenario, contenders([*map(str, paths)]), episodes=EPISODES, worlds=WORLDS, seed=1)
    with contextlib.closing(evaluation):
        return evaluation.play_pair(pair).estimates(0)[name][0]


if __name__ == "__main__":
    main()
