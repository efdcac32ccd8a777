"""Apply Gymnasium's measure of vector environments to outlast and to CartPole.

    python -m perf.vector_step [--worlds 1 256 1024] [--seconds 1]
        [--save MACHINE]

Numbers are steps of single environments per second of wall time, on one thread,
the best of three rounds. `benchmark_vector_step` is the measure of
gymnasium.utils.performance, which includes sampling the actions of every step
from the action space; `drawn ahead` is without that sampling, as in the other
tables. CartPole-v1 is the fastest vector environment of Gymnasium: four
numbers, one action, and all of it in numpy.
"""

import time
from collections.abc import Callable
from typing import Any

import gymnasium
from tqdm import tqdm

import outlast
from perf.interfaces import name
from perf.measure import DRAWS
from perf.table import Table, options, positive

ROUNDS = 3
Make = Callable[[int], Any]
ENVIRONMENTS: dict[str, Make] = {
    "CartPole-v1, gymnasium.make_vec": lambda worlds: gymnasium.make_vec(
        "CartPole-v1", num_envs=worlds, vectorization_mode="vector_entry_point"
    ),
    "ffa_1, make_vec": lambda worlds: outlast.make_vec("ffa_1", worlds),
    "ffa_1, make_vec(copy=False, specialize=True)": lambda worlds: outlast.make_vec(
        "ffa_1", worlds, copy=False, specialize=True
    ),
    "teams_3, make_vec": lambda worlds: outlast.make_vec("teams_3", worlds),
    "teams_3, make_vec(copy=False, specialize=True)": lambda worlds: outlast.make_vec(
        "teams_3", worlds, copy=False, specialize=True
    ),
    "teams_3, gymnasium.make_vec": lambda worlds: gymnasium.make_vec(name("teams_3"), num_envs=worlds, others="random"),
}


def drawn_ahead(env: Any, seconds: float) -> float:
    """Steps a second with actions that were sampled before; the few steps that only reset a world count, too."""
    env.reset(seed=0)
    actions = [env.action_space.sample() for _ in range(DRAWS)]
    start, steps = time.perf_counter(), 0
    while time.perf_counter() - start < seconds:
        for action in actions:
            env.step(action)
        steps += DRAWS * env.num_envs
    return steps / (time.perf_counter() - start)


def measured(sizes: list[int], seconds: float) -> Table:
    """A row for each environment and number of worlds."""
    try:
        from gymnasium.utils.performance import benchmark_vector_step
    except ImportError:
        missing = f"gymnasium {gymnasium.__version__} has no benchmark_vector_step: install 1.4 or newer"
        raise SystemExit(missing) from None
    table = Table("vector_step", "environment", "worlds", "benchmark_vector_step", "drawn ahead")
    for worlds in tqdm(sizes, unit="size"):
        for label, make in ENVIRONMENTS.items():
            env = make(worlds)
            rounds = [
                (benchmark_vector_step(env, seconds, seed=0), drawn_ahead(env, seconds))  # type: ignore[arg-type]
                for _ in range(ROUNDS)
            ]  # its type for seconds is int, but any number will do
            env.close()
            table.add(label, worlds, *(f"{max(rates):,.0f}" for rates in zip(*rounds, strict=True)))
    return table


def main() -> None:
    """Measure and print."""
    parser = options(__doc__)
    text = "numbers of worlds in a batch, each measured (default 1 256 1024)"
    parser.add_argument("--worlds", type=positive, nargs="+", default=[1, 256, 1024], help=text)
    parser.add_argument("--seconds", type=float, default=1.0, help="seconds that each measurement takes (default 1)")
    given = parser.parse_args()
    measured(given.worlds, given.seconds).finish(given.save)


if __name__ == "__main__":
    main()
