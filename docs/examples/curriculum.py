"""A curriculum: train in the levels that the policy solves in some episodes and not in others.

In the game, one agent has to get through a maze into the safe zone before its hit points are used up. Nearly all levels
that are drawn at random are too hard for a beginner, who learns nothing from them. A level that is solved in a share p
of its episodes has the learnability p (1 - p) (Rutherford et al., 2024, "No Regrets", SFL). Here p comes from the
episodes of training itself, so choosing levels takes no more steps than drawing them.

    python docs/examples/curriculum.py --seeds 0 1 2 --out docs/curriculum

trains with drawn levels and with chosen levels, for the same number of agent-steps, and draws how many held-out levels
are solved: mazes with other keys, and floor plans, which training never has. A run takes two minutes on one core.
"""

import argparse
import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import outlast
from outlast import levels
from outlast.distributions import integers, uniform
from outlast.levels import FloorPlan, Level
from outlast.systems import Lidar, Maze
from outlast.training.ppo.curriculum import TrainingProgress

LIMIT, HEALTH = 160, 150  # ticks of an episode; hit points, one of which is lost in each tick outside of the zone
SEARCH = (
    outlast.variant("ffa_1")
    .without("melee", "inventory", "pickup", "give_last", "death_drop", "heals", "cameras")
    .replace(n_agents=1, room_size=24.0, agents_health=HEALTH, ending_limit=LIMIT)
    .replace(safe_zone_radii=(1.5,), safe_zone_stand=1_000_000)
    .replace(physics_substeps=4, motors_ahead=0.4, motors_left=0.4, motors_turn=0.02)
    .with_(Lidar(rays=16, depth=8.0))
)
MAZES = SEARCH.with_(Maze(blocks=36)).vary(
    maze_columns=integers(1, 7), maze_rows=integers(1, 7), maze_loops=uniform(0, 1), agents_health=integers(10, HEALTH)
)
BY_HAND = (
    FloorPlan([(-3, 6, 18, 0.4), (3, 0, 18, 0.4), (-3, -6, 18, 0.4)]),
    FloorPlan([(0, y, 0.4, h) for y, h in ((-10, 4), (0, 8), (10, 4))] + [(x, 0, 4, 0.4) for x in (-10, 10)]),
    FloorPlan([(0, 6, 12, 0.4), (-6, 0, 0.4, 12), (6, 0, 0.4, 12), (-4, -6, 4, 0.4), (4, -6, 4, 0.4)]),
    FloorPlan([(x, y, 10, 0.4, x * y / 50) for x in (-6, 6) for y in (-5, 5)]),
)
LAYOUTS = [plan.layout(5) for plan in BY_HAND]
PLANS = SEARCH.with_(BY_HAND[0].mechanic(5)).vary(walls_layout=outlast.distributions.free(LAYOUTS[0]))
METHODS = ("drawn", "chosen")
KEPT, NEW = 96, 48  # in each rollout: levels that are played again, and new levels that are tried
FORGET = 0.7  # the weight of earlier episodes is multiplied by it in each rollout, as the policy changes


class Learnable:
    """Chooses the levels of the next rollout: the most learnable ones so far, and new ones.

    The share p of a level is that of its episodes, and of one more, which ends as new levels usually do.
    """

    def __init__(self) -> None:
        self.tallies: dict[tuple[int, int, int], np.ndarray] = {}  # episodes solved and played, by the level's key

    def __call__(self, progress: TrainingProgress) -> list[Level]:
        new: dict[tuple[int, int, int], np.ndarray] = {}
        for tally in self.tallies.values():
            tally *= FORGET
        for level, deaths in zip(progress.played, progress.statistics["deaths_zone"], strict=True):
            tally = self.tallies[level.key] if level.key in self.tallies else new.setdefault(level.key, np.zeros(2))
            tally += deaths == 0, 1
        usual, all_ = sum(new.values(), np.zeros(2)), self.tallies | new
        mean = usual[0] / max(1, usual[1])
        shares = {key: (solved + mean) / (played + 1) for key, (solved, played) in all_.items()}
        learnable = {key: share * (1 - share) for key, share in shares.items() if all_[key][0]}
        best = sorted(learnable, key=learnable.__getitem__, reverse=True)[:KEPT]
        self.tallies = {key: all_[key] for key in best}
        again = best * (KEPT // max(1, len(best)))  # two of three episodes, even if few levels are kept
        tried = [(int(number), 0, 1) for number in progress.rng.integers(2**63, size=NEW)]
        return [Level(key=key) for key in (*again, *tried)]  # a level's numbers all follow from its key


def held_out(folder: Path) -> dict[str, tuple[outlast.Scenario, list[Level]]]:
    """Levels that nobody trains in, by name, kept in files of that folder."""
    rng = np.random.default_rng(0)
    large = [
        {"maze_columns": c, "maze_rows": r, "agents_health": HEALTH} for c, r in rng.integers(6, 8, (128, 2)).tolist()
    ]
    given = {
        "mazes": (MAZES, [Level(numbers, (1_000_000, k, 1)) for k, numbers in enumerate(large)]),
        "plans": (PLANS, [Level({"walls_layout": LAYOUTS[k % 4]}, (1_000_000, k, 1)) for k in range(128)]),
    }
    for name, (scenario, those) in given.items():
        levels.save(folder / f"{name}.json", scenario, those)
    return {name: (scenario, levels.load(folder / f"{name}.json", scenario)) for name, (scenario, _) in given.items()}


def solved(policy: Path, scenario: outlast.Scenario, those: Sequence[Level]) -> float:
    """The share of levels, each in a world of its own, that a saved policy survives."""
    play, env = outlast.load_policy(policy), outlast.make_vec(scenario, len(those), seed=0, copy=False)
    env.set_levels(those)
    observations, _ = env.reset()
    alive = np.ones(len(those), bool)
    for _ in range(LIMIT):
        observations, _, terminated, _, _ = env.step(play(observations))
        alive &= ~terminated
    env.close()
    return float(alive.mean())


def train(method: str, seed: int, folder: Path, steps: int, worlds: int) -> list[Path]:
    """Train, and return the checkpoints."""
    run = outlast.train(
        MAZES,
        folder / f"{method}-{seed}",
        steps=steps,
        seed=seed,
        worlds=worlds,
        threads=1,
        every=250_000,
        settings={"gamma": 0.99, "ent_coef": 0.01},
        levels=Learnable() if method == "chosen" else None,
    )
    return sorted(run.folder.glob("steps_*.zip"))


def main(arguments: Sequence[str] | None = None) -> None:
    """Train, measure, and write curriculum.csv and curriculum.png."""
    about = (
        "Train in levels that are drawn, and in levels that are chosen, and compare how many held-out ones are solved."
    )
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0], help="a run of each method for each seed")
    parser.add_argument("--methods", choices=METHODS, nargs="+", default=METHODS, help="how levels come about")
    parser.add_argument("--steps", type=int, default=3_000_000, help="agent-steps of each run")
    parser.add_argument("--worlds", type=int, default=256, help="worlds that are stepped together")
    parser.add_argument("--runs", type=Path, default=Path("runs/curriculum"), help="folder for the runs")
    parser.add_argument(
        "--out", type=Path, default=Path("figures"), help="folder for the held-out levels, the table and the figure"
    )
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    tests, table = held_out(given.out), given.out / "curriculum.csv"
    with table.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("levels", "seed", "agent-steps", *tests))
        for method in given.methods:
            for seed in given.seeds:
                for policy in train(method, seed, given.runs, given.steps, given.worlds):
                    shares = [f"{solved(policy, *test):.4f}" for test in tests.values()]
                    writer.writerow((method, seed, int(policy.stem.removeprefix("steps_")), *shares))
    draw(table)


def draw(table: Path) -> None:
    """Draw the table: the mean over seeds, and from the lowest to the highest."""
    from matplotlib.figure import Figure

    with table.open() as file:
        rows = list(csv.DictReader(file))
    figure = Figure(figsize=(8, 3), layout="constrained")
    for panel, name in zip(figure.subplots(1, 2, sharey=True), ("mazes", "plans"), strict=True):
        for method in METHODS:
            steps = sorted({int(row["agent-steps"]) for row in rows if row["levels"] == method})
            shares = [
                [float(r[name]) for r in rows if (r["levels"], int(r["agent-steps"])) == (method, s)] for s in steps
            ]
            (line,) = panel.plot(np.array(steps) / 1e6, [np.mean(each) for each in shares], label=f"{method} levels")
            low, high = [min(each) for each in shares], [max(each) for each in shares]
            panel.fill_between(np.array(steps) / 1e6, low, high, color=line.get_color(), alpha=0.2)
        panel.set(title=f"held-out {name}", xlabel="million agent-steps", ylim=(0, 1))
        panel.grid(alpha=0.3)
    figure.axes[0].set_ylabel("share solved")
    figure.axes[0].legend()
    figure.savefig(table.with_suffix(".png"), dpi=90)


if __name__ == "__main__":
    main()
