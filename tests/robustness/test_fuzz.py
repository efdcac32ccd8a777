"""Hostile files for each loader, and random scenarios. More: `python -m tests.fuzz`."""

import importlib.util
import re
from pathlib import Path
from random import Random

import numpy as np
import pytest

from outlast.envs.errors import StateError
from tests.fuzz import __main__ as fuzz
from tests.fuzz import scenarios

FILES = {"states": 150, "recordings": 40, "checkpoints": 30, "policies": 60, "results": 120, "plans": 400}
FILES |= {"levels": 300, "games": 60, "roles": 100, "level-states": 100}
NEEDED = ("torch", "tensorboard", "matplotlib")
TORCH = all(importlib.util.find_spec(name) for name in NEEDED)
needs = pytest.mark.skipif(not TORCH, reason=f"needs {', '.join(NEEDED)}")
LOADERS = [pytest.param(name, marks=needs if name in ("checkpoints", "policies", "results") else ()) for name in FILES]


@pytest.mark.parametrize(
    ("loader", "seed", "times"),
    [
        *(pytest.param(*each.values, 1, 1, marks=(*each.marks, pytest.mark.by_day(2))) for each in LOADERS),
        *(pytest.param(*each.values, 2, 10, marks=(*each.marks, pytest.mark.nightly)) for each in LOADERS),
    ],
)
def test_hostile_files_are_refused_or_work(tmp_path: Path, loader: str, seed: int, times: int) -> None:
    """Some must be accepted, or nothing behind loading is tested. A crash leaves its file in tmp_path."""
    count, refusals = times * FILES[loader], 0
    for k, refused, failure in fuzz.outcomes(loader, count, seed, tmp_path):
        assert not failure, f"file {k}: {failure}"
        refusals += refused
    assert 0.2 < refusals / count < 0.95


class Greedy:
    """A loader that takes more memory than it may, and refuses for lack of it."""

    refusals = (StateError,)

    def use(self, path: Path) -> None:
        try:
            np.zeros(2**33, np.uint8)
        except MemoryError as error:
            raise StateError from error


def test_greed_is_a_finding(tmp_path: Path) -> None:
    with fuzz.limited(2**30):
        refused, failure = fuzz.use_file(Greedy(), tmp_path)  # type: ignore[arg-type]
    assert refused
    assert "Unable to allocate" in failure


@pytest.mark.nightly
def test_a_few_random_scenarios_run_equally_or_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of seed 1. More: `python -m tests.fuzz.scenarios`."""
    assert scenarios.main(["--count", "12", "--seed", "1", "--ticks", "60", "--out", str(tmp_path)]) == 0
    assert re.search(r"12 scenarios, \d+ ran, \d+ refused, 0 findings", capsys.readouterr().out)


def test_what_differs_between_two_runs_of_a_scenario_is_a_finding() -> None:
    same, refused = {"digests": ["a", "b"]}, {"digests": ["a"], "refused": "NumberError: 3"}
    assert not scenarios.compared(same, same)
    assert not scenarios.compared(refused, refused)
    assert scenarios.compared(same, {"digests": ["a", "c"]}) == "the state differs after tick 1"
    assert scenarios.compared(refused, same) == "compiled: NumberError: 3\nplain Python: runs"
    assert scenarios.compared(same, {"digests": [], "error": "KeyError"}) == "plain Python: KeyError"


def test_a_file_of_a_seed_is_always_the_same() -> None:
    one, other = (fuzz.target_of("states") for _ in range(2))
    assert [one.mutate(Random(f"0 {k}")) for k in range(20)] == [other.mutate(Random(f"0 {k}")) for k in range(20)]
