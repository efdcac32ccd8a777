"""Measure what is paid beside the step: memory, resets, making environments.

    python -m perf.cost memory [--steps 10000000] [--save MACHINE]
    python -m perf.cost reset [--save MACHINE]
    python -m perf.cost make [--save MACHINE]

memory: the bytes of a world's state and buffers (actions, observations,
signals), and how much the process grows while it takes that many world-steps.
reset: what the reset of a world costs, in steps of a world, alone in its batch
and as one of 1,024. make: milliseconds of CPU time to make an environment of
one world whose machine code is in memory already, of a game that differs in a
number from all games before and of the same game again; best of five rounds.
What the start of a process costs is measured by perf.edit.
"""

import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from tqdm import tqdm

from outlast import Scenario, make_vec, role, variant
from outlast.distributions import integers, uniform
from outlast.ecs import RESET, STEP, Worlds
from outlast.envs.rollout.policies import random_policy
from outlast.envs.scenarios.variants import VARIANTS
from outlast.systems import Maze
from perf.measure import alternate, in_turn, timer
from perf.table import Table, options, positive

CHUNK = 1024  # worlds that the memory test steps together


def main() -> None:
    """Measure one of the three."""
    parser = options(__doc__)
    parser.add_argument("what", choices=("memory", "reset", "make"), help="what to measure")
    parser.add_argument(
        "--steps", type=positive, default=1_000_000, help="memory: world-steps of each variant (default 1000000)"
    )
    given = parser.parse_args()
    tables = {"memory": lambda: memory(given.steps), "reset": reset, "make": make}
    tables[given.what]().finish(given.save)


def memory(steps: int) -> Table:
    """Bytes a world, and growth of the resident set after a warm-up of a tenth of the steps."""
    table = Table("memory", "variant", "state", "buffers", "bytes a world", f"growth in {steps:,} steps")
    for name in tqdm(VARIANTS, unit="variant"):
        env = make_vec(name, CHUNK, seed=0, copy=False)
        policy, worlds = random_policy(env), env.worlds
        observations, _ = env.reset()
        state = worlds.layout.world_bytes
        outside = [column for c in worlds.components if not c.packed for column in worlds[c]]
        buffers = sum(column.nbytes for column in outside) // CHUNK
        before = 0
        for step in range(steps // CHUNK):
            if step == steps // CHUNK // 10:
                before = resident()
            observations, *_ = env.step(policy(observations))
        table.add(name, state, buffers, state + buffers, f"{(resident() - before) / 1e6:.1f} MB")
        env.close()
    return table


def resident() -> int:
    """Bytes of this process in memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def reset() -> Table:
    """Ticks of mode RESET against ticks of mode STEP, in turn."""
    table = Table("reset", "variant", "worlds", "us a step", "us a reset", "steps a reset")
    for name, scenario in tqdm(VARIANTS.items(), unit="variant"):
        for count in (1, 1024):
            worlds = Worlds(scenario.modules, count)
            worlds.seed(0, np.arange(count))
            worlds.run(np.full(count, RESET, np.int8))
            times = np.median(alternate([ticks(worlds, STEP), ticks(worlds, RESET)]), axis=0) / count * 1e6
            table.add(name, count, float(times[0]), float(times[1]), float(times[1] / times[0]))
    return table


def make() -> Table:
    """Environments of scenarios with more and more that varies: of a new game each time, and of the same one."""
    counts = variant("teams_4").vary(n_agents=integers(2, 6), n_heals=integers(1, 15), n_boxes=integers(1, 8))
    roles = counts.roles(hunter=role(1, melee_damage=integers(15, 25), cameras_depth=uniform(8, 14)), prey=role())
    scenarios = {"ffa_1": variant("ffa_1"), "teams_4": variant("teams_4"), "teams_4, counts vary": counts}
    scenarios |= {"... and roles": roles, "... and a maze": roles.with_(Maze())}
    table, limits = Table("make", "scenario", "new game, ms", "same game, ms"), itertools.count(10**6)
    for name, scenario in tqdm(scenarios.items(), unit="scenario"):
        new = milliseconds(scenario.replace(ending_limit=limit) for limit in limits)
        table.add(name, new, milliseconds(itertools.repeat(scenario)))
    return table


def milliseconds(games: Iterator[Scenario]) -> float:
    """Milliseconds to make one world of the next game."""
    made = timer(lambda k: make_vec(next(games), 1, seed=0).close(), clock=time.process_time)
    return float(in_turn([made]).min()) * 1e3


def ticks(worlds: Worlds, mode: int) -> Callable[[int], None]:
    """Calls that take all worlds through a tick of this mode."""
    modes = np.full(worlds.count, mode, np.int8)
    return lambda k: worlds.run(modes)


if __name__ == "__main__":
    main()
