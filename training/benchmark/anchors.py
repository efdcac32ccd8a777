"""Anchors: frozen policies with fixed ratings, made once for each version of a task."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from outlast.envs.rollout.saved import checkpoints, runs_in
from outlast.envs.scenarios.fingerprint import fingerprint

from ..arena.players import Contender, labels
from ..arena.ratings import elo
from ..base import policy_file
from ..base.errors import TrainingError
from ..policies.player import weights_of
from .matches import play
from .result import Content, made, read_json, recording_name, write_json
from .suite import STYLES, Anchor, digest_of, style, write_anchors
from .tasks import PROTOCOL, Task

AGES = (0.1, 0.3, 1.0)  # shares of a run's agent-steps after which checkpoints are taken


def chosen(places: Sequence[Path]) -> list[Path]:
    """Return the checkpoints in these places: files themselves, and those of AGES in folders of runs.

    Raises TrainingError.
    """
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
    """Rate checkpoints and styles by a round robin, and write the files of the suite. A stopped run can be continued.

    Returns the path of TASK.safetensors. Raises TrainingError: a file is not a checkpoint, or is named twice; presets
    differ; the folder cannot be written.

    task: The task of the anchors. folder: Folder for TASK.safetensors, and for TASK-games.json and games/, which need
    not be kept. progress: Called with the number of matches done, and that of all matches.
    """
    sources = chosen(places)
    names = labels([str(source.resolve()) for source in sources])
    files = [folder / "games" / f"{task.name}-{name}{policy_file.SUFFIX}" for name in names]
    anchors = [_anchor(source, file) for source, file in zip(sources, files, strict=True)]
    players = [style(name) for name in STYLES]
    players += [Contender(name, str(file)) for name, file in zip(names, files, strict=True)]
    digests = [*[""] * len(STYLES), *(digest_of(*anchor) for anchor in anchors)]
    wins, draws = _round_robin(task, players, digests, folder, games, progress)
    ratings, errors = (each.tolist() for each in elo(wins, draws))
    members = [
        {"name": player.label, "elo": round(own, 1), "error": round(error, 1)}
        for player, own, error in zip(players, ratings, errors, strict=True)
    ]
    game = fingerprint(task.games[0].scenario)
    rated = {"version": PROTOCOL, "fingerprint": game, "games": games, "members": members, "made": made()}
    path = folder / f"{task.name}{policy_file.SUFFIX}"
    write_anchors(path, anchors, rated)
    return path


def _anchor(source: Path, file: Path) -> Anchor:
    """Write a policy to its own file, and return its header and weights. Raises TrainingError."""
    header, policies = weights_of(source, critic=False)
    if len(policies) != 1:
        raise TrainingError(f"{source} holds {len(policies)} policies: an anchor must be a single policy")
    policy_file.write(file, header, policies)
    header, (weights,) = policy_file.read(file)
    return header, weights


def _round_robin(
    task: Task,
    players: Sequence[Contender],
    digests: Sequence[str],
    folder: Path,
    games: int,
    progress: Callable[[int, int], None],
) -> tuple[np.ndarray, np.ndarray]:
    """Return the games that each player won against each other, and draws: float64 (players, players) both."""
    place, pairs = folder / f"{task.name}-games.json", [(i, j) for j in range(len(players)) for i in range(j)]
    known: Content = read_json(place, lambda content: "") if place.exists() else {}
    wins, draws = np.zeros((2, len(players), len(players)))
    for k, (i, j) in enumerate(pairs):
        progress(k, len(pairs))
        key = " ".join((str(games), players[i].label, digests[i], players[j].label, digests[j]))
        if key not in known:
            recording = folder / "games" / recording_name(task.name, f"{players[i].label}-{players[j].label}")
            found = play(task.games[0], [players[i], players[j]], games, recording)
            known[key] = [found["won"], found["drawn"], found["lost"]]
            write_json(place, known)
        wins[i, j], draws[i, j], wins[j, i] = known[key]
        draws[j, i] = draws[i, j]
    return wins, draws
