"""Hide and seek, what agents do with things, and what they remember of them.

tool-use: with and without things; phases: from checkpoint to checkpoint; object-counting: what is read from memories.
"""

import argparse
import itertools
import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from outlast.components.hide_and_seek import HIDERS, SEEKERS
from outlast.components.transfer import Passed
from outlast.ecs import role
from outlast.envs.api.make import make_vec
from outlast.envs.api.options import OUTPUT
from outlast.envs.cli.grammar import add_command
from outlast.envs.cli.options import output, positive
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.saved import checkpoints, runs_in, steps_of
from outlast.envs.scenarios.parse import resolve
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.scenarios.transfer import OBJECT_COUNTING
from outlast.envs.text_table import text_table

from ..arena.evaluation import CERTAIN, Evaluation, evaluate
from ..arena.match import Estimates
from ..base.config import TrainingConfig
from ..base.errors import TrainingError
from ..base.files import check_results, write_files
from ..base.quantities import csv_text, pivot
from ..plots.figure import encoded, write_notes
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
COMPARED = ("run", "who", FIGURE, "error", "difference", "its error", "errors apart")
BY_SIDE = ("return", "held", "locks", "unlocks", "climbs")
COUNTS = ("crates_moved1", "crates_locked1", "ramps_moved1", "ramps_locked1", "doors_closed1")  # as episodes end
COUNTED = ("run", "weights", "right", "error", "guessed", "explained")
COLUMNS = ("run", "hiders", "seekers", "figure", "mean", "error")
MILLION = 1e6
NOISE = 0.01  # standard deviation, of memories from -1 to 1: otherwise the last bits of a float32 give all away
LEAST = 16  # episodes of object counting
Array = np.ndarray[Any, Any]
Cells = dict[tuple[int, int], Estimates]  # by the agent-steps of hiders and of seekers


def add(commands: Any) -> None:
    """Add the commands to a parser's commands."""
    _add_games(add_command(commands, "tool-use", use_tools), "a saved policy, or the folder of a run")
    text = "a policy with a memory, or the folder of its run"
    _add_games(add_command(commands, "object-counting", count_objects), text, scenario=False)
    command = add_command(commands, "phases", play_phases)
    _add_games(command, "the folder of a run, or a folder with several of these")
    text = "draw the ticks seen of all runs to this file, as PNG"
    command.group(OUTPUT).add_argument("--figure", type=output(_check), metavar="FILE", help=text)


def _add_games(command: Any, runs: str, scenario: bool = True) -> None:
    """Add what games of hide and seek need to a command. runs: Help on what is played. scenario: Whether to ask."""
    group = command.group(DRAWN)
    if scenario:
        group.add_argument("scenario", metavar="SCENARIO", help="a scenario of hide and seek")
    group.add_argument("runs", nargs="+", metavar="RUN", help=runs)
    text = "episodes of each game (default 1024)"
    group.add_argument("--episodes", type=positive, default=1024, metavar="EPISODES", help=text)
    text = "write the table to this file, as CSV"
    command.group(OUTPUT).add_argument("--out", type=output(_check), metavar="FILE", help=text)


def _check(file: str) -> None:
    check_results([Path(file)])


def ablated(scenario: Scenario, changes: dict[str, dict[str, Any]]) -> Scenario:
    """Return the scenario, in which agents of some roles lack something."""
    hiders, seekers = map(int, scenario.numbers()["teams_sizes"])
    counts = {"hider": hiders, "seeker": seekers}
    roles: dict[str, Any] = {name: role(count, **changes.get(name, {})) for name, count in counts.items()}
    return scenario.roles(observed=False, **roles)


def measure(scenario: Scenario, path: str, episodes: int) -> list[tuple[Any, ...]]:
    """Play a policy in all forms of the scenario that differ for it. Returns rows of COMPARED."""
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


def use_tools(options: argparse.Namespace) -> None:
    """Test whether hiders and seekers use things as tools.

    Let each run's newest policy of hide and seek play against itself, as it was trained and with actions taken away
    from one side, and print in how many ticks of an episode hiders are seen. A difference of more than three standard
    errors shows that what was taken away was of use.

    Examples:
        tool-use hide_small runs/hide_small-fast-0 --episodes 1024  # one run
    """
    rows = list[tuple[Any, ...]]()
    for path in options.runs:
        rows += measure(resolve(options.scenario, {}), path, options.episodes)
    if options.out:
        write_files({Path(options.out): csv_text(COMPARED, rows).encode()})
    print(text_table([(*row[:2], *(f"{value:.2f}" for value in row[2:])) for row in rows], COMPARED, left=2))


def memories(path: str, trained: bool, seed: int, episodes: int) -> tuple[Array, Array]:
    """Play episodes of object counting at once, with the weights of a policy's hiders or with random ones.

    Returns the memories at the end, float32 (episodes, memory), and how many crates have gone to the left, (episodes,).
    Raises TrainingError: the policy has no memory.
    """
    from ..policies.player import Player  # PyTorch, slow to load
    from ..ppo.trainer import Trainer, capture

    saved = Player(path)
    if not saved.memory:
        raise TrainingError(f"{path} has no memory to read: train it with --memory")
    weights: dict[str, Any] = {"preset": saved.preset.name, "memory": saved.memory, "policies": "side"}
    config = TrainingConfig(OBJECT_COUNTING, **weights, worlds=1, seed=seed, warm_start=path if trained else "")
    trainer = Trainer(config)
    trainer.take_weights()
    player = Player(capture(trainer, config.header()))
    with closing(make_vec(player.scenario(OBJECT_COUNTING), episodes, seed=seed, copy=False)) as env:
        policy, (observations, _) = told(player, env), env.reset()
        for _ in range(env.scenario.numbers()["ending_limit"] - 1):
            observations = env.step(policy(observations))[0]
        policy(observations)
        return player.remembered, env.worlds[Passed].went_left[:, 0].copy()


def read_off(held: Array, counts: Array) -> tuple[float, float, float, float]:
    """Fit a linear map from memories to counts in half of the episodes, by ridge regression, and test it in the others.

    Returns the share of episodes in which the rounded number is right, its error, the share for the most frequent
    number, and the share of the variance that is explained.
    """
    half = len(counts) // 2
    known, asked = np.split((held - held[:half].mean(0)).astype(float), [half])
    fitted, true = np.split(counts, [half])
    ridge = half * NOISE**2 * np.eye(known.shape[1])
    slopes = np.linalg.solve(known.T @ known + ridge, known.T @ (fitted - fitted.mean()))
    found = fitted.mean() + asked @ slopes
    right = float((np.rint(found) == true).mean())
    guessed = float((true == np.bincount(fitted).argmax()).mean())
    explained = float(1 - ((found - true) ** 2).mean() / true.var())
    return right, math.sqrt(right * (1 - right) / len(true)), guessed, explained


def count_objects(options: argparse.Namespace) -> None:
    """Test what hiders with a memory remember of six crates that have gone by (object counting).

    The agent stands still while crates leave its sight, to the left or to the right. From its memory at the end, a
    linear map, which is fitted in half of the episodes, reads how many have gone to the left: right is the share of the
    other episodes in which it is right, guessed that of always saying the most frequent number, and explained the share
    of the variance. Beside it the same for networks with random weights.

    Examples:
        object-counting runs/hide_small-memory-0 runs/hide_small-memory-1  # two runs
    """
    if options.episodes < LEAST:
        raise TrainingError(f"--episodes {options.episodes}: {LEAST} are needed, half of them to fit and half to test")
    rows = list[tuple[Any, ...]]()
    for k, path in enumerate(options.runs):
        for trained in (True, False):
            found = read_off(*memories(path, trained, k, options.episodes))
            rows.append((path, "trained" if trained else "random", *found))
    if options.out:
        write_files({Path(options.out): csv_text(COUNTED, rows).encode()})
    print(text_table([(*row[:2], *(f"{value:.3f}" for value in row[2:])) for row in rows], COUNTED, left=2))


def play(scenario: Scenario, folder: Path, episodes: int) -> Cells:
    """Play all checkpoints of a run against each other, and themselves. What never happens is left out."""
    paths = {str(steps_of(path)): path for path in checkpoints(folder)}
    if len(paths) < 2:
        raise TrainingError(f"{folder} has {len(paths)} checkpoint: train it with --every, to keep several")
    found, steps = evaluate(scenario, paths, episodes=episodes, worlds=256, quiet=True), [*map(int, paths)]
    cells = {(one, other): cell(found, str(one), str(other)) for one in steps for other in steps}
    happens = {FIGURE, *(name for each in cells.values() for name, (mean, _) in each.items() if mean)}
    return {pair: {name: each[name] for name in each if name in happens} for pair, each in cells.items()}


def cell(found: Evaluation, hiders: str, seekers: str) -> Estimates:
    """Return the figures of games of some hiders against some seekers; numbered 0 and 1 where each side has its own."""
    sides = ((hiders, seekers, HIDERS), (seekers, hiders, SEEKERS))
    own = [found.estimates(policy, against, side) for policy, against, side in sides]
    split = {f"{name}{side}": own[side][name] for name in BY_SIDE for side in (HIDERS, SEEKERS)}
    return {FIGURE: own[HIDERS][FIGURE]} | split | {name: own[HIDERS][name] for name in COUNTS}


def rows(name: str, cells: Cells) -> list[tuple[Any, ...]]:
    """Return rows of COLUMNS: ticks seen of all pairings, and everything else of checkpoints against themselves."""
    return [
        (name, *pair, figure, f"{mean:.2f}", f"{error:.2f}")
        for pair, estimates in cells.items()
        for figure, (mean, error) in estimates.items()
        if figure == FIGURE or pair[0] == pair[1]
    ]


def changes(cells: Cells, of: int) -> tuple[int, int, int]:
    """Compare the ticks seen of later and earlier checkpoints of a side, HIDERS or SEEKERS, against the same one.

    Returns how often more, and how often less, by more than CERTAIN standard errors; and the number of comparisons.
    """
    steps, apart = sorted({pair[of] for pair in cells}), list[float]()
    for other, (early, late) in itertools.product(steps, itertools.combinations(steps, 2)):
        pairs = ((each, other) if of == HIDERS else (other, each) for each in (early, late))
        (before, one), (after, two) = (cells[pair][FIGURE] for pair in pairs)
        apart.append((after - before) / max(math.hypot(one, two), 1e-9))
    return sum(each > CERTAIN for each in apart), sum(each < -CERTAIN for each in apart), len(apart)


def report(name: str, cells: Cells) -> str:
    """Return the tables of a run."""
    shown = [(name, f"{hiders:,}", f"{seekers:,}", *rest) for _, hiders, seekers, *rest in rows(name, cells)]
    lines, parts = [], []
    for side, which in ((HIDERS, "hiders"), (SEEKERS, "seekers")):
        more, less, of = changes(cells, side)
        lines.append(f"against the same opponent, later {which}: seen more {more}, seen less {less}, of {of} pairs")
    matrix, own = [row for row in shown if row[3] == FIGURE], [row for row in shown if row[1] == row[2]]
    for table, about, across in ((matrix, "hiders, seekers", 2), (own, "itself", 3)):
        heads, table_lines = pivot(table, 1, across)
        parts.append(text_table(table_lines, (about, *heads), left=1))
    return "\n\n".join([f"{name}: {FIGURE}", parts[0], "\n".join(lines), parts[1]])


def draw(runs: Mapping[str, Cells]) -> Figure:
    """Draw the ticks seen of each run as a square of numbers."""
    size, head = 2.5, 0.75
    figure = Figure((size * len(runs) + 0.45, size + head))
    grid = figure.subplots(1, len(runs), squeeze=False)[0]
    figure.subplots_adjust(left=0.45 / figure.get_figwidth(), right=0.995, bottom=0.15, top=0.74, wspace=0.14)
    most = max(mean for cells in runs.values() for mean, _ in (each[FIGURE] for each in cells.values()))
    for axes, (name, cells) in zip(grid, runs.items(), strict=True):
        steps = sorted({hiders for hiders, _ in cells})
        seen = [[cells[one, other][FIGURE][0] for other in steps] for one in steps]
        axes.imshow(seen, cmap="Blues", vmin=0, vmax=most, aspect="auto", origin="lower")
        for k, line in enumerate(seen):
            for j, value in enumerate(line):
                ink = "white" if value > 0.6 * most else "black"
                axes.text(j, k, f"{value:.0f}", ha="center", va="center", color=ink, fontsize=7)
        axes.set_title(name)
        labels = [f"{each / MILLION:.0f}" for each in steps]
        axes.set_xticks(range(len(steps)), labels)
        axes.set_yticks(range(len(steps)), labels)
        axes.tick_params(length=0, labelsize=7)
        axes.set_xlabel("seekers, million agent-steps")
    grid[0].set_ylabel("hiders, million agent-steps")
    note = "Rows: hiders of a checkpoint; columns: seekers of a checkpoint of the same run"
    write_notes(figure, "Ticks in which hiders are seen", [note])
    return figure


def play_phases(options: argparse.Namespace) -> None:
    """Play hiders of each checkpoint against seekers of each.

    Let hiders of each checkpoint of a run of hide and seek play against seekers of each checkpoint of the same run.
    Print in how many ticks of an episode hiders are seen, and what each checkpoint does with things when it plays
    against itself.

    Examples:
        phases hide_small runs/hide_small-fast-* --out phases.csv --figure phases.png  # several runs
    """
    folders = [folder for place in options.runs for folder in runs_in(Path(place))]
    found = {folder.name: play(resolve(options.scenario, {}), folder, options.episodes) for folder in folders}
    contents, every = dict[Path, bytes](), list[Sequence[Any]]()
    for name, cells in found.items():
        print(report(name, cells), end="\n\n")
        every += rows(name, cells)
    if options.out:
        contents[Path(options.out)] = csv_text(COLUMNS, every).encode()
    if options.figure:
        contents[Path(options.figure)] = encoded(lambda: draw(found), "png", {"Title": "phases"}, 64)
    write_files(contents)
