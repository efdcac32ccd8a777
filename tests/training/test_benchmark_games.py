"""Matches in short: they are played again as they were, and each forgery is found with its place."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast import variant
from outlast.envs.errors import RecordingError
from outlast.training.arena.match import Act
from outlast.training.arena.players import Contender
from outlast.training.base import policy_file
from outlast.training.benchmark import games, matches, tasks
from outlast.training.benchmark.games import Games

pytestmark = pytest.mark.usefixtures("one_torch_thread")

POLICIES = Path(__file__).parents[2] / "results" / "policies" / "ffa_2"
COUNT = 8
WIDE = 2**-7  # a rounding that is so coarse that many actions are doubtful
OTHER_TICK = r"tick {} is the first that is not as it is when the match is played again"


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
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(matches, "ROUNDING", WIDE)


def again(game: tasks.TaskGame, pair: list[Contender], given: Games, folder: Path) -> games.Repeated:
    """Play a match again from its file."""
    given.write(folder / "a.npz")
    return games.repeat(game, pair, COUNT, folder / "a.npz")


def test_games_are_played_again_as_they_were(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path: Path
) -> None:
    short, outcome = played
    repeated = again(game, pair, short, tmp_path)
    assert {key: outcome[key] for key in repeated.outcome} == repeated.outcome
    assert (repeated.differing, repeated.drawn > 500) == (0, True)
    assert 10 < len(short.doubtful) < repeated.drawn / 5
    short.write(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    fewer = replace(short, doubtful=short.doubtful[:0])
    assert again(game, pair, fewer, tmp_path).outcome == repeated.outcome  # on this machine, nothing is rounded


def altered(short: Games, row: int, actions: Any) -> Games:
    """The games with another doubtful action."""
    doubtful = short.doubtful.copy()
    doubtful[row, games.PLACE :] = actions
    return replace(short, doubtful=doubtful)


def test_an_altered_digest_is_found(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path: Path
) -> None:
    digests = played[0].digests.copy()
    digests[[40, 50]] ^= 1
    with pytest.raises(RecordingError, match=OTHER_TICK.format(40)):
        again(game, pair, replace(played[0], digests=digests), tmp_path)
    with pytest.raises(RecordingError, match=OTHER_TICK.format(len(digests) - 1)):
        again(game, pair, replace(played[0], digests=played[0].digests[:-1]), tmp_path)


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
    noted = dict[tuple[int, int, int], Any]()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(matches, "ROUNDING", WIDE)
        again(game, [Noted(each, noted) for each in pair], played[0], tmp_path_factory.mktemp("noted"))
    return noted


def doubtful(short: Games, choices: dict[Any, Any]) -> tuple[tuple[int, ...], tuple[Any, Any, Any]]:
    """Where the first doubtful action is; the first choice there, one that was not taken, and the last."""
    place = tuple(short.doubtful[0, : games.PLACE].tolist())
    first, choice, last = choices[place]
    return place, (first, first if (first != choice).any() else last, last)


def test_another_choice_within_rounding_is_found_by_the_digest(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], choices: dict[Any, Any], tmp_path: Path
) -> None:
    """Whoever looks for lucky actions has to forge every digest from there on, too: then each counts as differing."""
    short, _ = played
    place, (_, other, _) = doubtful(short, choices)
    forged = altered(short, 0, other)
    with pytest.raises(RecordingError, match=OTHER_TICK.format(place[0])):
        again(game, pair, forged, tmp_path)


def test_actions_of_another_machine_are_counted(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], choices: dict[Any, Any], tmp_path: Path
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
    repeated = again(game, pair, games.shorten(game, there, COUNT, tmp_path / "there.rec"), tmp_path)
    assert repeated.outcome == {key: outcome[key] for key in repeated.outcome}
    assert repeated.differing == 1


@pytest.mark.parametrize("row", ["doubtful", "certain"])
def test_an_action_outside_of_rounding_is_found(
    game: tasks.TaskGame,
    pair: list[Contender],
    played: tuple[Games, Any],
    choices: dict[Any, Any],
    tmp_path: Path,
    row: str,
) -> None:
    """Of an action that is kept as doubtful, and of one that is put there although it is not."""
    short, _ = played
    if row == "doubtful":
        place = tuple(short.doubtful[0, : games.PLACE].tolist())
    else:
        place = next(place for place, own in choices.items() if place[0] > 5 and (own[0] == own[2]).all())
    wrong = (choices[place][2] + 1) % np.array([3, 3, 3, 2, 2, 2])
    changed = np.where(np.arange(6) == 0, wrong, choices[place][1])
    if row == "doubtful":
        forged = altered(short, 0, changed)
    else:
        forged = replace(short, doubtful=np.concatenate([short.doubtful, [[*place, *changed]]]))
    tick, world, agent = place
    with pytest.raises(RecordingError, match=rf"did not play it: in world {world}, tick {tick}, agent {agent} it"):
        again(game, pair, forged, tmp_path)


def test_an_action_of_nobody_is_found(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path: Path
) -> None:
    short, _ = played
    forged = replace(short, doubtful=np.concatenate([short.doubtful, [[9, COUNT, 0, 1, 1, 1, 0, 0, 0]]]))
    with pytest.raises(RecordingError, match="1 of its actions are of agents that do not act there"):
        again(game, pair, forged, tmp_path)


def test_other_weights_are_found_at_their_first_tick(
    game: tasks.TaskGame, pair: list[Contender], played: tuple[Games, Any], tmp_path: Path
) -> None:
    """Not only at a later action that is outside of rounding, as the games are others by then."""
    header, (weights,) = policy_file.read(POLICIES / "fast-0.safetensors")
    weights["actor.last.weight"] = weights["actor.last.weight"] * 1.2
    policy_file.write(tmp_path / "fast-0.safetensors", header, [weights])
    with pytest.raises(RecordingError) as found:
        again(game, [Contender("fast", str(tmp_path / "fast-0.safetensors")), pair[1]], played[0], tmp_path)
    tick = re.search(r"tick (\d+)", str(found.value))
    assert tick is not None
    assert int(tick[1]) < 10


@pytest.mark.parametrize(
    "change",
    [
        lambda short: {"digests": short.digests, "doubtful": short.doubtful.astype(np.int64)},
        lambda short: {"digests": short.digests[None], "doubtful": short.doubtful},
        lambda short: {"digests": short.digests},
        lambda short: {"digests": short.digests, "doubtful": short.doubtful[:, :-1]},
        lambda short: None,
    ],
    ids=["types", "axes", "missing", "actions", "text"],
)
def test_a_file_that_holds_no_games_is_refused(
    game: tasks.TaskGame,
    pair: list[Contender],
    played: tuple[Games, Any],
    tmp_path: Path,
    change: Callable[[Games], dict[str, Any] | None],
) -> None:
    path, arrays = tmp_path / "a.npz", change(played[0])
    path.write_text("text") if arrays is None else np.savez(path, **arrays)
    with pytest.raises(RecordingError, match=r"a\.npz holds (no games: |games with another number of actions)"):
        games.repeat(game, pair, COUNT, path)
