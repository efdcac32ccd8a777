"""Processes and threads: however work is distributed, the same seeds give the same bits."""

import copy
import functools
import multiprocessing
import os
import pickle
import signal
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest

import outlast
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import PendingError
from tests.conftest import digest, draw_actions

WORLDS, STEPS = 20, 30
SEEDS = [3, 4]
METHODS = [m for m in ("fork", "spawn", "forkserver") if sys.platform == "linux" or m == "spawn"]
pytestmark = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")


def go_on(env: SurvivalVectorEnv, seed: int) -> str:
    """Digest after some steps from its current state."""
    rng = np.random.default_rng(seed)
    for _ in range(STEPS):
        env.step(draw_actions(env, rng))
    return digest(env.worlds)


def play(seed: int, threads: int = 1) -> str:
    """Digest of a few worlds after some steps."""
    env = outlast.make_vec("ffa_1", WORLDS, seed=seed, threads=threads)
    env.reset()
    result = go_on(env, seed)
    env.close()
    return result


def made(pickled: bytes, state: bytes) -> str:
    """Digest after some steps of an environment, from a pickle of its maker and one of its state."""
    env = pickle.loads(pickled)()
    env.set_state(pickle.loads(state))
    return go_on(env, 1)


# ---- processes


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.by_day(1)
def test_workers_of_every_kind_compute_the_same(method: str) -> None:
    """After this process has used threads, which a fork does not inherit."""
    expected = [play(seed, threads=2) for seed in SEEDS]
    with ProcessPoolExecutor(2, multiprocessing.get_context(method)) as pool:
        assert list(pool.map(play, SEEDS, [2, 2])) == expected


def in_fork(call: Callable[[], str]) -> str:
    """The result of a call in a fork of this process, which is killed if it hangs."""
    reading, writing = os.pipe()
    if (child := os.fork()) == 0:
        signal.alarm(60)
        try:
            os.write(writing, call().encode())
        except BaseException as error:
            os.write(writing, repr(error).encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        result = pipe.read()
    os.waitpid(child, 0)
    return result


def used(**options: Any) -> SurvivalVectorEnv:
    """An environment whose threads have been used."""
    env = outlast.make_vec("ffa_1", WORLDS, seed=3, threads=2, **options)
    env.reset()
    env.send(np.ones((WORLDS, 2, 6), int))
    env.recv()
    return env


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_goes_on_with_the_environment() -> None:
    env = used()

    def sending() -> str:
        rng = np.random.default_rng(7)
        for _ in range(STEPS):
            env.send(draw_actions(env, rng))
            env.recv()
        env.close()
        return digest(env.worlds)

    before = digest(env.worlds)
    found = [in_fork(lambda: go_on(env, 7)), in_fork(sending)]
    assert digest(env.worlds) == before
    assert found == [go_on(env, 7)] * 2


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_fork_does_not_wait_for_a_step_that_it_did_not_send() -> None:
    env = used()
    env.send(np.ones((WORLDS, 2, 6), int))
    assert "sent by another process" in in_fork(lambda: str(env.recv()))
    assert "sent by another process" in in_fork(lambda: str(env.reset()))
    assert in_fork(lambda: str(env.close())) == "None"
    env.recv()


# ---- pickles


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.by_day(1)
def test_what_makes_an_environment_can_be_pickled(method: str) -> None:
    env = used()
    makers = [functools.partial(outlast.make_vec, each, WORLDS, seed=9) for each in ("ffa_1", env.scenario)]
    state, picklers = env.get_state(), (pickle, cloudpickle)
    pickles = [(pickler.dumps(make), pickler.dumps(state)) for pickler in picklers for make in makers]
    with ProcessPoolExecutor(1, multiprocessing.get_context(method)) as pool:
        found = list(pool.map(made, *zip(*pickles, strict=True)))
    assert found == [go_on(env, 1)] * 4


@pytest.mark.parametrize("way", [pickle.dumps, cloudpickle.dumps, copy.copy, copy.deepcopy])
def test_an_environment_itself_cannot(way: Callable[[Any], Any]) -> None:
    env = used()
    before = digest(env.worlds)
    with pytest.raises(TypeError, match=r"cannot be pickled or copied; .*partial\(outlast\.make_vec.*get_state\(\)"):
        way(env)
    assert digest(env.worlds) == before


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.by_day(1)
def test_gymnasium_spreads_single_environments_over_processes(method: str) -> None:
    spec = pickle.loads(pickle.dumps(gymnasium.spec("outlast/FreeForAll1-v1")))
    spec = gymnasium.envs.registration.EnvSpec.from_json(spec.to_json())
    make = functools.partial(gymnasium.make, spec)
    kinds = (functools.partial(gymnasium.vector.AsyncVectorEnv, context=method), gymnasium.vector.SyncVectorEnv)
    outcomes = []
    for kind in kinds:
        envs = kind([make, make])
        arrays = [envs.reset(seed=SEEDS)[0]]
        for _ in range(STEPS):
            observations, reward, *_ = envs.step(np.ones((2, 6), int))
            arrays += [observations, reward]
        outcomes.append(copy.deepcopy(arrays))
        envs.close()
    np.testing.assert_equal(*outcomes)


# ---- threads


def test_environments_in_several_threads() -> None:
    seeds = list(range(5, 13))
    expected = [play(seed) for seed in seeds]
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(play, seeds, [1, 2, 1, 3] * 2)) == expected


def test_while_a_thread_is_in_a_call_no_other_call_is_let_in() -> None:
    env = used()
    actions = np.ones((WORLDS, 2, 6), int)
    state, before = env.get_state(), digest(env.worlds)
    calls: list[Callable[[], Any]] = [
        lambda: env.step(actions), lambda: env.send(actions), env.reset, env.observe, env.render, env.get_state,
        lambda: env.set_state(state),
    ]  # fmt: skip
    env._guard.enter()
    with ThreadPoolExecutor(1) as pool:
        for call in calls:
            with pytest.raises(PendingError, match="another thread is in a call of this environment"):
                pool.submit(call).result()
    env._guard.inside.clear()
    assert digest(env.worlds) == before
    go_on(env, 1)
