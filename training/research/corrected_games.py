"""Behaviour in corrected games: each run's policy plays itself, its past and the scripted one."""

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

from outlast.envs.rollout.saved import checkpoints
from outlast.envs.scenarios.scenario import Scenario
from outlast.systems import Behaviour

from ..arena.evaluation import Evaluation
from ..arena.match import Estimates, Pairing, ratio
from ..arena.players import contenders
from ..base.errors import TrainingError
from ..base.files import packed, read_bytes, unpacked, write_files
from ..base.quantities import NONE, csv_text, markdown_table, with_spread

EPISODES = 640  # of each pairing
FILE = "measured.csv.xz"  # the file of a run's measurements in its folder, and of those of all kept runs
LAST, HALF, SCRIPTED = "last", "half", "scripted"
WINS = {SCRIPTED: f"wins against {SCRIPTED}", HALF: "against itself at half time"}  # titles by opponent
MATES = "m to a mate"  # 0 for agents without a mate
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
    "mate_distance": (MATES, 1),
    "enemy_distance": ("m to an enemy", 1),
}  # of an episode of a policy against itself, by figure: its title, and its factor
FIGURES = (*WINS.values(), *(title for title, _ in SELF_PLAY.values()))
COLUMNS = ("run", "policy", *FIGURES)
Row = dict[str, str]  # the cells of COLUMNS


def measured(game: Scenario, run: Path) -> Row:
    """Return the measurements of a run, from its folder or, if its policy is newer, from games that are played now.

    Its past is the checkpoint after half of its steps. Raises TrainingError: it has a single checkpoint.
    """
    saved = checkpoints(run)
    if len(saved) < 2:
        raise TrainingError(f"{run} has {len(saved)} checkpoints: its policy has no past to play against; train on")
    row = read_measured(run / FILE).get(run.name)
    if row is not None and row["policy"] == saved[-1].name:
        return row
    chosen = contenders({LAST: saved[-1], HALF: saved[(len(saved) - 1) // 2], SCRIPTED: SCRIPTED})
    with closing(Evaluation(game.with_(Behaviour()), chosen, episodes=EPISODES)) as evaluation:
        evaluation.play()
        found = {title: evaluation.estimates(LAST, other)["wins"] for other, title in WINS.items()}
        (own,) = (pairing for pairing in evaluation.pairings if pairing.pair == (0, 0))
        found |= self_play(own, SELF_PLAY, evaluation.env.num_agents)
    row = {"run": run.name, "policy": saved[-1].name} | {title: repr(mean) for title, (mean, _) in found.items()}
    write_files({run / FILE: format_measured([row])})
    return row


def self_play(pairing: Pairing, figures: Mapping[str, tuple[str, int]], agents: int) -> Estimates:
    """Return what happens in an episode in which a policy plays itself, by title. figures: As SELF_PLAY.

    Both of its roles count. Figures that the game lacks, or that could not be measured, are left out.
    """
    found = Estimates()
    for name, (title, times) in figures.items():
        if name in pairing.results.figures:
            mean, error = ratio(pairing.results.figures[name].sum(2).reshape(-1, 2))
            if not math.isnan(mean):
                found[title] = (times or agents) * mean, (times or agents) * error
    return found


def format_measured(rows: Iterable[Row]) -> bytes:
    """Return the rows of runs as one compressed CSV file."""
    ordered = sorted(rows, key=lambda row: row["run"])
    return packed(csv_text(COLUMNS, ([row.get(name, "") for name in COLUMNS] for row in ordered)))


def read_measured(path: Path) -> dict[str, Row]:
    """Read a file of `format_measured`, by run; empty if it does not exist. Raises TrainingError."""
    if not path.exists():
        return {}
    content = read_bytes(path)
    try:
        table = csv.DictReader(io.StringIO(unpacked(content)), strict=True)
        if table.fieldnames != [*COLUMNS]:
            raise ValueError("its columns differ")
        return {row["run"]: row for row in table}
    except (ValueError, csv.Error) as error:
        raise TrainingError(f"{path} does not hold measurements of runs: {error}") from None


def table(measured: Mapping[str, Sequence[Row]]) -> str:
    """Return the measurements in Markdown: means over seeds that have them, with 95 % intervals for several seeds.

    measured: The row of each seed, by game.
    """
    lines = []
    for game, seeds in measured.items():
        cells = [game, str(len(seeds))]
        for title in FIGURES:
            there = [float(row[title]) for row in seeds if row.get(title)]
            lacking = title == MATES and not any(there)
            cells.append(NONE if lacking else with_spread(there) if there else "")
        lines.append(cells)
    return markdown_table(("game", "seeds", *FIGURES), lines)
