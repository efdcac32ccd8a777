"""Other processes and threads: however work is spread, the same seeds give the same bits."""

import multiprocessing
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from conftest import COMPILED, digest, draw_actions

import outlast

WORLDS, STEPS = 20, 30 if COMPILED else 3
SEEDS = [3, 4]


def play(seed: int, threads: int = 1) -> str:
    """Digest of a few worlds after some steps."""
    env, rng = outlast.make_vec("ffa_1", WORLDS, seed=seed, threads=threads), np.random.default_rng(seed)
    env.reset()
    for _ in range(STEPS):
        env.step(draw_actions(env, rng))
    result = digest(env.worlds)
    env.close()
    return result


@pytest.mark.parametrize(
    "method", [m for m in ("fork", "spawn", "forkserver") if sys.platform == "linux" or m == "spawn"]
)
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_workers_of_every_kind_compute_the_same(method: str) -> None:
    """After this process has used threads of its own, which a fork does not inherit."""
    expected = [play(seed, threads=2) for seed in SEEDS]
    with ProcessPoolExecutor(2, multiprocessing.get_context(method)) as pool:
        assert list(pool.map(play, SEEDS, [2, 2])) == expected


def test_environments_in_several_threads() -> None:
    """Each thread steps environments of its own, all at the same time, some of them with threads of their own."""
    seeds = [5, 6, 7, 8]
    expected = [play(seed) for seed in seeds]
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(play, seeds, [1, 2, 1, 3])) == expected


def test_one_environment_from_changing_threads() -> None:
    env, rng = outlast.make_vec("ffa_1", WORLDS, seed=3, threads=2), np.random.default_rng(3)
    env.reset()
    for _ in range(STEPS):
        with ThreadPoolExecutor(1) as pool:
            pool.submit(env.step, draw_actions(env, rng)).result()
    assert digest(env.worlds) == play(3)
