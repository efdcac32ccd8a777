"""A few hostile files for each loader, and the fuzzer on files with known effects. More: `python -m tests.fuzz`."""

import importlib.util
import re
from pathlib import Path
from random import Random

import pytest

from tests.conftest import COMPILED, scaled
from tests.fuzz import __main__ as fuzz
from tests.fuzz import scenarios
from tests.fuzz.traps import BEHAVIOURS, Traps

FILES = {"states": 150, "recordings": 40, "checkpoints": 30, "policies": 60, "results": 120, "plans": 400}
FILES |= {"levels": 300, "games": 60, "roles": 100, "level-states": 100}
NEEDED = ("torch", "tensorboard", "matplotlib")
TORCH = all(importlib.util.find_spec(name) for name in NEEDED)
needs = pytest.mark.skipif(not TORCH, reason=f"needs {', '.join(NEEDED)}")
LOADERS = [
    pytest.param(name, marks=needs) if name in ("checkpoints", "policies", "results") else name for name in FILES
]


@pytest.mark.parametrize("loader", LOADERS)
@pytest.mark.by_day(2)
def test_a_few_hostile_files_are_refused_or_work(tmp_path: Path, loader: str) -> None:
    """In this process; the first files of seed 1."""
    task, path = fuzz.Task(loader, scaled(FILES[loader], 2), 1, 0), tmp_path / "file"
    target, refused = task.target, 0
    for k in range(task.files):
        path.write_bytes(target.mutate(Random(f"{task.seed} {k}")))
        was_refused, failure = fuzz.use_file(target, path)
        assert not failure, f"file {k}: {failure}"
        refused += was_refused
    assert (
        not COMPILED or 0.2 < refused / task.files < 0.95
    )  # some must be accepted, or nothing after loading is tested


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="runs plain Python, too")
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


@pytest.mark.nightly
@pytest.mark.parametrize("loader", LOADERS)
def test_many_hostile_files_are_refused_or_work(tmp_path: Path, loader: str) -> None:
    assert fuzz.main([loader, "--files", str(scaled(10 * FILES[loader])), "--seed", "2", "--out", str(tmp_path)]) == 0


def test_crashes_exceptions_and_greed_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And nothing else; files and tracebacks are kept."""
    behaviours = dict(enumerate(Traps().mutate(Random(f"14 {k}")) for k in range(8)))
    assert set(behaviours.values()) == set(BEHAVIOURS)
    reasons = {
        b"raises": "KeyError",
        b"crashes": "-11",
        b"eats": "Unable to allocate",
        b"eats and refuses": "StateError",
    }
    bad = {k: reasons[behaviour] for k, behaviour in behaviours.items() if behaviour in reasons}
    assert fuzz.main(["traps", "--files", "8", "--seed", "14", "--out", str(tmp_path)]) == 1
    assert {path.name for path in tmp_path.glob("*.file")} == {f"traps-14-{k}.file" for k in bad}
    for k, reason in bad.items():
        assert (tmp_path / f"traps-14-{k}.file").read_bytes() == behaviours[k]
        assert reason in (tmp_path / f"traps-14-{k}.txt").read_text()
    output = capsys.readouterr().out
    assert f"traps, seed 14: 8 files, 1 refused, 3 accepted\n{len(bad)} findings" in output


def test_a_file_of_a_seed_is_always_the_same() -> None:
    one, other = (fuzz.Task("states", 1, 0, 0).target for _ in range(2))
    assert [one.mutate(Random(f"0 {k}")) for k in range(20)] == [other.mutate(Random(f"0 {k}")) for k in range(20)]
