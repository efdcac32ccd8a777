"""Anchors: frozen checkpoints with fixed ratings, made once for each version of a task."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from outlast.envs.rollout.saved import checkpoints, runs_in
from outlast.envs.scenarios.fingerprint import fingerprint

from ...evaluation.contenders import Contender, labels
from ...evaluation.ratings import elo
from ...files import write_files
from ...paper.results import policy_only
from ..matches import digest, play
from ..result import Content, made, read_json, recording_name, write_json
from ..suite import STYLES
from ..tasks import PROTOCOL, Task

AGES = (0.1, 0.3, 1.0)  # shares of a run's agent-steps after which checkpoints are taken
LEAST = 8  # anchors that a task should have, at least


def chosen(places: Sequence[Path]) -> list[Path]:
    """The checkpoints in these places: files as they are, those of AGES in folders of runs. Raises TrainingError."""
    found = list[Path]()
    for place in places:
        if not place.is_dir():
            found.append(place)
            continue
        for folder in runs_in(place):
            kept = checkpoints(folder)
            steps = np.array([int(path.stem.rpartition("_")[2]) for path in kept])
            found += [kept[int(np.abs(steps - age * steps[-1]).argmin())] for age in AGES]
    return list(dict.fromkeys(found))


def make(
    task: Task,
    places: Sequence[Path],
    folder: Path,
    games: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Path:
    """Rate checkpoints and styles by a round robin, and write what the suite reads. If stopped, it can be continued.

    Args:
        task: The task that the anchors are for.
        places: Checkpoints, or folders of runs.
        folder: Where TASK.json and the policies go, and TASK-games.json and recordings, which need not be kept.
        games: Games of each match.
        progress: Called with how many matches are done, and how many there are.

    Returns:
        The path of TASK.json.

    Raises:
        TrainingError: A file is no checkpoint, or is named twice; the folder cannot be written.
    """
    sources = chosen(places)
    files = [folder / f"{task.name}-{label}.zip" for label in labels([str(source.resolve()) for source in sources])]
    write_files({file: policy_only(source) for file, source in zip(files, sources, strict=True)})
    players = [Contender(name, name) for name in STYLES]
    players += [Contender(file.stem.removeprefix(f"{task.name}-"), str(file)) for file in files]
    digests = [*[""] * len(STYLES), *map(digest, files)]
    wins, draws = _round_robin(task, players, digests, folder, games, progress)
    ratings, errors = elo(wins, draws)
    members = [
        {
            "name": player.label,
            "file": Path(player.text).name if known else "",
            "digest": known,
            "elo": round(own, 1),
            "error": round(error, 1),
        }
        for player, known, own, error in zip(players, digests, ratings.tolist(), errors.tolist(), strict=True)
    ]
    path, game = folder / f"{task.name}.json", fingerprint(task.games[0].scenario)
    write_json(path, {"version": PROTOCOL, "fingerprint": game, "games": games, "members": members, "made": made()})
    return path


def _round_robin(
    task: Task,
    players: Sequence[Contender],
    digests: Sequence[str],
    folder: Path,
    games: int,
    progress: Callable[[int, int], None],
) -> tuple[np.ndarray, np.ndarray]:
    """Games that each player won against each other, and draws: float64 (players, players) both."""
    place, pairs = folder / f"{task.name}-games.json", [(i, j) for j in range(len(players)) for i in range(j)]
    known: Content = read_json(place, lambda content: "") if place.exists() else {}
    wins, draws = np.zeros((2, len(players), len(players)))
    for k, (i, j) in enumerate(pairs):
        progress(k, len(pairs))
        key = " ".join((str(games), players[i].label, digests[i], players[j].label, digests[j]))
        if key not in known:
            recording = folder / "games" / recording_name(task.name, f"{players[i].label}-{players[j].label}")
            recording.parent.mkdir(exist_ok=True)
            found = play(task.games[0], [players[i], players[j]], games, recording)
            known[key] = [found["won"], found["drawn"], found["lost"]]
            write_json(place, known)
        wins[i, j], draws[i, j], wins[j, i] = known[key]
        draws[j, i] = draws[i, j]
    return wins, draws
