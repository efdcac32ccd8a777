"""Where a tick's time goes: every system timed by itself, over the same worlds and actions.

    python -m perf.profile teams_3 [--worlds 1024] [--steps 200]

Each system is compiled alone and takes all worlds before the next one starts, so the sum is larger than the fused tick
(last line), which keeps a world in the cache from its first system to its last.
"""

import argparse

import numpy as np

from outlast import Scenario
from outlast.components import End
from outlast.ecs import RESET, STEP, Action, Worlds
from outlast.envs.spaces import published
from perf.measure import WARM, step_time
from perf.rows import scenario


def main() -> None:
    """Print microseconds a world-step and share of each system."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("scenario", help="a variant, or a row of perf.step such as '5 agents, 10 heals, 10 boxes'")
    options.add_argument("--worlds", type=int, default=1024)
    options.add_argument("--steps", type=int, default=200)
    given = options.parse_args()
    chosen = scenario(given.scenario)
    times = split_times(chosen, given.worlds, given.steps)
    total = sum(times.values())
    print(f"{given.scenario}: {given.worlds} worlds x {given.steps} steps, random actions, one thread")
    print(f"{'system':<24} {'us':>8} {'share':>7}")
    for label, micros in times.items():
        print(f"{label:<24} {micros:>8.3f} {micros / total:>7.1%}")
    print(f"{'sum of the parts':<24} {total:>8.3f}")
    print(f"{'whole step, fused':<24} {step_time(chosen, given.worlds, given.steps):>8.3f}")


def split_times(chosen: Scenario, count: int, steps: int) -> dict[str, float]:
    """Microseconds a world-step of each system, by label in order of the schedule."""
    worlds = Worlds(chosen.modules, count, split=True)
    worlds.seed(0, np.arange(count))
    mode = np.full(count, RESET, np.int8)
    generator = np.random.default_rng(0)
    for step in range(WARM + steps + 1):
        if step == WARM + 1:
            worlds.times[:] = [0.0] * len(worlds.times)
        for _, component, name, column in published(worlds, Action):
            actions = getattr(worlds[component], name)
            actions[:] = generator.integers(int(column.low), int(column.high) + 1, actions.shape)
        worlds.run(mode)
        end = worlds[End]
        mode[:] = np.where(end.terminated[:, 0] | end.truncated[:, 0], RESET, STEP)
    micros = [seconds / steps / count * 1e6 for seconds in worlds.times]
    return {system.label: time for system, time in zip(worlds.schedule.systems, micros, strict=True)}


if __name__ == "__main__":
    main()
