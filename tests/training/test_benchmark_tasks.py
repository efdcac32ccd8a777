"""Tasks never change meaning: their games are as pinned, and fit the protocol."""

import csv
import hashlib
from pathlib import Path

import pytest

from outlast import make_vec
from outlast.envs.errors import UsageError
from outlast.envs.storage.kept_results import ADDRESS

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base.errors import TrainingError
from outlast.training.benchmark.suite import FOLDER, TABLE, suite
from outlast.training.benchmark.tasks import BUDGETS, GAMES, SEEDS, check_training_seed, task_of, tasks, track_of
from tests.conftest import COMPILED
from tests.digests import platform_name
from tests.task_digests import begins, games, goes_on, identity, pinned

VERSION = "the game '{1}' of {0} is another one: give the task a new version; python -m tests.task_digests --write"
EVERY = [(task, name) for task, own in pinned().items() for name in own]


def test_every_task_is_pinned_and_nothing_else() -> None:
    assert {(task.name, name) for task in tasks().values() for name in games(task)} == {*EVERY}


@pytest.mark.parametrize(("task", "name"), EVERY)
def test_a_game_is_the_one_that_its_task_names(task: str, name: str) -> None:
    game = games(task_of(task))[name]
    assert identity(game.scenario) == pinned()[task][name]["fingerprint"], VERSION.format(task, name)


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="its sines are others: see tests/core/test_determinism.py")
@pytest.mark.parametrize(("task", "name"), EVERY)
@pytest.mark.by_day(8)
def test_its_worlds_go_on_as_they_did(task: str, name: str) -> None:
    game, own = games(task_of(task))[name], pinned()[task][name]
    assert begins(game) == own["begins"], VERSION.format(task, name)
    if platform_name() not in own["goes on"]:
        pytest.skip(f"nothing is pinned on {platform_name()}: python -m tests.task_digests --write adds it")
    assert goes_on(game) == own["goes on"][platform_name()], VERSION.format(task, name)


@pytest.mark.parametrize("name", ["numbers-v1", "counts-v1", "agents-v1"])
def test_what_is_tested_outside_is_never_trained_in(name: str) -> None:
    task = task_of(name)
    env = make_vec(task.scenario, 4)
    shapes = {key: array.shape for key, array in env.reset()[0].items()}
    for game in task.games[1:]:
        trained, tested = dict(task.scenario.varied), dict(game.scenario.varied) | dict(game.given)
        apart = [key for key in tested if key in trained and _apart(trained[key], tested[key])]
        assert apart, game.name
        other = make_vec(game.scenario, 4)
        assert {key: array.shape for key, array in other.reset()[0].items()} == shapes
        other.close()
    env.close()


def test_each_side_plays_in_worlds_of_every_count() -> None:
    """Sides alternate from world to world; what worlds are given must not alternate with them."""
    given = [(game.name, game.numbers(320)) for task in tasks().values() for game in task.games if game.given]
    assert len(given) >= 3
    for name, numbers in given:
        for values in numbers.values():
            assert {*values[::2].tolist()} == {*values[1::2].tolist()}, name


def _apart(one: object, other: object) -> bool:
    """Whether no value is of both. other: a distribution, or the values that worlds are given."""
    values = other if isinstance(other, tuple) else other.extremes()  # type: ignore[attr-defined]
    low, high = one.extremes()  # type: ignore[attr-defined]
    return max(values) < low or min(values) > high


def test_worlds_of_tests_are_no_worlds_of_training() -> None:
    """Worlds are keyed by (seed, world): training takes no seed of tests, and no two games of a task share one."""
    for task in tasks().values():
        seeds = [game.seed for game in task.games]
        assert len({*seeds}) == len(seeds)
        assert {*seeds} <= {*SEEDS}
    check_training_seed(SEEDS.start - 1)
    with pytest.raises(TrainingError, match=r"seeds from 2\*\*62 on are kept for the worlds of tests"):
        check_training_seed(SEEDS.start)


def test_tracks_are_budgets_with_all_games() -> None:
    assert [track_of(budget) for budget in BUDGETS.values()] == list(BUDGETS)
    assert track_of(BUDGETS["10M"], GAMES - 2) == track_of(65_536) == ""


def test_an_unknown_task_is_refused_with_a_hint() -> None:
    with pytest.raises(TrainingError, match="there is no task 'ffa_2'; did you mean ffa_2-v1"):
        task_of("ffa_2")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.safetensors")), ids=lambda path: path.stem)
def test_anchors_that_are_shipped_are_of_their_task(path: Path) -> None:
    members = suite(task_of(path.stem))  # which checks the game
    assert sum(member.file is not None for member in members) >= 8


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_the_package_knows_the_checksums_of_anchors() -> None:
    with TABLE.open(newline="") as file:
        known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
    files = {path.stem: hashlib.sha256(path.read_bytes()).hexdigest() for path in FOLDER.glob("*.safetensors")}
    assert known == files
    assert known.keys() == set(tasks())


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_an_installed_outlast_fetches_anchors(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """And plays against no smaller suite where it cannot."""
    expected = suite(task_of("ffa_1-v1"))
    monkeypatch.setattr("outlast.training.benchmark.suite.FOLDER", tmp_path / "nowhere/anchors")
    monkeypatch.setenv(ADDRESS, str(FOLDER.parent))
    assert suite(task_of("ffa_1-v1")) == expected
    monkeypatch.setenv(ADDRESS, str(tmp_path))
    with pytest.raises(UsageError, match=rf"the anchors of ffa_1-v1: .* cannot be read .*: set {ADDRESS}"):
        suite(task_of("ffa_1-v1"))


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_styles_are_beaten_where_flaws_are_mended() -> None:
    """What docs/benchmark.md says of the ratings."""
    assert {path.stem for path in FOLDER.glob("*.safetensors")} == set(tasks())
    for path in FOLDER.glob("*.safetensors"):
        members = suite(task_of(path.stem))
        best = max(member.rating or 0.0 for member in members if member.file is None)
        anchors = {member.name: member.rating or 0.0 for member in members if member.file is not None}
        trained = {name.partition("-")[0]: rating for name, rating in anchors.items() if "steps_0010" in name}
        if path.stem == "numbers-v1":
            assert min(trained.values()) > best
        elif "mended" in path.stem:
            assert trained["pool"] > best, path.stem
        else:
            assert max(anchors.values()) < best, path.stem
