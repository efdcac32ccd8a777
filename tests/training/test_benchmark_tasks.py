"""Tasks never change meaning; and matches in short are played again as they were, or forgeries found."""

import csv
import hashlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.envs.errors import RecordingError, UsageError
from outlast.envs.rollout.saved import ADDRESS
from outlast.training.arena.match import Act
from outlast.training.arena.players import Contender
from outlast.training.base import policy_file
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark import games, tasks
from outlast.training.benchmark.games import Moves, Played, play
from outlast.training.benchmark.suite import FOLDER, TABLE, suite
from outlast.training.benchmark.tasks import BUDGETS, GAMES, TEST_SEEDS, VALIDATION_SEED, check_training_seed, track_of
from tests.digests import platform_name
from tests.task_digests import TICKS, identity, observed, pinned
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
    assert observed(game, 0) == own["begins"], VERSION.format(task, name)
    if platform_name() not in own["goes on"]:
        pytest.skip(f"nothing is pinned on {platform_name()}: python -m tests.task_digests --write adds it")
    assert observed(game, TICKS) == own["goes on"][platform_name()], VERSION.format(task, name)


@pytest.mark.parametrize("name", ["numbers-v2", "counts-v2", "agents-v2"])
def test_what_is_tested_outside_is_never_trained_in(name: str) -> None:
    """Nor what checkpoints are chosen by; and tests are beyond that, too."""
    task = tasks.task_of(name)
    env = make_vec(task.scenario, 4)
    shapes = {key: array.shape for key, array in env.reset()[0].items()}
    env.close()
    trained, chosen_by = dict(task.scenario.varied), numbers_of(task.validation)
    for game in (*task.tests[1:], task.validation):
        tested = numbers_of(game)
        assert [key for key in tested if key in trained and _apart(trained[key], tested[key])], game.name
        if game is not task.validation:
            assert [key for key in tested if key in chosen_by and _apart(chosen_by[key], tested[key])], game.name
        other = make_vec(game.scenario, 4)
        assert {key: array.shape for key, array in other.reset()[0].items()} == shapes
        other.close()


def numbers_of(game: tasks.TaskGame) -> dict[str, Any]:
    return dict(game.scenario.varied) | dict(game.given)


def test_each_side_plays_in_worlds_of_every_count() -> None:
    """Sides alternate from world to world; what worlds are given must not alternate with them."""
    given = [game for task in tasks.tasks().values() for game in task.games.values() if game.given]
    assert len(given) >= 3
    for game in given:
        for values in game.numbers(320).values():
            assert {*values[::2].tolist()} == {*values[1::2].tolist()}, game.name


def _apart(one: Any, other: Any) -> bool:
    """Whether no value is of both: of distributions, or of the values that worlds are given."""
    ends = [(min(own), max(own)) if isinstance(own, tuple) else own.extremes() for own in (one, other)]
    (low, high), (least, most) = ends
    return bool(most < low or least > high)


def test_tasks_keep_to_the_protocol() -> None:
    """Worlds are keyed by (seed, world): training takes no seed of tests, and no two games of a task share one."""
    for task in tasks.tasks().values():
        seeds = [game.seed for game in task.games.values()]
        assert len({*seeds}) == len(seeds)
        assert min(seeds) >= TEST_SEEDS.start
        assert task.validation.seed == VALIDATION_SEED
    check_training_seed(TEST_SEEDS.start - 1)
    with pytest.raises(TrainingError, match=r"seeds from 2\*\*62 on are reserved for the worlds of tests"):
        check_training_seed(TEST_SEEDS.start)
    assert [track_of(budget) for budget in BUDGETS.values()] == list(BUDGETS)
    assert track_of(BUDGETS["10M"], GAMES - 2) == track_of(65_536) == ""
    mates = [name for name, task in tasks.tasks().items() if task.mates]
    assert mates == ["teams_2-v2", "teams_3-v2", "teams_3-mended-v2"]
    with pytest.raises(TrainingError, match=r"unknown task 'teams_2'; did you mean .*teams_2-v2"):
        tasks.task_of("teams_2")


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_the_strongest_anchor_beats_every_style() -> None:
    """In every task; and the package has the checksums of the files."""
    with TABLE.open(newline="") as file:
        known = {row["task"]: row["sha256"] for row in csv.DictReader(file)}
    files = {path.stem: hashlib.sha256(path.read_bytes()).hexdigest() for path in FOLDER.glob("*.safetensors")}
    assert known == files
    assert known.keys() == set(tasks.tasks())
    for name in files:
        members = suite(tasks.task_of(name)).members.values()  # which checks the game
        anchors, styles = ([own.rating or 0.0 for own in members if (own.anchor is None) == k] for k in (False, True))
        assert len(anchors) >= 4
        assert anchors == sorted(anchors)
        assert anchors[-1] > max(styles), name


@pytest.mark.skipif(not FOLDER.is_dir(), reason="results are not part of this archive")
def test_an_installed_outlast_fetches_anchors(monkeypatch, tmp_path: Path) -> None:
    """And plays against no smaller suite where it cannot."""
    expected = suite(tasks.task_of("ffa_2-v2"))
    monkeypatch.setattr("outlast.training.benchmark.suite.FOLDER", tmp_path / "nowhere/anchors")
    monkeypatch.setenv(ADDRESS, str(FOLDER.parent))
    assert suite(tasks.task_of("ffa_2-v2")).digest == expected.digest
    monkeypatch.setenv(ADDRESS, str(tmp_path))
    with pytest.raises(UsageError, match=rf"the anchors of ffa_2-v2: .* cannot be read .*: set {ADDRESS}"):
        suite(tasks.task_of("ffa_2-v2"))


POLICIES = Path(__file__).parents[2] / "results" / "policies" / "ffa_2"
COUNT = 8
WIDE = 2**-7  # a rounding that is so coarse that many actions are doubtful
OTHER_TICK = r"tick {} is the first that differs when the match is played again"
Choices = dict[tuple[int, int, int], Any]  # first, own and last choice, by tick, world and agent


PAIR = [Contender(name, str(POLICIES / f"{name}-0.safetensors")) for name in ("fast", "original")]


@pytest.fixture(scope="module", autouse=True)
def coarse() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(games, "ROUNDING", WIDE)
        yield


def again(moves: Moves | None, pair: list[Contender] = PAIR) -> Played:
    """A match in episodes of about a hundred steps."""
    short = variant("ffa_2").replace(safe_zone_damage=20, safe_zone_stand=20, safe_zone_shrink=10)
    return play(tasks._game("short", short, 0), pair, COUNT, moves)


@pytest.fixture(scope="module")
def played(coarse: None) -> Played:
    """A match of two policies, with doubtful actions."""
    return again(None)


def test_games_are_played_again_as_they_were(played: Played, tmp_path: Path) -> None:
    found = again(played.moves)
    assert found.outcome == played.outcome
    assert (found.differing, found.drawn > 500) == (0, True)
    assert 10 < len(played.moves.doubtful) < found.drawn / 5
    one, two = (moves.write(tmp_path / name) for moves, name in ((played.moves, "a.npz"), (found.moves, "b.npz")))
    assert one == two
    read = Moves.read(tmp_path / "a.npz")
    assert all(np.array_equal(getattr(read, name), getattr(played.moves, name)) for name in games.FORM)
    fewer = replace(played.moves, doubtful=played.moves.doubtful[:0])
    assert again(fewer).outcome == played.outcome  # on this machine, nothing is rounded


def test_a_third_policy_plays_the_mates_of_the_first(played: Played) -> None:
    """In its side, and the first one in each seat as often; every game counts."""
    outcome = played.outcome
    assert outcome["won"] + outcome["drawn"] + outcome["lost"] == COUNT
    teams = tasks._game("teams", variant("teams_2").replace(safe_zone_damage=20), 0)
    styles = [Contender(name, name) for name in ("scripted", "random", "noop")]
    seated = list[Any]()

    class Seen(Contender):
        def act(self, env: Any, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
            act = super().act(env, seed, keyed=keyed, slack=slack)
            return lambda seen, indices: seated.append((self.text, *indices)) or act(seen, indices)

    play(teams, [Seen(each.label, each.text) for each in styles], COUNT)
    first = {name: set(zip(worlds.tolist(), agents.tolist(), strict=True)) for name, worlds, agents in seated[:3]}
    assert {name: len(own) for name, own in first.items()} == {"scripted": 8, "random": 16, "noop": 8}
    sides = {(world, agent): agent // 2 for world in range(COUNT) for agent in range(4)}
    for world in range(COUNT):
        (own,) = [sides[place] for place in first["scripted"] if place[0] == world]
        assert [sides[place] for place in first["noop"] if place[0] == world] == [own]
        assert {sides[place] for place in first["random"] if place[0] == world} == {1 - own}
    assert {agent for _, agent in first["scripted"]} == {0, 1, 2, 3}  # each seat as often


def test_what_is_altered_is_found_at_its_tick(played: Played, tmp_path: Path) -> None:
    """Other digests, fewer of them, an action of nobody; and other weights as soon as the games are others."""
    moves, digests = played.moves, played.moves.digests.copy()
    digests[[40, 50]] ^= 1
    nobody = np.concatenate([moves.doubtful, [[9, COUNT, 0, 1, 1, 1, 0, 0, 0]]])
    for change, words in (
        ({"digests": digests}, OTHER_TICK.format(40)),
        ({"digests": moves.digests[:-1]}, OTHER_TICK.format(len(digests) - 1)),
        ({"digests": np.append(moves.digests, moves.digests[:1])}, "its file holds ticks or actions that the games do"),
        ({"doubtful": nobody}, "its file holds ticks or actions that the games do not have"),
        ({"doubtful": moves.doubtful[:, :-1]}, "holds games with a different number of actions"),
    ):
        with pytest.raises(RecordingError, match=words):
            again(replace(moves, **change))
    header, (weights,) = policy_file.read(POLICIES / "fast-0.safetensors")
    weights["actor.last.weight"] = weights["actor.last.weight"] * 1.2
    policy_file.write(tmp_path / "fast-0.safetensors", header, [weights])
    with pytest.raises(RecordingError, match=r"tick \d\b"):
        again(moves, [Contender("fast", str(tmp_path / "fast-0.safetensors")), PAIR[1]])


class Noted(Contender):
    """A policy whose three choices are noted, and changed where `instead` has others."""

    def __init__(self, policy: Contender, noted: Choices, instead: Choices | None = None) -> None:
        super().__init__(policy.label, policy.text)
        self.noted, self.instead = noted, instead or {}

    def act(self, env: Any, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        act, tick = super().act(env, seed, keyed=keyed, slack=slack), 0

        def noting(seen: dict[str, Any], indices: Any) -> Any:
            nonlocal tick
            tick += 1
            choices = np.reshape(act(seen, indices), (len(indices[0]), 3, -1))
            for k, (world, agent) in enumerate(zip(*map(np.ndarray.tolist, indices), strict=True)):
                choices[k] = self.instead.get((tick, world, agent), choices[k])
                self.noted[tick, world, agent] = choices[k].copy()
            return choices.reshape(len(choices), -1)

        return noting


@pytest.fixture(scope="module")
def choices(played: Played) -> Choices:
    """All choices of a match until the first of its games ends: before that, ticks are numbered like calls."""
    noted: Choices = {}
    again(played.moves, [Noted(each, noted) for each in PAIR])
    return noted


def doubtful(moves: Moves, choices: Choices) -> tuple[tuple[int, int, int], Any]:
    """Where the first doubtful action is; the choice there that was not taken."""
    tick, world, agent = moves.doubtful[0, : games.PLACE].tolist()
    first, choice, last = choices[tick, world, agent]
    return (tick, world, agent), first if (first != choice).any() else last


def test_actions_of_another_machine_are_counted(played: Played, choices: Choices) -> None:
    """Its first doubtful choice was rounded otherwise, and all that followed in that game is as it was there."""
    place, other = doubtful(played.moves, choices)
    first, _, last = choices[place]
    there = again(None, [Noted(each, {}, {place: np.stack([first, other, last])}) for each in PAIR])
    found = again(there.moves)
    assert found.outcome == there.outcome
    assert found.differing == 1


@pytest.mark.parametrize("row", ["within", "doubtful", "certain"])
def test_another_action_is_found(played: Played, choices: Choices, row: str) -> None:
    """Within rounding, by its digest; beyond it, of an action that is kept as doubtful or put there although it is not.

    Whoever looks for lucky actions within rounding has to forge every digest from there on: then each is counted.
    """
    kept, certain = played.moves.doubtful.copy(), (at for at, own in choices.items() if (own[0] == own[2]).all())
    place, other = doubtful(played.moves, choices)
    message = OTHER_TICK.format(place[0])
    if row != "within":
        tick, world, agent = place = place if row == "doubtful" else next(at for at in certain if at[0] > 5)
        message = rf"did not play this match: in world {world}, tick {tick}, agent {agent} it"
        wrong = (choices[place][2] + 1) % np.array([3, 3, 3, 2, 2, 2])
        other = np.where(np.arange(6) == 0, wrong, choices[place][1])
    if row == "certain":
        kept = np.concatenate([kept, [[*place, *other]]])
    else:
        kept[0, games.PLACE :] = other
    with pytest.raises(RecordingError, match=message):
        again(replace(played.moves, doubtful=kept))


@pytest.mark.parametrize(
    "change",
    [
        lambda own: own | {"doubtful": own["doubtful"].astype(np.int64)},
        lambda own: own | {"digests": own["digests"][None]},
        lambda own: {"digests": own["digests"]},
        None,
    ],
)
def test_a_file_that_holds_no_games_is_refused(played: Played, tmp_path: Path, change: Any) -> None:
    path = tmp_path / "a.npz"
    own = {name: getattr(played.moves, name) for name in games.FORM}
    np.savez(path, **change(own)) if change else path.write_text("text")
    with pytest.raises(RecordingError, match=r"a\.npz is not a file of games: "):
        Moves.read(path)
