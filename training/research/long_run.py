"""long-run: what agents do at checkpoints of a run, twice as far apart each time; cross-play; best responses."""

import argparse
import csv
import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.api.options import OUTPUT
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import output, positive
from outlast.envs.rollout.lineup import parse_lineup
from outlast.envs.rollout.saved import STEPS, checkpoints, steps_of
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.text_table import terminal_width, text_table
from outlast.systems import Behaviour

from ..arena.evaluation import Evaluation, play
from ..arena.match import Estimates, Pairing, ratio
from ..arena.players import contenders
from ..base.config import OPPONENTS
from ..base.errors import TrainingError
from ..base.files import check_out, read_text, write_files
from ..base.policy_file import read_run_folder
from ..base.quantities import csv_text, digits, pivot
from ..plots.plot import DRAWN
from .corrected_games import BY_AGENTS, BY_SIDES, EPISODES, SCRIPTED, SELF_PLAY, self_play
from .teamwork import Teamwork

WORLDS = 128
TWICE = 1.95  # as the steps of checkpoints are rounded up to rollouts
COUNTED = SELF_PLAY | {
    "heals_of_mates": ("used, picked up by a mate", BY_AGENTS),
    "heals_held": ("heals held", 1),
    "boxes_placed": ("boxes placed", 1),
    "deaths_zone": ("deaths in the zone", BY_SIDES),
    "outside_zone": ("time outside the zone", 1),
}  # as in SELF_PLAY
SHARES = {
    "damage beside a mate": ("damage_beside", "damage_dealt"),
    "damage focused": ("damage_focused", "damage_beside"),
}  # by name: what it is a share of what
FIGURES = ("run", "policy", "figure", "value", "error")
GAMES = ("run", "policy", "against", "wins", "error")
RESPONSES = ("response", "run", "against", "steps", "warm start", "wins", "error")
FILES = {"figures.csv": FIGURES, "crossplay.csv": GAMES, "responses.csv": RESPONSES}
Rows = list[tuple[str, ...]]


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(commands, "long-run", run)
    group = command.group(DRAWN)
    group.add_argument("scenario", metavar="SCENARIO", help="the game that the runs were trained in")
    group.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="folders of runs")
    text = "folders of runs whose only opponent was a checkpoint"
    group.add_argument("--responses", nargs="+", type=Path, default=[], metavar="RUN", help=text)
    text = f"episodes of each pairing (default {EPISODES})"
    group.add_argument("--episodes", type=positive, default=EPISODES, metavar="EPISODES", help=text)
    text = f"write {', '.join(FILES)} to this folder; what it has of other runs stays"
    command.group(OUTPUT).add_argument("--out", type=output(check_out), metavar="FOLDER", help=text)


def chosen(run: Path) -> list[Path]:
    """Return the first checkpoint of a run, the first ones after 2, 4, 8, ... times its steps, and the newest.

    Raises TrainingError: the run has no checkpoint.
    """
    saved = checkpoints(run)
    if not saved:
        raise TrainingError(f"{run} has no checkpoint")
    found, least = list[Path](), 0.0
    for path in saved:
        if steps_of(path) >= least or path == saved[-1]:
            found.append(path)
            least = TWICE * steps_of(path)
    return found


def measured(game: Scenario, run: Path, episodes: int) -> tuple[Rows, Rows]:
    """Let the chosen checkpoints of a run and the scripted policy play. Returns rows of FIGURES and of GAMES."""
    players = {str(steps_of(path)): str(path) for path in chosen(run)} | {SCRIPTED: SCRIPTED}
    with closing(_evaluation(game.with_(Behaviour(), Teamwork()), players, episodes)) as evaluation:
        play(evaluation, None, None, quiet=False)
        agents, ratings = evaluation.env.num_agents, evaluation.ratings()
        assert ratings is not None  # all have played against each other
        figures, games, names = Rows(), Rows(), list(players)
        for k, name in enumerate(names):
            own = {"Elo": (float(ratings[0][k]), float(ratings[1][k]))}
            if name != SCRIPTED:
                own |= {f"wins against {SCRIPTED}": evaluation.estimates(name, SCRIPTED)["wins"]}
            for pairing in evaluation.pairings:
                if pairing.pair == (k, k):
                    own |= self_play(pairing, COUNTED, agents) | shares(pairing)
            figures += [_row((run.name, name, figure), *pair) for figure, pair in own.items()]
            wins = {other: evaluation.estimates(name, other)["wins"] for other in names if other != name}
            games += [_row((run.name, name, other), *pair) for other, pair in wins.items()]
    return figures, games


def shares(pairing: Pairing) -> Estimates:
    """Return SHARES in episodes in which a policy plays itself."""
    each = {name: figure.sum(2)[..., 0].ravel() for name, figure in pairing.results.figures.items()}  # of both roles
    there = {title: names for title, names in SHARES.items() if each.keys() >= {*names}}
    found = {title: ratio(np.stack([each[part], each[base]], -1)) for title, (part, base) in there.items()}
    return {title: pair for title, pair in found.items() if not math.isnan(pair[0])}


def responded(game: Scenario, run: Path, episodes: int) -> Rows:
    """Let all checkpoints of a run play against the one opponent that it was trained against.

    Returns rows of RESPONSES. Raises TrainingError: it was trained against several, or against none that is saved.
    """
    plan = read_run_folder(run)["plan"]
    target, *others = map(Path, parse_lineup(plan.get("opponents", ""), OPPONENTS))
    if others or not STEPS.fullmatch(target.name):
        raise TrainingError(f"{run} was not trained against one checkpoint, but against {plan.get('opponents')}")
    saved = {str(steps_of(path)): str(path) for path in checkpoints(run)}
    with closing(_evaluation(game, saved | {"target": str(target)}, episodes)) as evaluation:
        rows, last = Rows(), len(saved)
        for k, steps in enumerate(saved):
            wins = evaluation.play_pair((k, last)).estimates(0)["wins"]
            warm = "yes" if plan.get("warm_start") else "no"
            rows.append(_row((run.name, target.parent.name, str(steps_of(target)), steps, warm), *wins))
    return rows


def _evaluation(game: Scenario, players: dict[str, str], episodes: int) -> Evaluation:
    return Evaluation(game, contenders(players), episodes=episodes, worlds=min(WORLDS, episodes))


def _row(names: tuple[str, ...], mean: float, error: float) -> tuple[str, ...]:
    return (*names, digits(float(f"{mean:.4g}")), digits(float(f"{error:.2g}")))


def run(options: argparse.Namespace) -> None:
    """Measure what emerges in a long run of the survival game.

    Let checkpoints of each run play against each other, themselves and the scripted policy: the first one, those after
    2, 4, 8, ... times its steps, and the newest. Print win rates, ratings and what agents do. Of runs that were trained
    against a single checkpoint, print how many games each checkpoint wins against it.

    Examples:
        long-run teams_3+bounty runs/teams_3+bounty-fast-0 --out long_run  # one run; write tables
        long-run teams_3+bounty --responses responses/0  # a run of `outlast train ... --opponents FILE.zip`
    """
    game, tables = resolve(options.scenario, {}), {name: Rows() for name in FILES}
    if not options.runs and not options.responses:
        raise TrainingError("there is nothing to measure: name the folders of runs, or --responses")
    before = {name: _kept(Path(options.out) / name) if options.out else Rows() for name in FILES}
    for folder in options.runs:
        figures, games = measured(game, folder, options.episodes)
        tables["figures.csv"] += figures
        tables["crossplay.csv"] += games
        for rows, about, down, across in ((figures, folder.name, 2, 1), (games, "wins of, against", 1, 2)):
            heads, lines = pivot(rows, down, across)
            print("", text_table(lines, (about, *heads), left=1, width=terminal_width()), sep="\n")
    for folder in options.responses:
        tables["responses.csv"] += responded(game, folder, options.episodes)
    if rows := tables["responses.csv"]:
        print("", text_table(rows, RESPONSES, left=2, width=terminal_width()), sep="\n")
    if options.out:
        contents = dict[Path, bytes]()
        for name, rows in tables.items():
            others = [row for row in before[name] if row[0] not in {own[0] for own in rows}]
            if rows:
                contents[Path(options.out) / name] = csv_text(FILES[name], others + rows).encode()
        print("", *write_files(contents), sep="\n")


def _kept(path: Path) -> Rows:
    """Return the rows of a file of FILES; none if there is no such file. Raises TrainingError."""
    if not path.exists():
        return Rows()
    heads, *rows = map(tuple, csv.reader(read_text(path).splitlines()))
    if heads != FILES[path.name]:
        raise TrainingError(f"{path} has the columns {', '.join(heads)}: choose another folder with --out")
    return rows
