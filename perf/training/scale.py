"""Measure what processes, threads and a GPU give to training.

    python -m perf.training.scale [--variants ffa_2 teams_3] [--preset fast]
        [--processes 1 2] [--devices cpu cuda] [--worlds 256 2048] [--batch N]
        [--threads 1 2] [--rounds 5] [--save MACHINE]

All combinations of devices, numbers of worlds, processes and threads are
measured in turn. Rates are agent-steps per second of wall time, for collecting,
updating and both together, in the best round of each; `times` compares both
together with the first combination. If there are more worlds than the preset
has, minibatches grow as the rollout does, unless --batch gives their size.
CPU seconds are those of all processes together: they say what summing and
waiting cost even if others use the machine, which `load` shows. Wall times of a
machine that is not idle say little.
"""

import contextlib
import itertools
import os
import time
from dataclasses import replace

import torch

from outlast.envs.scenarios.parse import resolve
from outlast.training.base.config import TrainingConfig
from outlast.training.base.presets import PRESETS
from outlast.training.ppo.crew import Crew, recruit
from outlast.training.ppo.trainer import Trainer
from perf.table import Table, options


def main() -> None:
    """Measure and print a table."""
    parser = options(__doc__)
    parser.add_argument(
        "--variants", nargs="+", default=["ffa_2", "teams_3"], help="what to train in (default ffa_2 teams_3)"
    )
    parser.add_argument("--preset", choices=PRESETS, default="fast", help="as in `outlast train` (default fast)")
    parser.add_argument("--processes", nargs="+", type=int, default=[1, 2], help="numbers of processes (default 1 2)")
    parser.add_argument("--devices", nargs="+", default=["cpu"], help="PyTorch's devices for updates (default cpu)")
    parser.add_argument(
        "--worlds", nargs="+", type=int, default=[0], help="numbers of worlds; 0, the default, is the preset's"
    )
    text = "samples of a minibatch (default: the same share of a rollout as in the preset)"
    parser.add_argument("--batch", type=int, default=0, help=text)
    parser.add_argument("--threads", nargs="+", type=int, default=[1], help="threads of each process (default 1)")
    parser.add_argument("--rounds", type=int, default=5, help="rounds of measuring (default 5)")
    given = parser.parse_args()
    measured = "collected/s", "updated/s", "together/s", "times", "CPU s", "load"
    measuring = given.devices, given.worlds, given.processes, given.threads
    table = Table("training_scale", "variant", "device", "processes", "threads", "worlds", "minibatch", *measured)
    for name in given.variants:
        with contextlib.ExitStack() as opened:
            runs = []
            for device, worlds, count, threads in itertools.product(*measuring):
                config = configured(name, given.preset, worlds, given.batch, count, device)
                crew = opened.enter_context(contextlib.closing(recruit(count, follow, config, given.rounds, threads)))
                runs.append(Timed(crew, config, threads))
            rows = [[timed.round() for timed in runs] for _ in range(given.rounds)]
        best = [list(map(min, zip(*of_one, strict=True))) for of_one in zip(*rows, strict=True)]
        first = runs[0].samples / sum(best[0][:2])
        for timed, (collecting, updating, cpu) in zip(runs, best, strict=True):
            config, together = timed.trainer.config, timed.samples / (collecting + updating)
            rates = [timed.samples / collecting, timed.samples / updating, together]
            plan = config.device, config.processes, timed.trainer.threads, config.size[0], config.numbers.batch_size
            cells = [f"{rate:,.0f}" for rate in rates] + [f"{together / first:.2f}", f"{cpu:.2f}"]
            table.add(name, *plan, *cells, f"{os.getloadavg()[0]:.1f}")
    table.finish(given.save, "" if "cuda" not in given.devices else torch.cuda.get_device_name())


def configured(name: str, preset: str, worlds: int, batch: int, processes: int, device: str) -> TrainingConfig:
    """Return what is trained; minibatches of `batch` samples or, with 0, of the usual share of a rollout."""
    usual = TrainingConfig(resolve(name), preset)
    config = replace(usual, worlds=worlds, processes=processes, device=device)
    batch = batch or usual.numbers.batch_size * config.size[1] // usual.size[1]
    return replace(config, settings={"batch_size": batch})


class Timed:
    """A trainer that has warmed up; there is one in each process of a crew."""

    def __init__(self, crew: Crew, config: TrainingConfig, threads: int) -> None:
        torch.set_num_threads(1)
        self.crew, self.trainer = crew, Trainer(config, threads, crew)
        self.samples = self.trainer.collect().learner.size
        self.round()

    def round(self) -> tuple[float, float, float]:
        """Wall seconds of a rollout and of an update, and CPU seconds of all processes."""
        self.crew.gather_values(0)  # so that all begin together
        cpu, times = time.process_time(), [time.perf_counter()]
        rollout = self.trainer.collect()
        self.trainer.report()
        times.append(time.perf_counter())
        self.trainer.update(rollout)
        times.append(time.perf_counter())
        spent = sum(self.crew.gather_values(time.process_time() - cpu))
        return times[1] - times[0], times[2] - times[1], spent


def follow(crew: Crew, config: TrainingConfig, rounds: int, threads: int) -> None:
    """Do what the other processes do: the same rounds as the first."""
    timed = Timed(crew, config, threads)
    for _ in range(rounds):
        timed.round()


if __name__ == "__main__":
    main()
