"""Tables of scores: Markdown, CSV, a figure of performance profiles, and the JSON of marl-eval."""

import logging
from collections.abc import Iterator
from pathlib import Path

from ..base.errors import TrainingError
from ..base.files import write_files
from ..base.tables import csv_text, markdown_table
from . import scores
from .kept import TRAINED
from .marl_eval import RunMetrics, marl_eval_json

HEADS = ("agent", "score (IQM)", "95 %", "tasks", "seeds")
TASK_HEADS = (
    *("task", "agent", "score", "Elo", "best response wins", "trained in", "outside"),
    *("length", "kills", "damage", "heals given", "seeds", "agent-steps"),
)
PRINTED = ("length", "kills", "damage_dealt", "heals_given")  # figures of self-play in the table by task
OF_NO_TRACK, MET = "†", "‡"
logger = logging.getLogger("outlast")
COLUMNS = ("budget", "track", "task", "agent", "figure", "mean", "low", "high", "seeds")


def write(places: Path, folder: Path) -> list[Path]:
    """Write all tables of the results in a folder. Return the paths. Raises TrainingError."""
    found = scores.scores(places)
    contents = {
        folder / "table.md": markdown(found).encode(),
        folder / "table.csv": as_csv(found).encode(),
        **{folder / name: content for name, content in _more(found)},
    }
    write_files(contents)
    return list(contents)


def markdown(found: scores.Scores) -> str:
    """Return the tables of all budgets."""
    return "\n\n".join(part for budget, own in found["budgets"].items() for part in _budget(int(budget), own)) + "\n"


def as_csv(found: scores.Scores) -> str:
    """Return the CSV file: a row for every figure of every agent in every task."""
    rows = list[tuple[object, ...]]()
    for budget, own in found["budgets"].items():
        for task, of_task in own["tasks"].items():
            for agent, each in of_task["agents"].items():
                for name, figure in _named(each):
                    values = (figure["mean"], figure.get("low", ""), figure.get("high", ""), len(figure["seeds"]))
                    rows.append((budget, own["track"], task, agent, name, *values))
    return csv_text(COLUMNS, rows)


def _named(each: scores.Scores) -> Iterator[tuple[str, scores.Scores]]:
    """Yield the figures of an agent in a task, by name."""
    yield "score", each["score"]
    if each["rating"]:
        yield "rating", each["rating"]
    if each["exploitability"]:
        yield "exploitability", each["exploitability"]
    for key in ("games", "suite", "self_play"):
        yield from ((f"{key}/{name}", figure) for name, figure in each[key].items())


def _budget(budget: int, own: scores.Scores) -> Iterator[str]:
    track = f"track {own['track']}" if own["track"] else f"of no track: {own['games']} games a match"
    tasks = ", ".join(own["common"]) or "none"
    yield f"### {budget:,} agent-steps ({track})"
    others = ", ".join(agent for agent in own["improvement"] if agent not in own["compared"])
    fewer = f" Not in it: {others}, of fewer tasks." if others else ""
    yield (
        "Score: the interquartile mean over tasks and seeds, with its 95 % interval (stratified bootstrap), in the "
        f"tasks that all agents of this table have played: {tasks}.{fewer}"
    )
    yield markdown_table(HEADS, _overall(own))
    if len(own["improvement"]) > 1:
        yield (
            "Probability that a seed of the row scores more than one of the column (and in how many tasks that both "
            "have played):"
        )
        yield _improvement(own)
    yield (
        "By task, means over seeds with 95 % bootstrap intervals; kills and heals given are of one side in self-play, "
        "damage is of one agent:"
    )
    yield markdown_table(TASK_HEADS, _by_task(own))
    for task, each in own["tasks"].items():
        if each["cross_play"]["matches"]:
            yield f"{task}, wins of the row against the column, between seeds on the diagonal:"
            yield _cross(each["cross_play"])
    if any(not each["of_task"] for task in own["tasks"].values() for each in task["agents"].values()):
        yield f"{OF_NO_TRACK} not shown by a policy file to be trained in the game of the task, within the budget."
    if any(each["met"] for task in own["tasks"].values() for each in task["agents"].values()):
        yield f"{MET} it was trained against opponents of the suite, or by imitating them."


def _overall(own: scores.Scores) -> Iterator[list[str]]:
    """Yield a row for each agent, the highest score first."""
    for agent, found in sorted(own["iqm"].items(), key=lambda entry: -entry[1]["value"]):
        counts = {len(own["tasks"][task]["agents"][agent]["seeds"]) for task in own["common"]}
        ends = f"{found['low']:.3f} to {found['high']:.3f}" if "low" in found else "one seed"
        yield [_marked(agent, own), f"{found['value']:.3f}", ends, str(len(own["common"])), _range(counts)]


def _marked(agent: str, own: scores.Scores) -> str:
    """Return the agent with the marks that it has in any task."""
    each = [task["agents"][agent] for task in own["tasks"].values() if agent in task["agents"]]
    marks = OF_NO_TRACK * (not all(task["of_task"] for task in each)) + MET * any(task["met"] for task in each)
    return agent + marks


def _range(counts: set[int]) -> str:
    return str(min(counts)) if len(counts) == 1 else f"{min(counts)} to {max(counts)}"


def _improvement(own: scores.Scores) -> str:
    agents = list(own["improvement"])

    def cell(one: str, other: str) -> str:
        found = None if one == other else own["improvement"][one][other]
        return f"{found['value']:.2f} ({found['tasks']})" if found else ""

    return markdown_table(("", *agents), ([one, *(cell(one, other) for other in agents)] for one in agents))


def _by_task(own: scores.Scores) -> Iterator[list[str]]:
    for task, of_task in own["tasks"].items():
        for agent, each in of_task["agents"].items():
            outside = [figure["mean"] for name, figure in each["games"].items() if name != TRAINED]
            yield [
                task,
                agent + OF_NO_TRACK * (not each["of_task"]) + MET * bool(each["met"]),
                _cell(each["score"], 3),
                _rating(each["rating"]),
                _cell(each["exploitability"], 2),
                _cell(each["games"][TRAINED], 3) if outside else "",
                f"{sum(outside) / len(outside):.3f}" if outside else "",
                *(_cell(each["self_play"].get(name), 0 if name == "length" else 2) for name in PRINTED),
                str(len(each["seeds"])),
                "unknown" if None in each["steps"] else f"{max(each['steps']):,}",
            ]


def _cell(figure: scores.Scores | None, digits: int) -> str:
    """Return a mean with its interval; empty without a figure."""
    if figure is None:
        return ""
    ends = f" [{figure['low']:.{digits}f}, {figure['high']:.{digits}f}]" if "low" in figure else ""
    return f"{figure['mean']:.{digits}f}{ends}"


def _rating(figure: scores.Scores | None) -> str:
    """Return a rating with its interval over seeds; for one seed, with its standard error over games."""
    if figure is None:
        return ""
    return _cell(figure, 0) if "low" in figure else f"{figure['mean']:.0f} ± {figure['errors'][0]:.0f}"


def _cross(found: scores.Scores) -> str:
    rows = (
        [agent, *("" if rate is None else f"{rate:.3f}" for rate in row)]
        for agent, row in zip(found["agents"], found["wins"], strict=True)
    )
    return markdown_table(("", *found["agents"]), rows)


def _more(found: scores.Scores) -> Iterator[tuple[str, bytes]]:
    """Yield performance profiles and files for marl-eval, for each budget in which agents share a task."""
    from .profile import picture  # imported here, since it needs matplotlib

    for budget, own in found["budgets"].items():
        if own["common"]:
            yield f"profile-{budget}.png", picture(own, f"{int(budget):,} agent-steps")
            if runs := list(_runs(int(budget), own)):
                try:
                    yield f"marl_eval-{budget}.json", marl_eval_json("outlast", runs).encode()
                except TrainingError as error:  # marl-eval allows fewer names
                    logger.warning("marl_eval-%s.json is left out: %s", budget, error)


def _runs(budget: int, own: scores.Scores) -> Iterator[RunMetrics]:
    """Yield the runs for marl-eval: the compared agents, with the tasks and seeds that all of them have.

    They were evaluated once, at the end of training.
    """
    each = {(task, name): own["tasks"][task]["agents"][name] for task in own["common"] for name in own["compared"]}
    seeds = set.intersection(*(set(found["seeds"]) for found in each.values()))
    for (task, agent), found in each.items():
        for k, seed in enumerate(found["seeds"]):
            if seed in seeds:
                length = found["self_play"].get("length")  # missing if a result has no figures
                figures = {"score": found["score"]["seeds"][k]} | (
                    {"length": length["seeds"][k]} if length is not None else {}
                )
                yield RunMetrics(task, agent, seed, {budget: figures}, figures)
