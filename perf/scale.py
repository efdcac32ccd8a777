"""Measure how the cost of a step grows with worlds, agents and threads.

    python -m perf.scale worlds [--scenarios ffa_1 teams_3] [--save MACHINE]
    python -m perf.scale agents [--save MACHINE]
    python -m perf.scale threads [--save MACHINE]

worlds: microseconds per world-step on one thread, for 1 to 16,384 worlds; and
of plain Box2D (perf.floor), for up to 4,096 worlds. agents: microseconds per
agent-step with 10 to 128 agents in a world, in rooms that are as crowded as the
paper's with 10 agents, 10 heals and 20 boxes. threads: world-steps per second
of 4,096 worlds with 1, 2, 4, ... threads, measured in turn.
"""

import math
import os
from collections.abc import Callable

import numpy as np
from tqdm import tqdm

from outlast import Scenario
from perf.floor import plain_box2d
from perf.measure import alternate, micros, stepper
from perf.rows import scenario
from perf.table import Table, options

HEAVY = 4096  # the most b2Worlds, which take 0.1 MB each
WORLDS = [4**k for k in range(8)]
AGENTS = [10, 32, 64, 128]


def main() -> None:
    """Measure one of the three."""
    parser = options(__doc__)
    parser.add_argument("what", choices=("worlds", "agents", "threads"), help="what the cost grows with")
    text = "worlds: variants, or rows of perf.step (default ffa_1 teams_3)"
    parser.add_argument("--scenarios", nargs="+", default=["ffa_1", "teams_3"], help=text)
    given = parser.parse_args()
    tables: dict[str, Callable[[], Table]] = {
        "worlds": lambda: by_worlds(given.scenarios),
        "agents": by_agents,
        "threads": lambda: by_threads("teams_3"),
    }
    tables[given.what]().finish(given.save)


def by_worlds(names: list[str]) -> Table:
    """Batches of every size, and the floor of perf.floor as far as its worlds fit into memory."""
    table = Table("worlds", "worlds", *(f"{name}{suffix}" for name in names for suffix in ("", " box2d")))
    for worlds in tqdm(WORLDS, unit="size"):
        row: list[float | str] = []
        for name in names:
            row.append(micros(stepper(scenario(name), worlds), worlds))
            row.append(micros(plain_box2d(scenario(name), worlds), worlds) if worlds <= HEAVY else "")
        table.add(worlds, *row)
    return table


def by_agents() -> Table:
    """Crowds of every size, each at the best of three batch sizes."""
    table = Table("agents", "agents", "worlds", "us an agent-step", "times that of 10")
    first = None
    for agents in tqdm(AGENTS, unit="size"):
        costs = {
            worlds: micros(stepper(crowd(agents), worlds), worlds) / agents
            for worlds in (total // agents for total in (1280, 3840, 10_240))
        }
        best = min(costs, key=lambda worlds: costs[worlds])
        first = first or costs[best]
        table.add(agents, best, costs[best], costs[best] / first)
    return table


def crowd(agents: int) -> Scenario:
    """So many agents, as many heals and twice as many boxes, in a room with as much floor for each as 10 have."""
    base = scenario("10 agents, 10 heals, 20 boxes")
    wider = math.sqrt(agents / 10)
    numbers = base.numbers()
    return base.replace(
        n_agents=agents,
        n_heals=agents,
        n_boxes=2 * agents,
        room_size=numbers["room_size"] * wider,
        room_thickness=max(numbers["room_thickness"] / wider, 0.003),
        spawn_grid_cells=math.ceil(numbers["spawn_grid_cells"] * wider),
        safe_zone_radii=tuple(radius * wider for radius in numbers["safe_zone_radii"]),
    )


def by_threads(name: str, worlds: int = 4096) -> Table:
    """From one thread to as many as there are processors."""
    table = Table("threads", "threads", "world-steps/s", "times one thread")
    counts = [n for n in (1, 2, 4, 8, 16, 32, 64) if n <= (os.cpu_count() or 1)]
    times = alternate([stepper(scenario(name), worlds, threads=n) for n in counts], rounds=9)
    for k, n in enumerate(counts):
        table.add(n, worlds / float(np.median(times[:, k])), float(np.median(times[:, 0] / times[:, k])))
    return table


if __name__ == "__main__":
    main()
