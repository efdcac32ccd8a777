"""What more processes give to training, and what halves of the worlds do.

    python -m perf.training.scale [--variants ffa_2 teams_3] [--preset fast] [--processes 1 2] [--rounds 5] [--halves]
        [--save MACHINE]

Agent-steps a second of wall time of collecting and updating, each process on one thread, in turn with one process and
with several; the best round of each. CPU seconds are those of all processes together: they say what sums and waiting
cost, also where others use the machine, which the load shows. A wall time of a machine that is not idle says little.
"""

import contextlib
import os
import time

import torch

from outlast.envs.scenarios.naming import resolve
from outlast.training.config import TrainingConfig
from outlast.training.crew import Crew, recruit
from outlast.training.presets import PRESETS
from outlast.training.trainer import Trainer
from perf.table import Table, options


def main() -> None:
    """Measure and print a table."""
    parser = options(__doc__)
    parser.add_argument("--variants", nargs="+", default=["ffa_2", "teams_3"])
    parser.add_argument("--preset", choices=PRESETS, default="fast")
    parser.add_argument("--processes", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--halves", action="store_true")
    given = parser.parse_args()
    table = Table(
        "training_scale", "variant", "processes", "collected/s", "updated/s", "together/s", "times", "CPU s", "load"
    )
    for name in given.variants:
        with contextlib.ExitStack() as opened:
            runs = {}
            for count in given.processes:
                config = TrainingConfig(resolve(name), given.preset, processes=count, halves=given.halves)
                crew = opened.enter_context(contextlib.closing(recruit(count, follow, config, given.rounds)))
                runs[count] = Timed(crew, config)
            rows = [[timed.round() for timed in runs.values()] for _ in range(given.rounds)]
        best = dict(zip(runs, (list(map(min, zip(*of_one, strict=True))) for of_one in zip(*rows, strict=True))))
        samples = next(iter(runs.values())).samples
        first = sum(best[given.processes[0]][:2])
        for count, (collecting, updating, cpu) in best.items():
            both = collecting + updating
            rates = [f"{samples / seconds:,.0f}" for seconds in (collecting, updating, both)]
            table.add(name, count, *rates, f"{first / both:.2f}", f"{cpu:.2f}", f"{os.getloadavg()[0]:.1f}")
    table.finish(given.save)


class Timed:
    """A trainer that has warmed up, in each of some processes."""

    def __init__(self, crew: Crew, config: TrainingConfig) -> None:
        torch.set_num_threads(1)
        self.crew, self.trainer = crew, Trainer(config, crew=crew)
        self.samples = self.trainer.collect().learner.size
        self.round()

    def round(self) -> tuple[float, float, float]:
        """Wall seconds of a rollout and of an update, and CPU seconds of all processes."""
        self.crew.gather_values(0)  # all begin together
        cpu, times = time.process_time(), [time.perf_counter()]
        rollout = self.trainer.collect()
        self.trainer.report()
        times.append(time.perf_counter())
        self.trainer.update(rollout)
        times.append(time.perf_counter())
        spent = sum(self.crew.gather_values(time.process_time() - cpu))
        return times[1] - times[0], times[2] - times[1], spent


def follow(crew: Crew, config: TrainingConfig, rounds: int) -> None:
    """What the other processes do."""
    timed = Timed(crew, config)
    for _ in range(rounds):
        timed.round()


if __name__ == "__main__":
    main()
