"""Time every system of a tick by itself, to see where a tick's time goes.

    python -m perf.profile teams_3 [--worlds 1024] [--steps 500]
        [--save MACHINE]

Here, each system runs on all worlds before the next system starts; a real tick
takes a few worlds at a time through all systems. "clock" begins the tick or the
episode. The last row is the whole env.step, with its checks and autoreset.
"""

from outlast.ecs import Worlds
from outlast.ecs.compilation.tick import Segment
from perf.measure import LIMIT, micros, stepper, ticker
from perf.rows import playable
from perf.table import Table, options, positive


def main() -> None:
    """Print microseconds a world-step and share of each system."""
    parser = options(__doc__)
    parser.add_argument(
        "scenario", type=playable, help="what is played: a variant, FILE.py:NAME, or a row of perf.step"
    )
    parser.add_argument("--worlds", type=positive, default=1024, help="number of worlds (default 1024)")
    parser.add_argument("--steps", type=positive, default=500, help="ticks that are timed (default 500)")
    given = parser.parse_args()
    chosen = given.scenario
    worlds = Worlds(chosen.replace(ending_limit=LIMIT).modules, given.worlds, ordered=chosen.order)
    units = [unit for segment in worlds.segments for unit in segment.units]
    worlds.segments = [Segment((unit,), unit.compiled) for unit in units]  # before any of them is loaded
    call = ticker(worlds)
    before = worlds.times.copy()
    for k in range(given.steps):
        call(k)
    times = {label: (s - before[label]) / given.steps / given.worlds * 1e6 for label, s in worlds.times.items()}
    total = sum(times.values())
    table = Table(f"profile-{chosen.file_name}", "system", "us", "share")
    for label, time in times.items():
        table.add(label, time, f"{time / total:.1%}")
    table.add("sum of the parts", total, "")
    table.add("whole step", micros(stepper(chosen, given.worlds), given.worlds), "")
    table.finish(given.save)


if __name__ == "__main__":
    main()
