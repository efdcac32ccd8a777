"""Where the time of training goes: collecting and updating, and what in them.

    python -m perf.training [--variants ffa_2 teams_3] [--preset original] [--threads 2] [--save MACHINE]

One rollout as `outlast train` has it (16384 environment steps, 64 worlds) and a number of epochs of one update, with
random initial weights. Rates are in agent-steps a second while collecting, samples a second while updating; shares are
of either part. Best of three rounds.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import torch
from stable_baselines3.common.logger import Logger

from outlast import variant
from outlast.training.ppo import SharedPPO
from outlast.training.presets import PRESETS, preset
from perf.table import Table, options

ROUNDS, EPOCHS = 3, 2
COLLECTING = ("worlds", "observations", "networks", "statistics")
UPDATING = ("minibatches", "forward", "backward", "clipping", "optimiser")


class Stopwatch:
    """Seconds spent in functions that were wrapped, by label."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)

    def wrap(self, target: Any, name: str, label: str) -> None:
        """Let `target.name` be measured under a label."""
        inner = getattr(target, name)

        def timed(*args: Any, **keywords: Any) -> Any:
            return self.run(label, lambda: inner(*args, **keywords))

        setattr(target, name, timed)

    def run(self, label: str, call: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        try:
            return call()
        finally:
            self.seconds[label] += time.perf_counter() - start

    def each(self, label: str, items: Iterator[Any]) -> Iterator[Any]:
        """The items, with the time that it takes to make them."""
        end = object()
        while (item := self.run(label, lambda: next(items, end))) is not end:
            yield item


def main() -> None:
    """Measure and print a table."""
    parser = options(__doc__)
    parser.add_argument("--variants", nargs="+", default=["ffa_2", "teams_3"])
    parser.add_argument("--preset", choices=PRESETS, default="original")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu")
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    table = Table("training", "variant", "part", "a second", *COLLECTING, *UPDATING, "rest")
    for name in given.variants:
        model = make(name, given)
        clock = watched(model)
        best = {label: min(measure(call, clock) for _ in range(ROUNDS)) for label, call in parts(model).items()}
        for label, (seconds, shares) in best.items():
            rate = model.rollout_buffer.alive.size * (EPOCHS if label == "updating" else 1) / seconds
            known = [shares.get(each, 0.0) / seconds for each in (*COLLECTING, *UPDATING)]
            table.add(name, label, f"{rate:,.0f}", *map(percent, known), percent(1 - sum(known)))
    table.finish(given.save)


def make(name: str, given: Any) -> SharedPPO:
    model = SharedPPO(
        variant(name), preset(given.preset), device=given.device, threads=given.threads, n_epochs=EPOCHS, target_kl=None
    )
    model.set_logger(Logger(None, []))
    model._update_current_progress_remaining(0, 1)
    model.collect()
    return model


def parts(model: SharedPPO) -> dict[str, Callable[[], None]]:
    return {"collecting": model.collect, "updating": model.train}


def measure(call: Callable[[], None], clock: Stopwatch) -> tuple[float, dict[str, float]]:
    """Seconds of one call, and of what was wrapped in it."""
    clock.seconds.clear()
    start = time.perf_counter()
    call()
    return time.perf_counter() - start, dict(clock.seconds)


def watched(model: SharedPPO) -> Stopwatch:
    """A clock on the parts of a model."""
    clock, buffer = Stopwatch(), model.rollout_buffer
    clock.wrap(model.base_env, "step", "worlds")
    clock.wrap(model.base_env, "reset", "worlds")
    clock.wrap(model.base_env, "observe", "observations")
    clock.wrap(model.policy, "forward", "networks")
    clock.wrap(model.collector.behaviour, "before_step", "statistics")
    clock.wrap(model.collector.behaviour, "after_step", "statistics")
    clock.wrap(model.collector.episodes, "add", "statistics")
    get = buffer.get
    buffer.get = lambda size: clock.each("minibatches", iter(get(size)))
    clock.wrap(model.policy, "evaluate_actions", "forward")
    clock.wrap(torch.Tensor, "backward", "backward")
    clock.wrap(torch.nn.utils, "clip_grad_norm_", "clipping")
    clock.wrap(model.policy.optimizer, "step", "optimiser")
    return clock


def percent(share: float) -> str:
    return f"{share:.0%}" if share > 0.0005 else ""


if __name__ == "__main__":
    main()
