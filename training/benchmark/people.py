"""People: where those stand who played a task by `outlast play --record`, by the games that they have played.

The opponent is the one that the recording names. That a person steered the agent, nobody can verify.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from outlast.components import End
from outlast.ecs import RESET
from outlast.envs.core.spaces import side
from outlast.envs.recording import Recording, Replay
from outlast.envs.rollout.lineup import Standings, own_wins
from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_word

from ..arena.ratings import anchored
from ..base.errors import TrainingError
from .games import digest
from .result import NUMBERS, Content, is_count, is_digest, is_name, read_json, write_json
from .suite import suite
from .tasks import PROTOCOL, tasks

NAME = "people.json"
GAMES = {"name": is_name, "recording": is_digest, "task": is_word, "opponent": is_word}
FORM = {"version": PROTOCOL, "games": [GAMES | dict.fromkeys(NUMBERS, is_count)]}


def add(folder: Path, name: str, recordings: Sequence[Path]) -> list[Content]:
    """Add the games in recordings to the file of people in a folder, and return all games in it.

    name: Of the person, or of a group. Raises TrainingError, or RecordingError if one cannot be replayed.
    """
    if not is_name(name):
        raise TrainingError(f"{name!r} must consist of letters, digits and . _ - +")
    games = read(folder)
    for path in recordings:
        own = {"name": name, "recording": digest(path)} | _played(path)
        if own["recording"] in [each["recording"] for each in games]:
            raise TrainingError(f"{path} has been added already")
        games.append(own)
    write_json(folder / NAME, {"version": PROTOCOL, "games": games})
    return games


def read(folder: Path) -> list[Content]:
    """Return the games in the file of people in a folder; none without a file. Raises TrainingError."""
    games = list(read_json(folder / NAME, FORM)["games"]) if (folder / NAME).exists() else []
    for each in games:
        known = each["task"] in tasks() and each["opponent"] in suite(tasks()[each["task"]]).members
        if not known or not sum(each[key] for key in NUMBERS):
            raise TrainingError(f"{folder / NAME}: these are no games against the suite of a task: {each!r:.200}")
    return games


def rows(games: Sequence[Content]) -> list[tuple[str, ...]]:
    """Return a row for each person in each task: name, task, opponents, games, share won, and rating with its error."""
    found = list[tuple[str, ...]]()
    for name, task in sorted({(each["name"], each["task"]) for each in games}):
        own = [each for each in games if (each["name"], each["task"]) == (name, task)]
        opponents, known = sorted({each["opponent"] for each in own}), suite(tasks()[task]).members
        of = [[each for each in own if each["opponent"] == other] for other in opponents]
        won, drawn, lost = (np.array([[sum(each[key] for each in met) for met in of]]) for key in NUMBERS)
        ratings, rating = [known[other].rating for other in opponents], "not rated"
        if None not in ratings:
            (elo,), (error,) = anchored(won, drawn, lost, np.array(ratings, np.float64))
            rating = f"{elo:.0f} ± {error:.0f}"
        total = int((won + drawn + lost).sum())
        found.append((name, task, ", ".join(opponents), str(total), f"{(won + drawn / 2).sum() / total:.2f}", rating))
    return found


def _played(path: Path) -> Content:
    """Return the task of a recording, the opponent, and the numbers of games that the person won, drew and lost."""
    recording = Recording.open(path)
    played = recording.header.get("played")
    if played is None:
        raise TrainingError(f"{path} does not say who played: record it by `outlast play --record`")
    given = recording.header["scenario"]
    task = [each for each in tasks().values() if not difference(given, fingerprint(each.scenario))]
    if not task:
        raise TrainingError(f"{path} is of {recording.scenario.name}, which is no task: play the game of one, as ffa_2")
    if played["others"] not in suite(task[0]).members:
        raise TrainingError(f"{path}: its opponent {played['others']} is not in the suite of {task[0].name}")
    replay, found, row = Replay(recording), list[float](), np.zeros(1, int)
    standings, worlds = Standings(replay.worlds), replay.worlds
    for _ in replay.ticks():
        if (worlds.mode == RESET).any():
            standings.begin(np.ones(1, bool))
            continue
        standings.watch()
        if (worlds[End].terminated | worlds[End].truncated).any():
            found.append(float(own_wins(standings.of(row), side(worlds)[:, played["agent"]])[0]))
    replay.close()
    if not found:
        raise TrainingError(f"{path} holds no game that was played to its end")
    numbers = [found.count(value) for value in (1.0, 0.5, 0.0)]
    return {"task": task[0].name, "opponent": played["others"]} | dict(zip(NUMBERS, numbers, strict=True))
