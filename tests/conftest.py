"""What all tests share: marks and sizes by mode, digests, actions, and fixtures."""

import hashlib
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import numba
import numpy as np
import pytest

from outlast.ecs.declarations.event import zero_unused
from outlast.ecs.memory.tables import Tables
from outlast.ecs.running import compiled_game
from outlast.envs.cli import main as cli
from outlast.envs.cli.grammar import Parser
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import Policy, noop_policy

# Shells let background processes, and their children, ignore Ctrl-C, which some tests send.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN and threading.current_thread() is threading.main_thread():
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests of what repeats the paper, which is in the repository only, not in a package that was installed.
OF_RESEARCH = ("docs/test_site.py", "robustness/test_hostile_results.py")
OF_RESEARCH += tuple(f"training/test_{name}.py" for name in ("compare_runs", "paper", "plot"))
collect_ignore = [] if find_spec("outlast.training.research") else [*OF_RESEARCH]

COMPILED = not numba.config.DISABLE_JIT

compiled_only = pytest.mark.skipif(not COMPILED, reason="about machine code")
# Marks of tests that are slow only because they compile; as plain Python they have none.
slow_compiled, nightly_compiled = (pytest.mark.slow, pytest.mark.nightly) if COMPILED else (lambda test: test,) * 2


@pytest.hookimpl(tryfirst=True)  # before pytest itself chooses by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as nightly the cases that the mark `by_day(count)` leaves out; those that stay are spread evenly."""
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("by_day"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for each in cases.values():
        count = min(each[0].get_closest_marker("by_day").args[0], len(each))
        chosen = {k * len(each) // count for k in range(count)}
        for k in {*range(len(each))} - chosen:
            each[k].add_marker(pytest.mark.nightly)


def few_by_day(names: Iterable[str], few: tuple[str, ...]) -> list[Any]:
    """Parameters of a test: all names but the few are nightly. See also the mark by_day, which counts."""
    return [name if name in few else pytest.param(name, marks=pytest.mark.nightly) for name in names]


def scaled(count: int, least: int = 1) -> int:
    """`count`, or a hundredth of it (at least `least`) where kernels run as plain Python, which is that much slower."""
    return count if COMPILED else max(least, count // 100)


def digest(worlds: Tables, where: Any = slice(None), but: tuple[type, ...] = ()) -> str:
    """A digest of every byte of the worlds `where`: state, events, and buffers of components except `but`."""
    zero_unused(worlds.layout.events, worlds.event_memory)
    total = hashlib.blake2b(worlds.block[where].tobytes(), digest_size=16)
    for component in worlds.components:
        if not component.packed and not issubclass(component, but):
            for column in worlds[component]:
                total.update(column[where].tobytes())
    return total.hexdigest()


def draw_actions(env: SurvivalVectorEnv, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    """Uniformly random actions for every agent of every world."""
    sizes = env.single_action_space.nvec
    return rng.integers(0, sizes, (env.num_worlds, *sizes.shape))


def interrupted_after(calls: int, number: int = signal.SIGINT) -> Callable[[SurvivalVectorEnv, int], Policy]:
    """A policy for POLICIES that does nothing and, after `calls` calls, raises a signal in this process."""

    def make(env: SurvivalVectorEnv, seed: int) -> Policy:
        remaining, idle = iter(range(calls)), noop_policy(env, seed)

        def act(observations: Any) -> Any:
            if next(remaining, None) is None:
                signal.raise_signal(number)
            return idle(observations)

        return act

    return make


def run(capsys: Any, *arguments: object) -> tuple[int, str, str]:
    """Run a command of outlast; returns its status, stdout and stderr."""
    status = cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def call(command: ModuleType, *words: object) -> int:
    """Run the command that a module adds, even if its entry point is not installed; returns its status."""
    parser = Parser()
    command.add(parser.add_subparsers())
    options = parser.parse_args([command.__name__.rpartition(".")[2], *map(str, words)])
    return int(options.run(options) or 0)


@pytest.fixture
def untried(monkeypatch: pytest.MonkeyPatch) -> None:
    """No trial of users' systems when worlds are made: what they do is left to machine code and to real runs."""
    monkeypatch.setattr(compiled_game, "try_out", lambda *_: None)


@pytest.fixture
def one_torch_thread() -> Iterator[None]:
    """One thread for small networks: more would wait for each other, above all beside other tests."""
    torch = pytest.importorskip("torch", reason="needs PyTorch: outlast[train]")  # slow to load, and seldom needed

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
