"""tool-use: the same agents with and without the actions of hide and seek that make tools of things."""

import argparse
import math
from pathlib import Path
from typing import Any

from outlast.ecs import role
from outlast.envs.cli.options import output, positive
from outlast.envs.core.options import OUTPUT
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.text_table import text_table

from ..arena.evaluation import evaluate
from ..base.files import check_results, write_files
from ..base.tables import csv_text
from ..plots.plot import DRAWN

FIGURE = "ticks_seen"
HANDS: dict[str, Any] = {"without": ("grab", "lock")}
ABLATIONS: dict[str, dict[str, dict[str, Any]]] = {  # by name: options of outlast.role by role
    "as trained": {},
    "hiders without grab and lock": {"hider": HANDS},
    "seekers without grab and lock": {"seeker": HANDS},
    "seekers without ramps": {"seeker": {"climbing_ticks": 0}},
    "hiders without ramps": {"hider": {"climbing_ticks": 0}},
}
COLUMNS = ("run", "who", FIGURE, "error", "difference", "its error", "errors apart")


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    text = "test whether hiders and seekers use things as tools"
    description = (
        "Let each run's newest policy of hide and seek play against itself, as it was trained and with actions taken "
        "away from one side, and print in how many ticks of an episode hiders are seen. A difference of more than "
        "three standard errors shows that what was taken away was of use."
    )
    examples = [("tool-use hide_small runs/hide_small-fast-0 --episodes 1024", "one run")]
    command = commands.add_parser("tool-use", help=text, description=description, examples=examples)
    add_games(command, "a saved policy, or the folder of a run")
    command.set_defaults(run=run)


def add_games(command: Any, runs: str) -> None:
    """Add what games of hide and seek need to a command. runs: help on what is played."""
    group = command.group(DRAWN)
    group.add_argument("scenario", metavar="SCENARIO", help="a scenario of hide and seek")
    group.add_argument("runs", nargs="+", metavar="RUN", help=runs)
    text = "episodes of each game (default 1024)"
    group.add_argument("--episodes", type=positive, default=1024, metavar="EPISODES", help=text)
    text = "write the table to this file, as CSV"
    command.group(OUTPUT).add_argument(
        "--out", type=output(lambda file: check_results([Path(file)])), metavar="FILE", help=text
    )


def ablated(scenario: Scenario, changes: dict[str, dict[str, Any]]) -> Scenario:
    """Return the scenario, in which agents of some roles lack something."""
    hiders, seekers = map(int, scenario.numbers()["teams_sizes"])
    counts = {"hider": hiders, "seeker": seekers}
    roles: dict[str, Any] = {name: role(count, **changes.get(name, {})) for name, count in counts.items()}
    return scenario.roles(observed=False, **roles)


def measure(scenario: Scenario, path: str, episodes: int) -> list[tuple[Any, ...]]:
    """Play a policy in all forms of the scenario that differ for it. Returns rows of COLUMNS."""
    rows = list[tuple[Any, ...]]()
    climbs = scenario.numbers().get("things_ramps")
    for name, changes in ABLATIONS.items():
        if "ramps" in name and not climbs:
            continue
        found = evaluate(ablated(scenario, changes), {"policy": path}, episodes=episodes, worlds=128, quiet=True)
        mean, error = found.estimates("policy", "policy")[FIGURE]
        differs = (0.0, 0.0, 0.0)  # as trained
        if rows:
            difference, both = mean - rows[0][2], math.hypot(error, rows[0][3])
            differs = difference, both, difference / both if both else math.nan
        rows.append((path, name, mean, error, *differs))
    return rows


def run(options: argparse.Namespace) -> int:
    """Play and print; the exit status."""
    rows = list[tuple[Any, ...]]()
    for path in options.runs:
        rows += measure(resolve(options.scenario, {}), path, options.episodes)
    if options.out:
        write_files({Path(options.out): csv_text(COLUMNS, rows).encode()})
    print(text_table([(*row[:2], *(f"{value:.2f}" for value in row[2:])) for row in rows], COLUMNS, left=2))
    return 0
