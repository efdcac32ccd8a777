"""Tasks never change meaning; and matches in short are played again as they were, or forgeries found."""

import csv
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.envs.errors import RecordingError, UsageError
from outlast.envs.storage.kept_results import ADDRESS
from outlast.training.arena.match import Act
from outlast.training.arena.players import Contender
from outlast.training.base import policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark import games, matches, tasks
from outlast.training.benchmark.games import Games
from outlast.training.benchmark.suite import FOLDER, TABLE, suite
from outlast.training.benchmark.tasks import BUDGETS, GAMES, SEEDS, check_training_seed, track_of
from tests.digests import platform_name
from tests.task_digests import begins, goes_on, identity, pinned
from tests.task_digests import games as games_of

VERSION = "the game '{1}' of {0} is another one: give the task a new version; python -m tests.task_digests --write"
EVERY = [(task, name) for task, own in pinned().items() for name in own]


def test_every_task_is_pinned_and_nothing_else() -> None:
    assert {(task.name, name) for task in tasks.tasks().values() for name in games_of(task)} == {*EVERY}


@pytest.mark.parametrize(("task", "name"), EVERY)
def test_a_game_is_the_one_that_its_task_names(task: str, name: str) -> None:
    game = games_of(tasks.task_of(task))[name]
    assert identity(game.scenario) == pinned()[task][name]["fingerprint"], VERSION.format(task, name)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "name"), EVERY)
@pytest.mark.by_day(8)
def test_its_worlds_go_on_as_they_did(task: str, name: str) -> None:
    game, own = games_of(tasks.task_of(task))[name], pinned()[task][name]
    assert begins(game) == own["begins"], VERSION.format(task, name)
    if platform_name() not in own["goes on"]:
        pytest.skip(f"nothing is pinned on {platform_name()}: python -m tests.task_digests --write adds it")
    assert goes_on(game) == own["goes on"][platform_name()], VERSION.format(task, name)


@pytest.mark.parametrize("name", ["numbers-v1", "counts-v1", "agents-v1"])
def test_what_is_tested_outside_is_never_trained_in(name: str) -> None:
    task = tasks.task_of(name)
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
    given = [(game.name, game.numbers(320)) for task in tasks.tasks().values() for game in task.games if game.given]
    assert len(given) >= 3
    for name, numbers in given:
        for values in numbers.values():
            assert {*values[::2].tolist()} == {*values[1::2].tolist()}, name


def _apart(one: object, other: object) -> bool:
    """Whether no value is of both. other: a distribution, or the values that worlds are given."""
    values = other if isinstance(other, tuple) else other.extremes()  # type: ignore[attr-defined]
    low, high = one.extremes()  # type: ignore[attr-defined]
    return max(values) < low or min(values) > high


def test_tasks_keep_to_the_protocol() -> None:
    """Worlds are keyed by (seed, world): training takes no seed of tests, and no two games of a task share one."""
    for task in tasks.tasks().values():
        seeds = [game.seed for game in task.games]
        assert len({*seeds}) == len(seeds)
        assert {*seeds} <= {*SEEDS}
    check_training_seed(SEEDS.start - 1)
    with pytest.raises(TrainingError, match=r"seeds from 2\*\*62 on are reserved for the worlds of tests"):
        check_training_seed(SEEDS.start)
    assert [track_of(budget) for budget in BUDGETS.values()] == list(BUDGETS)
    assert track_of(BUDGETS["10M"], GAMES - 2) == track_of(65_536) == ""
    with pytest.raises(TrainingError, match="unknown task 'ffa_2'; did you mean ffa_2-v1"):
        tasks.task_of("ffa_2")


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_anchors_that_are_shipped_are_of_their_task_and_beat_styles_where_flaws_are_mended() -> None:
    """What docs/evaluating.md says of the ratings; and the package has the checksums of the files."""
    with TABLE.open(newline="") as file:
        known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
    files = {path.stem: hashlib.sha256(path.read_bytes()).hexdigest() for path in FOLDER.glob("*.safetensors")}
    assert known == files
    assert known.keys() == set(tasks.tasks())
    for name in files:
        members = suite(tasks.task_of(name))  # which checks the game
        best = max(member.rating or 0.0 for member in members if member.file is None)
        anchors = {member.name: member.rating or 0.0 for member in members if member.file is not None}
        assert len(anchors) >= 8
        trained = {key.partition("-")[0]: rating for key, rating in anchors.items() if "steps_0010" in key}
        if name == "numbers-v1":
            assert min(trained.values()) > best
        elif "mended" in name:
            assert trained["pool"] > best, name
        else:
            assert max(anchors.values()) < best, name


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_an_installed_outlast_fetches_anchors(monkeypatch, tmp_path: Path) -> None:
    """And plays against no smaller suite where it cannot."""
    expected = suite(tasks.task_of("ffa_1-v1"))
    monkeypatch.setattr("outlast.training.benchmark.suite.FOLDER", tmp_path / "nowhere/anchors")
    monkeypatch.setenv(ADDRESS, str(FOLDER.parent))
    assert suite(tasks.task_of("ffa_1-v1")) == expected
    monkeypatch.setenv(ADDRESS, str(tmp_path))
    with pytest.raises(UsageError, match=rf"the anchors of ffa_1-v1: .* cannot be read .*: set {ADDRESS}"):
        suite(tasks.task_of("ffa_1-v1"))


POLICIES = Path(__file__).parents[2] / "results" / "policies" / "ffa_2"
COUNT = 8
WIDE = 2**-7  # a rounding that is so coarse that many actions are doubtful
OTHER_TICK = r"tick {} is the first that differs when the match is played again"


@pytest.fixture(scope="module")
def game() -> tasks.TaskGame:
    """Episodes of about a hundred steps."""
    short = variant("ffa_2").replace(safe_zone_damage=20, safe_zone_stand=20, safe_zone_shrink=10)
    return tasks._task("short", "short episodes", short).games[0]


@pytest.fixture(scope="module")
def pair() -> list[Contender]:
    return [Contender(name, str(POLICIES / f"{name}-0.safetensors")) for name in ("fast", "original")]


@pytest.fixture(scope="module")
def played(game: tasks.TaskGame, pair: list[Contender], tmp_path_factory: pytest.TempPathFactory) -> tuple[Games, Any]:
    """A match of two policies in short, with doubtful actions, and its outcome."""
    path = tmp_path_factory.mktemp("games") / "a.rec"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matches, "ROUNDING", WIDE)
        outcome = matches.play(game, pair, COUNT, path)
        return games.shorten(game, pair, COUNT, path), outcome


@pytest.fixture(autouse=True)
def coarse(monkeypatch) -> None:
    monkeypatch.setattr(matches, "ROUNDING", WIDE)


@pytest.fixture
def again(game: tasks.TaskGame, pair: list[Contender], tmp_path: Path) -> Callable[..., games.Repeated]:
    """Play a match again from its file."""

    def play(given: Games, pair: list[Contender] = pair) -> games.Repeated:
        given.write(tmp_path / "a.npz")
        return games.repeat(game, pair, COUNT, tmp_path / "a.npz")

    return play


def test_games_are_played_again_as_they_were(played: tuple[Games, Any], again: Any, tmp_path: Path) -> None:
    short, outcome = played
    repeated = again(short)
    assert {key: outcome[key] for key in repeated.outcome} == repeated.outcome
    assert (repeated.differing, repeated.drawn > 500) == (0, True)
    assert 10 < len(short.doubtful) < repeated.drawn / 5
    short.write(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    fewer = replace(short, doubtful=short.doubtful[:0])
    assert again(fewer).outcome == repeated.outcome  # on this machine, nothing is rounded


def altered(short: Games, row: int, actions: Any) -> Games:
    """The games with another doubtful action."""
    doubtful = short.doubtful.copy()
    doubtful[row, games.PLACE :] = actions
    return replace(short, doubtful=doubtful)


def test_what_is_altered_is_found_at_its_tick(pair: Any, played: Any, again: Any, tmp_path: Path) -> None:
    """Other digests, fewer of them, an action of nobody; and other weights as soon as the games are others."""
    short, digests = played[0], played[0].digests.copy()
    digests[[40, 50]] ^= 1
    nobody = np.concatenate([short.doubtful, [[9, COUNT, 0, 1, 1, 1, 0, 0, 0]]])
    for change, words in (
        ({"digests": digests}, OTHER_TICK.format(40)),
        ({"digests": short.digests[:-1]}, OTHER_TICK.format(len(digests) - 1)),
        ({"doubtful": nobody}, "1 of its actions belong to agents that do not act"),
    ):
        with pytest.raises(RecordingError, match=words):
            again(replace(short, **change))
    header, (weights,) = policy_file.read(POLICIES / "fast-0.safetensors")
    weights["actor.last.weight"] = weights["actor.last.weight"] * 1.2
    policy_file.write(tmp_path / "fast-0.safetensors", header, [weights])
    with pytest.raises(RecordingError, match=r"tick \d\b"):
        again(short, [Contender("fast", str(tmp_path / "fast-0.safetensors")), pair[1]])


class Noted(Contender):
    """A policy whose three choices are noted, by tick, world and agent."""

    def __init__(self, policy: Contender, noted: dict[tuple[int, int, int], Any]) -> None:
        super().__init__(policy.label, policy.text)
        self.noted = noted

    def act(self, env: Any, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        act, tick = super().act(env, seed, keyed=keyed, slack=slack), 0

        def noting(seen: dict[str, Any], indices: Any) -> Any:
            nonlocal tick
            tick += 1
            choices = act(seen, indices)
            rows = zip(*indices, np.reshape(choices, (len(choices), 3, -1)), strict=True)
            self.noted |= {(tick, int(world), int(agent)): own for world, agent, own in rows}
            return choices

        return noting


@pytest.fixture(scope="module")
def choices(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path_factory: pytest.TempPathFactory
) -> dict[tuple[int, int, int], Any]:
    """All choices of a match until the first of its games ends: before that, ticks are numbered like calls."""
    noted, path = dict[tuple[int, int, int], Any](), tmp_path_factory.mktemp("noted") / "a.npz"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matches, "ROUNDING", WIDE)
        played[0].write(path)
        games.repeat(game, [Noted(each, noted) for each in pair], COUNT, path)
    return noted


def doubtful(short: Games, choices: dict[Any, Any]) -> tuple[tuple[int, ...], tuple[Any, Any, Any]]:
    """Where the first doubtful action is; the first choice there, one that was not taken, and the last."""
    place = tuple(short.doubtful[0, : games.PLACE].tolist())
    first, choice, last = choices[place]
    return place, (first, first if (first != choice).any() else last, last)


def test_another_choice_within_rounding_is_found(played: Any, choices: Any, again: Any) -> None:
    """Whoever looks for lucky actions has to forge every digest from there on, too: then each counts as differing."""
    place, (_, other, _) = doubtful(played[0], choices)
    with pytest.raises(RecordingError, match=OTHER_TICK.format(place[0])):
        again(altered(played[0], 0, other))


def test_actions_of_another_machine_are_counted(
    game: tasks.TaskGame,
    pair: list[Contender],
    played: tuple[Games, Any],
    choices: dict[Any, Any],
    again: Any,
    tmp_path: Path,
) -> None:
    """Its first doubtful choice was rounded otherwise, and all that followed in that game is as it was there."""
    short, _ = played
    place, (first, other, last) = doubtful(short, choices)

    class There(Contender):
        def act(self, env: Any, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
            act, tick = super().act(env, seed, keyed=keyed, slack=slack), 0

            def acting(seen: dict[str, Any], indices: Any) -> Any:
                nonlocal tick
                tick += 1
                actions = np.array(act(seen, indices))
                where = (indices[0] == place[1]) & (indices[1] == place[2]) & (tick == place[0])
                whole = np.concatenate([first, other, last]) if slack else other
                actions[where] = whole
                return actions

            return acting

    there = [There(each.label, each.text) for each in pair]
    outcome = matches.play(game, there, COUNT, tmp_path / "there.rec")
    repeated = again(games.shorten(game, there, COUNT, tmp_path / "there.rec"))
    assert repeated.outcome == {key: outcome[key] for key in repeated.outcome}
    assert repeated.differing == 1


@pytest.mark.parametrize("row", ["doubtful", "certain"])
def test_an_action_outside_of_rounding_is_found(played: Any, choices: Any, again: Any, row: str) -> None:
    """Of an action that is kept as doubtful, and of one that is put there although it is not."""
    short, _ = played
    certain = (at for at, own in choices.items() if at[0] > 5 and (own[0] == own[2]).all())
    kept = tuple(short.doubtful[0, : games.PLACE].tolist())
    tick, world, agent = place = kept if row == "doubtful" else next(certain)
    wrong = (choices[place][2] + 1) % np.array([3, 3, 3, 2, 2, 2])
    changed = np.where(np.arange(6) == 0, wrong, choices[place][1])
    more = replace(short, doubtful=np.concatenate([short.doubtful, [[*place, *changed]]]))
    with pytest.raises(
        RecordingError, match=rf"did not play this match: in world {world}, tick {tick}, agent {agent} it"
    ):
        again(altered(short, 0, changed) if row == "doubtful" else more)


@pytest.mark.parametrize(
    "change",
    [
        lambda short: {"digests": short.digests, "doubtful": short.doubtful.astype(np.int64)},
        lambda short: {"digests": short.digests[None], "doubtful": short.doubtful},
        lambda short: {"digests": short.digests},
        lambda short: {"digests": short.digests, "doubtful": short.doubtful[:, :-1]},
        None,
    ],
    ids=["types", "axes", "missing", "actions", "text"],
)
def test_a_file_that_holds_no_games_is_refused(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path: Path, change: Any
) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **change(played[0])) if change else path.write_text("text")
    with pytest.raises(
        RecordingError, match=r"a\.npz (is not a file of games: |holds games with a different number of actions)"
    ):
        games.repeat(game, pair, COUNT, path)
