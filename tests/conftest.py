"""What all tests share: how they run, and what it means that two environments are the same."""

import hashlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numba
import numpy as np
import pytest

from outlast.ecs import Worlds
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import Policy, noop_policy

COMPILED = not numba.config.DISABLE_JIT


def if_compiled(mark: Any) -> Any:
    """The mark for a test of which the compilation is what takes long; as plain Python it is a fast one."""
    return mark if COMPILED else lambda test: test


slow_compiled, nightly_compiled = if_compiled(pytest.mark.slow), if_compiled(pytest.mark.nightly)


def few_by_day(names: Iterable[str], few: tuple[str, ...]) -> list[Any]:
    """Parameters of a test: of these names, all but the few are for the night."""
    return [name if name in few else pytest.param(name, marks=pytest.mark.nightly) for name in names]


def scaled(count: int, least: int = 1) -> int:
    """`count`, or a hundredth of it (but `least`) where kernels run as plain Python, which is that much slower."""
    return count if COMPILED else max(least, count // 100)


def digest(worlds: Worlds, where: Any = slice(None)) -> str:
    """Of every byte of the worlds `where`: their state, and the buffers of actions, observations and signals."""
    total = hashlib.blake2b(worlds.block[where].tobytes(), digest_size=16)
    for component in worlds.components:
        if not component.packed:
            for column in worlds[component]:
                total.update(column[where].tobytes())
    return total.hexdigest()


def draw_actions(env: SurvivalVectorEnv, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    """Uniformly random actions for every agent of every world."""
    sizes = env.single_action_space.nvec
    return rng.integers(0, sizes, (env.num_worlds, *sizes.shape))


def interrupted_after(calls: int) -> Callable[[SurvivalVectorEnv, int], Policy]:
    """A policy for POLICIES that does nothing, and at its next call after so many is as if Ctrl-C were pressed."""

    def make(env: SurvivalVectorEnv, seed: int) -> Policy:
        left, idle = iter(range(calls)), noop_policy(env, seed)

        def act(observations: Any) -> Any:
            if next(left, None) is None:
                raise KeyboardInterrupt
            return idle(observations)

        return act

    return make


@pytest.fixture
def one_torch_thread() -> Iterator[None]:
    """For small networks: more threads wait for each other, above all where other tests run beside."""
    import torch  # here, as most tests do without

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
