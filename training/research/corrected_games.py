"""Behaviour in corrected games: each run's policy plays itself, its past and the scripted one."""

import contextlib
import csv
import io
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage import strict_json
from outlast.systems import Behaviour

from ..arena.evaluation import TABLES, Evaluation, write_tables
from ..arena.players import contenders
from ..base.errors import TrainingError
from ..base.files import packed, read_bytes, read_text, unpacked
from ..base.tables import NONE, csv_text, markdown_table, with_spread

EPISODES = 640  # of each pairing
FOLDER = "measured"  # the folder of measurements in the folder of a run
FILE = "measured.csv.xz"  # the file of measurements of all kept runs
LAST, HALF, SCRIPTED = "last", "half", "scripted"
MATES = "mate_distance"  # 0 for agents without a mate
BY_SIDES, BY_AGENTS = 2, 0  # factors from the mean of both roles to a sum over all agents: 2; the number of agents
SELF_PLAY = {
    "length": ("ticks", 1),
    "kills": ("kills", BY_SIDES),
    "damage_dealt": ("damage", BY_AGENTS),
    "strikes_landed": ("strikes that land", 1),
    "heals_used": ("heals used", 1),
    "heals_in_need": ("in need", BY_AGENTS),
    "heals_given": ("given", BY_SIDES),
    "boxes_between": ("boxes between", BY_AGENTS),
    MATES: ("m to a mate", 1),
    "enemy_distance": ("m to an enemy", 1),
}  # of an episode of a policy against itself, by figure: its title, and its factor
HEADS = (
    "game",
    "seeds",
    f"wins against {SCRIPTED}",
    "against itself at half time",
    *(name for name, _ in SELF_PLAY.values()),
)
FIGURES = ("wins", *SELF_PLAY)  # the figures that are kept
COLUMNS = ("agents", "policy", "against", "role", *(f"{name} {of}" for name in FIGURES for of in ("mean", "error")))
Row = dict[str, str]  # the cells of COLUMNS: the figures of a policy in a role against another one
Measured = dict[str, list[Row]]  # by the names of runs


def measure(game: Scenario, run: Path, progress: Callable[[int], None] = lambda episodes: None) -> None:
    """Play the games of a run's policy, and write their tables into its folder unless they exist.

    game: The game of its training. run: The folder of the run; its past is the checkpoint after half of its steps.
    progress: Called with the number of episodes that ended. Raises TrainingError: the run has a single checkpoint.
    """
    saved = checkpoints(run)
    if len(saved) < 2:
        raise TrainingError(f"{run} has {len(saved)} checkpoints: its policy has no past to play against; train on")
    chosen = contenders({LAST: saved[-1], HALF: saved[(len(saved) - 1) // 2], SCRIPTED: SCRIPTED})
    for contender in chosen[:2]:
        contender.text = "/".join(Path(contender.text).parts[-2:])  # results are kept without the location of the runs
    out = run / FOLDER
    if is_measured(run):
        found = _read(out)
        if found["complete"] and [each["policy"] for each in found["policies"]] == [each.text for each in chosen]:
            return
    evaluation = Evaluation(game.with_(Behaviour()), chosen, episodes=EPISODES)
    with contextlib.closing(evaluation):
        evaluation.play(progress)
        write_tables(evaluation, out)


def is_measured(run: Path) -> bool:
    """Return whether the folder of a run has the tables of `measure`."""
    return (run / FOLDER / TABLES).exists()


def rows(run: Path) -> list[Row]:
    """Return the kept part of the tables of `measure` in the folder of a run. Raises TrainingError."""
    found = _read(run / FOLDER)
    agents, kept = found["scenario"]["numbers"]["agents_count"], list[Row]()
    for pairing in found["pairings"]:
        for role, figures in enumerate(pairing["figures"]):
            policy, against = pairing["policies"][:: 1 - 2 * role]
            row = {"agents": str(agents), "policy": policy, "against": against, "role": str(role)}
            for name in figures.keys() & {*FIGURES}:
                row[f"{name} mean"] = str(figures[name]["mean"])
                row[f"{name} error"] = f"{figures[name]['error']:.4g}"
            kept.append(row)
    return kept


def format_measured(measured: Measured) -> bytes:
    """Return the rows of runs as one compressed CSV file."""
    rows = ((run, *(row.get(name, "") for name in COLUMNS)) for run, own in measured.items() for row in own)
    return packed(csv_text(("run", *COLUMNS), rows))


def read_measured(path: Path) -> Measured:
    """Read a file of `format_measured`; empty if it does not exist. Raises TrainingError."""
    found = Measured()
    if not path.exists():
        return found
    content = read_bytes(path)
    try:
        table = csv.DictReader(io.StringIO(unpacked(content)), strict=True)
        if table.fieldnames != ["run", *COLUMNS]:
            raise ValueError("its columns differ")
        for row in table:
            found.setdefault(row.pop("run"), []).append(row)
    except (ValueError, csv.Error) as error:
        raise TrainingError(f"{path} does not hold measurements of runs: {error}") from None
    return found


def table(measured: Mapping[str, Sequence[Sequence[Row]]]) -> str:
    """Return the measurements in Markdown: means over seeds, with 95 % intervals for several seeds.

    Where a policy plays itself, both of its roles count. Seeds that have not played the scripted policy do not count
    in the games won against it.

    measured: The rows of each seed, by game.
    """
    return markdown_table(HEADS, [_cells(game, seeds) for game, seeds in measured.items()])


def _cells(game: str, seeds: Sequence[Sequence[Row]]) -> list[str]:
    cells = [game, str(len(seeds))]
    for other in (SCRIPTED, HALF):
        met = [rows for rows in seeds if any(row["against"] == other for row in rows)] or seeds
        cells.append(with_spread([_mean(rows, other, "wins") for rows in met]))
    for name, (_, times) in SELF_PLAY.items():
        there = [
            (times or int(rows[0]["agents"])) * _mean(rows, LAST, name)
            for rows in seeds
            if all(row[f"{name} mean"] for row in _against(rows, LAST))
        ]
        lacking = name == MATES and not any(there)
        cells.append(NONE if lacking else with_spread(there) if there else "")
    return cells


def _mean(rows: Sequence[Row], other: str, name: str) -> float:
    """Return a figure of the last policy against another one, or against itself: the mean over its roles there."""
    return float(np.mean([float(row[f"{name} mean"]) for row in _against(rows, other)]))


def _against(rows: Sequence[Row], other: str) -> list[Row]:
    """Return the rows of the last policy against another one, or against itself: one for each of its roles there."""
    found = [row for row in rows if (row["policy"], row["against"]) == (LAST, other)]
    if not found:
        raise TrainingError(f"games of {LAST} against {other} are missing")
    return found


def _read(folder: Path) -> dict[str, Any]:
    try:
        return json.loads(read_text(folder / TABLES))
    except strict_json.BROKEN as error:
        raise TrainingError(f"{folder / TABLES} is not an evaluation: {error}") from error
