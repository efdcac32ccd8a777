"""Time what levels add to a step: varied numbers, roles, walls and lidar.

    python -m perf.levels [--worlds N] [--rounds N]

Each scenario is timed in turn with the same scenario without the addition.
Where numbers vary or roles differ, they do so in name only: all values are
those of the plain scenario, so that the same game is played, and only the
reading of the numbers is timed. Scenarios with walls are other games.

A step is a whole env.step with random actions, on one thread, of worlds that
are at all steps of their episodes at once. Times are microseconds of CPU time
per world-step in the best round; `ratio` is the median of the rounds' ratios.
"""

import argparse
import time

import numpy as np

from outlast import Scenario, role, variant
from outlast.distributions import choice
from outlast.systems import Lidar, Maze, Pillars, Rooms, Walls
from perf.measure import in_turn, stepper, timer
from perf.table import positive

BLOCKS = 40


def scattered(count: int, seed: int = 0) -> Walls:
    """`count` blocks of 0.4 by 2 m, at random angles all over the paper's room."""
    generator = np.random.default_rng(seed)
    cells = generator.permutation(49)[:count]
    layout = list[float]()
    for cell in cells.tolist():
        x, y = (3.4 * (cell % 7 - 3), 3.4 * (cell // 7 - 3))
        layout += [x, y, 0.4, 2.0, float(generator.uniform(0, np.pi)), 0]
    return Walls(layout=tuple(layout))


def in_name_only(plain: Scenario) -> dict[str, Scenario]:
    """The same game with numbers that vary, and roles that differ, by the values that they have anyway."""
    numbers = plain.numbers()
    five = ("cameras_depth", "melee_damage", "motors_ahead", "motors_turn", "safe_zone_damage")  # of four mechanics
    varied = {name: choice(numbers[name], numbers[name]) for name in five}
    own = {name: numbers[name] for name in five}
    agents = numbers["agents_count"]
    return {
        "melee_damage varies": plain.vary(melee_damage=varied["melee_damage"]),
        "five numbers vary": plain.vary(**varied),
        "agents_count varies": plain.vary(agents_count=choice(agents, agents)),
        "roles without numbers": plain.roles(one=role(1), other=role(), observed=False),
        "roles, melee_damage": plain.roles(one=role(1, melee_damage=own["melee_damage"]), other=role(), observed=False),
        "roles, five numbers": plain.roles(one=role(1, **own), other=role(), observed=False),
    }


def rows() -> list[tuple[str, Scenario, Scenario]]:
    """Return what is measured: a name, the plain scenario, and the one that is compared with it."""
    found = []
    for name in ("ffa_3", "teams_3"):
        plain = variant(name)
        found += [(f"{name}, {what}", plain, other) for what, other in in_name_only(plain).items()]
        found.append((f"{name}, {BLOCKS} blocks", plain, plain.with_(scattered(BLOCKS))))
        found.append((f"{name}, maze of 7 x 7 cells", plain, plain.with_(Maze(columns=7, rows=7, loops=0.0))))
        found.append((f"{name}, 3 x 3 rooms", plain, plain.with_(Rooms())))
        found.append((f"{name}, 12 pillars", plain, plain.with_(Pillars())))
        found.append((f"{name}, lidar of 16 rays", plain, plain.with_(Lidar())))
    return found


def main() -> None:
    """Measure all rows and print a table."""
    parser = argparse.ArgumentParser(
        "python -m perf.levels", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--worlds", type=positive, default=256, help="worlds in a batch (default %(default)s)")
    parser.add_argument("--rounds", type=positive, default=5, help="rounds of measuring (default %(default)s)")
    given = parser.parse_args()
    print(f"{'scenario':<36} {'plain':>8} {'with':>8} {'ratio':>7}")
    for name, *pair in rows():
        timers = [timer(stepper(each, given.worlds), clock=time.process_time) for each in pair]
        times = in_turn(timers, given.rounds) / given.worlds * 1e6
        plain, other = times.min(axis=0)
        print(f"{name:<36} {plain:8.3f} {other:8.3f} {np.median(times[:, 1] / times[:, 0]):7.2f}", flush=True)


if __name__ == "__main__":
    main()
