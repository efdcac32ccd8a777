"""Tables of scores: Markdown, CSV, figures of performance profiles and curves, and the JSON of marl-eval."""

import hashlib
import itertools
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..base.errors import TrainingError
from ..base.files import write_files
from ..base.quantities import csv_text, markdown_table
from . import people, scores
from .marl_eval import ABSOLUTE, marl_eval_json
from .result import SELF
from .situations import SHARE
from .tasks import TRAINED

HEADS = ("agent", "score (IQM)", "95 %", "tasks", "seeds")
TASK_HEADS = (
    *("task", "agent", "score", "Elo", "trained in", "outside", "beside others", "beside itself"),
    *("best response wins", "situations", "seeds", "agent-steps"),
)
PAIR_HEADS = ("agent", "other", "difference of scores", "wins against it", "verdict")
PEOPLE_HEADS = ("who", "task", "against", "games", "won", "Elo")
OF_NO_TRACK, MET = "†", "‡"
logger = logging.getLogger("outlast")
COLUMNS = ("budget", "track", "task", "agent", "figure", "status", "mean", "low", "high", "seeds")
SIZE = (7.0, 3.4)  # inches


def write(found: scores.Scores, games: Sequence[dict[str, Any]], folder: Path) -> list[Path]:
    """Write all tables. Return the paths. games: Those of people. Raises TrainingError."""
    contents = {"table.md": markdown(found, games).encode(), "table.csv": as_csv(found).encode(), **dict(_more(found))}
    return write_files({folder / name: content for name, content in contents.items()})


def markdown(found: scores.Scores, games: Sequence[dict[str, Any]] = ()) -> str:
    """Return the tables of all budgets, and of people."""
    parts = [part for budget, own in found["budgets"].items() for part in _budget(int(budget), own)]
    if games:
        parts += ["### People", markdown_table(PEOPLE_HEADS, map(list, people.rows(games)))]
    return "\n\n".join(parts) + "\n"


def as_csv(found: scores.Scores) -> str:
    """Return the CSV file: a row for every value of every agent in every task."""
    rows = list[tuple[object, ...]]()
    for budget, own, task, agent, each in scores.by_agent(found):
        for name, value in scores.named(each):
            ends = (value.get(key, "") for key in ("mean", "low", "high"))
            rows.append((budget, own["track"], task, agent, name, value["status"], *ends, len(value.get("seeds", ()))))
    return csv_text(COLUMNS, rows)


def _budget(budget: int, own: scores.Scores) -> Iterator[str]:
    track = f"track {own['track']}" if own["track"] else f"of no track: {own['games']} games a test"
    yield f"### {budget:,} agent-steps ({track})"
    every = [(agent, each) for of_task in own["tasks"].values() for agent, each in of_task.items()]
    others = ", ".join(agent for agent in dict(every) if agent not in own["compared"])
    if own["common"]:
        yield (
            "Score: the interquartile mean over tasks and seeds, with its 95 % interval (stratified bootstrap), in the "
            f"tasks that all agents of this table have played: {', '.join(own['common'])}."
            + (f" Not in it: {others}, of fewer tasks." if others else "")
        )
        yield markdown_table(HEADS, _overall(own))
    if own["pairs"]:
        yield (
            "Planned comparisons, a mean over tasks. The intervals hold for all of them together; more, less or equal "
            "is said of a difference beyond, or within, the effect of the manifest:"
        )
        cells = ((pair, _cell(pair["difference"], 3), _cell(pair["direct"], 2)) for pair in own["pairs"])
        yield markdown_table(PAIR_HEADS, ([pair["one"], pair["other"], *two, pair["verdict"]] for pair, *two in cells))
    yield "By task, means over seeds with 95 % bootstrap intervals:"
    yield markdown_table(TASK_HEADS, _by_task(own["tasks"]))
    if not all(each["of_task"] for _, each in every):
        yield f"{OF_NO_TRACK} not shown by a policy file to be trained in the game of the task, within the budget."
    if any(each["met"] for _, each in every):
        yield f"{MET} it was trained against opponents of the suite, or by imitating them."


def _overall(own: scores.Scores) -> Iterator[list[str]]:
    """Yield a row for each agent, the highest score first."""
    for agent, found in sorted(own["iqm"].items(), key=lambda entry: -entry[1]["value"]):
        counts = {len(own["tasks"][task][agent]["seeds"]) for task in own["common"]}
        ends = f"{found['low']:.3f} to {found['high']:.3f}" if "low" in found else "one seed"
        seeds = " to ".join(map(str, sorted({min(counts), max(counts)})))
        yield [_marked(agent, *own["tasks"].values()), f"{found['value']:.3f}", ends, str(len(own["common"])), seeds]


def _marked(agent: str, *tasks: Mapping[str, scores.Scores]) -> str:
    """Return the agent with the marks that it has in any of these tasks."""
    each = [task[agent] for task in tasks if agent in task]
    return agent + OF_NO_TRACK * (not all(own["of_task"] for own in each)) + MET * any(own["met"] for own in each)


def _by_task(tasks: Mapping[str, Mapping[str, scores.Scores]]) -> Iterator[list[str]]:
    for task, of_task in sorted(tasks.items()):
        for agent, each in sorted(of_task.items()):
            outside = [value for name, value in each["games"].items() if name != TRAINED]
            others = [value for mate, value in each["mates"].items() if mate != SELF]
            passed = [share >= SHARE for share in each["situations"].values()]
            lost = []  # to best responses: "scratch 5 M 0.60", or a status
            for name, value in each["exploitability"].items():
                kind, _, steps = name.partition(" ")
                lost.append((f"{kind} {int(steps) / 1e6:g} M " if steps.isdigit() else "") + _cell(value, 2))
            yield [
                task,
                _marked(agent, of_task),
                _cell(each["score"], 3),
                _rating(each["rating"]),
                _cell(each["games"][TRAINED], 3) if outside else "",
                _mean(outside, 3),
                _mean(others, 2),
                _cell(each["mates"][SELF], 2) if others else "",
                ", ".join(lost),
                f"{sum(passed)} of {len(passed)}" if passed else "",
                str(len(each["seeds"])),
                "unknown" if None in each["steps"] or not each["steps"] else f"{max(each['steps']):,}",
            ]


def _mean(values: Sequence[scores.Value], digits: int) -> str:
    """Return the mean of several values; the status of one that has none; empty without values."""
    if gone := [value["status"] for value in values if "mean" not in value]:
        return str(gone[0])
    return f"{sum(value['mean'] for value in values) / len(values):.{digits}f}" if values else ""


def _cell(value: scores.Value, digits: int) -> str:
    """Return a mean with its interval; the status of a value without a mean."""
    if "mean" not in value:
        return str(value["status"])
    ends = f" [{value['low']:.{digits}f}, {value['high']:.{digits}f}]" if "low" in value else ""
    return f"{value['mean']:.{digits}f}{ends}"


def _rating(value: scores.Value) -> str:
    """Return a rating with its interval over seeds; of too few seeds, the ratings of each."""
    if value["status"] != scores.FEW:
        return _cell(value, 0)
    return f"{value['status']}: {', '.join(str(round(each)) for each in value['seeds'])}"


def _more(found: scores.Scores) -> Iterator[tuple[str, bytes]]:
    """Yield figures, and files for marl-eval, for each budget in which agents share a task."""
    for budget, own in found["budgets"].items():
        about = f"{int(budget):,} agent-steps"
        if any(
            "mean" in point for task in own["tasks"].values() for each in task.values() for point in each["curve"][1:]
        ):
            yield f"curves-{budget}.png", _picture(_draw_curves, own, f"validation, {about}")
        if not own["common"]:
            continue
        yield f"profile-{budget}.png", _picture(_draw_profile, own, f"performance profiles, {about}")
        # the score is that of the chosen checkpoint, and so the absolute metric, too
        every = [(task, name, own["tasks"][task][name]) for task in own["common"] for name in own["compared"]]
        fewest, runs = min(len(each["score"]["seeds"]) for *_, each in every), dict[tuple[str, str, int], Any]()
        for (task, agent, each), k in itertools.product(every, range(fewest)):
            score = {"score": each["score"]["seeds"][k]}
            runs[task, agent, each["seeds"][k]] = {int(budget): score, ABSOLUTE: score}
        try:
            yield f"marl_eval-{budget}.json", marl_eval_json("outlast", runs).encode()
        except TrainingError as error:  # marl-eval allows fewer names
            logger.warning("marl_eval-%s.json is left out: %s", budget, error)


def _picture(draw: Callable[[scores.Scores, str], Any], own: scores.Scores, title: str) -> bytes:
    """Return a figure as a PNG; the same scores give the same bytes. Needs matplotlib."""
    from ..plots.figure import encoded  # imported here, since it needs matplotlib

    source = hashlib.sha256(json.dumps(own, sort_keys=True).encode()).hexdigest()
    return encoded(lambda: draw(own, title), "png", {"Title": title, "Source": source})


def _line(axes: Any, number: int, label: str, x: Sequence[float], ys: Mapping[str, Any], step: Any = None) -> None:
    """Draw a line, and the area between "low" and "high" if there are such values. step: As for `fill_between`."""
    from ..plots.figure import look

    ink, dash = look(number)
    style = {"drawstyle": f"steps-{step}", "linewidth": 1.7} if step else {}
    axes.plot(x, ys["mean"], color=ink, linestyle=dash, label=label, **style)
    if "low" in ys:
        axes.fill_between(x, ys["low"], ys["high"], step=step, color=ink, alpha=0.16, linewidth=0)


def _draw_profile(own: scores.Scores, title: str) -> Any:
    from matplotlib.figure import Figure

    figure = Figure(SIZE, layout="constrained")
    title += f", {len(own['common'])} task{'s' * (len(own['common']) > 1)}"
    label = "score: win rate against the suite"
    axes = figure.subplots()
    axes.set(title=title, xlim=(0, 1), ylim=(0, 1.02), xlabel=label, ylabel="share of seeds that score more")
    for k, agent in enumerate(own["iqm"]):
        each = own["profile"][agent]
        _line(axes, k, agent, own["profile"]["thresholds"], {"mean": each["value"], **each}, "post")
    axes.legend(frameon=False)
    return figure


def _draw_curves(own: scores.Scores, title: str) -> Any:
    from matplotlib.figure import Figure

    curves = dict[str, dict[str, list[Any]]]()  # by task and agent: the points that were measured
    for task, of_task in sorted(own["tasks"].items()):
        for agent, each in of_task.items():
            if points := [point for point in each["curve"] if "mean" in point]:
                curves.setdefault(task, {})[agent] = points
    numbers = {agent: k for k, agent in enumerate(sorted({*itertools.chain(*curves.values())}))}
    across = min(3, len(curves))
    down = -(-len(curves) // across)
    figure = Figure((SIZE[0], 0.4 + 2.0 * down), layout="constrained")
    figure.suptitle(title)
    panels = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    for axes, (task, of_task) in zip(panels, curves.items(), strict=False):
        axes.set_title(task, fontsize="small")
        axes.set(ylim=(0, 1), xlabel="million agent-steps")
        for agent, points in of_task.items():
            known = ("mean", "low", "high") if "low" in points[0] else ("mean",)
            ys = {key: [point.get(key, point["mean"]) for point in points] for key in known}
            _line(axes, numbers[agent], agent, [point["steps"] / 1e6 for point in points], ys)
    for axes in panels[len(curves) :]:
        axes.axis("off")
    lines = {line.get_label(): line for axes in panels for line in axes.lines}
    panels[0].legend(lines.values(), lines, frameon=False, fontsize="x-small")
    panels[0].set_ylabel("games won")
    return figure
