"""Measure where the time of training goes, while collecting and while updating.

    python -m perf.training.rates [--variants ffa_2 teams_3]
        [--preset original] [--worlds 256] [--rollout 32768] [--device cpu]
        [--save MACHINE]

What is timed is a rollout, as `outlast train` collects it, and an update of two
epochs, on one thread, with random initial weights. Rates are agent-steps per
second while collecting and samples per second while updating; shares are of the
time of that part. Times are CPU time, the best of several rounds. On a GPU they are wall
time, and the GPU is waited for after each part: parts that overlap in a run do
not overlap here, so rates are lower than those of a run, which
perf.training.scale measures.
"""

import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import torch

from outlast.training.base.config import TrainingConfig
from outlast.training.base.presets import PRESETS
from outlast.training.policies import compiled_networks
from outlast.training.ppo import learner, minibatches
from outlast.training.ppo.rollout import Rollout
from outlast.training.ppo.trainer import Trainer
from perf.rows import playable
from perf.table import Table, options, positive

ROUNDS, EPOCHS = 6, 2
PARTS = (
    *("worlds", "observations", "networks", "statistics"),  # while collecting
    *("minibatches", "loss", "backward", "clipping", "optimiser"),  # while updating, with networks
)


class Stopwatch:
    """Seconds spent in functions that were wrapped, by label."""

    def __init__(self, device: torch.device) -> None:
        """device: of the networks."""
        self.seconds: dict[str, float] = defaultdict(float)
        self.device = device

    def now(self) -> float:
        """Seconds of CPU time, or of wall time once the GPU has nothing to do."""
        if self.device.type == "cpu":
            return time.process_time()
        torch.cuda.synchronize(self.device)
        return time.perf_counter()

    def wrap(self, label: str, target: Any, *names: str) -> None:
        """Let functions of `target` be measured under a label."""
        for name in names:
            setattr(target, name, self.timed(label, getattr(target, name)))

    def timed(self, label: str, inner: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **keywords: Any) -> Any:
            start = self.now()
            try:
                return inner(*args, **keywords)
            finally:
                self.seconds[label] += self.now() - start

        return call

    def measure(self, call: Callable[[], Any]) -> tuple[float, dict[str, float]]:
        """Seconds of one call, and of what was wrapped in it."""
        self.seconds.clear()
        start = self.now()
        call()
        return self.now() - start, dict(self.seconds)


def main() -> None:
    """Measure and print a table."""
    parser = options(__doc__)
    text = "variants, FILE.py:NAME, or rows of perf.step (default ffa_2 teams_3)"
    parser.add_argument(
        "--variants", nargs="+", type=playable, default=[*map(playable, ("ffa_2", "teams_3"))], help=text
    )
    parser.add_argument(
        "--preset", choices=PRESETS, default="original", help="as in `outlast train` (default original)"
    )
    parser.add_argument("--worlds", type=positive, default=0, help="worlds (default: as the preset has it)")
    text = "environment steps of a rollout (default: as the preset has it)"
    parser.add_argument("--rollout", type=positive, default=0, help=text)
    parser.add_argument("--device", default="cpu", help="PyTorch's device for updates (default cpu)")
    given = parser.parse_args()
    torch.set_num_threads(1)
    table = Table("training", "variant", "part", "a second", *PARTS, "rest")
    clock = watched_functions(torch.device(given.device))
    for scenario in given.variants:
        config = TrainingConfig(
            scenario, given.preset, worlds=given.worlds, rollout=given.rollout, device=given.device,
            settings={"n_epochs": EPOCHS, "target_kl": 0.0},
        )  # fmt: skip
        trainer = Trainer(config)
        watch(trainer, clock)
        rollout = trainer.collect()
        for label, (seconds, shares) in parts(trainer, rollout, clock).items():
            rate = rollout.alive.size * (EPOCHS if label == "updating" else 1) / seconds
            known = [shares.get(each, 0.0) / seconds for each in PARTS]
            table.add(scenario.name, label, f"{rate:,.0f}", *map(percent, known), percent(1 - sum(known)))
    table.finish(given.save)


def parts(trainer: Trainer, rollout: Rollout, clock: Stopwatch) -> dict[str, tuple[float, dict[str, float]]]:
    """Seconds of collecting and of updating, and of what is in them: the best round of each."""
    calls = {"collecting": trainer.collect, "updating": lambda: trainer.update(rollout)}
    return {
        label: min((clock.measure(call) for _ in range(ROUNDS)), key=lambda each: each[0])
        for label, call in calls.items()
    }


def watched_functions(device: torch.device) -> Stopwatch:
    """A clock on the functions that all trainers share."""
    clock = Stopwatch(device)
    clock.wrap("networks", compiled_networks.Acting, "__call__")
    clock.wrap("minibatches", minibatches.Samples, "select")
    clock.wrap("loss", learner, "evaluated")
    clock.wrap("backward", torch.autograd, "grad")
    clock.wrap("clipping", torch.nn.utils, "clip_grad_norm_")
    return clock


def watch(trainer: Trainer, clock: Stopwatch) -> None:
    """Put a clock on the parts of a trainer."""
    lane = trainer.lane
    clock.wrap("worlds", lane.env, "step", "reset")
    clock.wrap("observations", lane, "observe")
    clock.wrap("networks", lane, "noise")
    clock.wrap("statistics", lane.behaviour, "after_step")
    clock.wrap("statistics", lane.episodes, "add")
    for one in trainer.learners:
        one.graphs = None  # the parts of CUDA graphs cannot be timed
        for policy in {one.policy, one.trained}:
            clock.wrap("networks", policy, "forward")
            clock.wrap("networks", policy.choices, "draw")
        clock.wrap("optimiser", one.optimizer, "step")


def percent(share: float) -> str:
    return f"{share:.0%}" if share > 0.0005 else ""


if __name__ == "__main__":
    main()
