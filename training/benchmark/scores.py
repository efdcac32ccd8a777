"""Scores: all values in the tables of agents, from results alone; the same results give the same bytes.

A value is a dict with a "status", and with "mean", "low", "high" (95 % bootstrap interval over seeds) and "seeds" if
something was measured. What was not measured has no number, and never counts as 0.
"""

import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..arena.ratings import anchored
from ..base import statistics
from ..base.errors import TrainingError
from .entry import Entry, most_steps
from .manifest import Manifest
from .result import AGENT, NUMBERS, SELF, Content, Pairing, share
from .suite import suite
from .tasks import PROTOCOL, TRAINED, Task

NAME = "scores.json"
DIGITS = 6  # significant digits of computed values
LEAST = 5  # seeds of a rating, and of a verdict
THRESHOLDS = np.linspace(0, 1, 101)  # of the performance profile
OWN_FIGURES = (
    *("length", "kills", "damage_dealt", "deaths_melee", "deaths_zone", "strikes", "strikes_landed", "heals_used"),
    *("heals_in_need", "heals_given", "boxes_placed", "boxes_between", "enemy_distance", "mate_distance"),
    *("ticks_seen", "locks0", "locks1", "held0", "held1"),
)  # of self-play; not the return, which is nearly constant in zero-sum games
# statuses: with all planned seeds, LEAST or more, or fewer; with some of them; with none of them
MEASURED, FEW, PARTLY, MISSING = "measured", "few seeds", "incomplete", "missing"
UNPLANNED, IMPOSSIBLE, NEVER = "not planned", "not possible", "no occasion"
Scores = dict[str, Any]
Value = dict[str, Any]
Sample = Mapping[str, Sequence[float]]  # values of seeds, by task
Played = list[dict[Pairing, Content]]  # the matches of each seed


def scores(manifests: Sequence[Manifest]) -> Scores:
    """Return all scores of the results of these manifests, by budget. Raises TrainingError.

    Agents of several manifests are compared where budgets are equal; an agent of two must have another task in each.
    """
    budgets: dict[str, Scores] = {}
    for manifest in manifests:
        content = manifest.content
        own = budgets.setdefault(str(content["budget"]), {"games": content["games"], "tasks": {}, "pairs": []})
        if own["games"] != content["games"]:
            raise TrainingError(f"tests of {own['games']} and {content['games']} games cannot be compared: score apart")
        own["track"] = manifest.track
        for task in manifest.tasks:
            of_task = own["tasks"].setdefault(task.name, {})
            for name in manifest.agents:
                if name in of_task:
                    raise TrainingError(f"{name} has results in {task.name} twice: one of them in {manifest.folder}")
                of_task[name] = _agent([Entry(manifest, name, task, seed) for seed in content["seeds"]])
        own["pairs"] += _pairs(manifest, own["tasks"])
    for own in budgets.values():
        own |= _over_tasks(own["tasks"])
    return {"version": PROTOCOL, "manifests": [each.digest for each in manifests], "budgets": budgets}


def _agent(entries: Sequence[Entry]) -> Scores:
    """Return the scores of an agent in a task, by its entries of all seeds."""
    for entry in entries:
        entry.check_planned()
    first, task, known = entries[0], entries[0].task, suite(entries[0].task)
    played = [entry.matches for entry in entries]

    def value(pairings: Iterable[Pairing], absent: str = MISSING) -> Value:
        """Return the mean share of games won in several matches."""
        wanted = [*pairings]
        each = [[share(own[pairing]) for pairing in wanted if pairing in own] for own in played]
        return over_seeds([float(np.mean(own)) if own and len(own) == len(wanted) else None for own in each], absent)

    candidates = [entry.content["candidates"] for entry in entries]
    outside = [game.name for game in task.tests if game.name != TRAINED] or [TRAINED]
    policies = [entry.content["policy"] for entry in entries if entry.content["policy"]]
    most = most_steps(first.manifest.content["budget"])
    mates = (SELF, *known.mates) if task.mates else ()
    lost = {name: first.matches.get(Pairing(TRAINED, name)) for name in first.responses}
    responses = {name: over_seeds([1 - share(match) if match else None]) for name, match in lost.items()}
    if not responses:
        responses = {"best response": {"status": IMPOSSIBLE if first.agent.function else UNPLANNED}}
    return {
        "seeds": [entry.seed for entry in entries if entry.content["policy"]],
        "steps": [policy["steps"] for policy in policies],
        "of_task": bool(policies) and all(own["of_task"] and own["steps"] <= most for own in policies),
        "met": sorted({name for policy in policies for name in policy["met"]}),
        "score": value(Pairing(game, other) for game in outside for other in known.members),
        "games": {game.name: value(Pairing(game.name, other) for other in known.members) for game in task.tests},
        "suite": {other: value([Pairing(TRAINED, other)]) for other in known.members},
        "mates": {mate: value(Pairing(TRAINED, other, mate) for other in known.mates) for mate in mates},
        "curve": [
            {"steps": max((own[k]["steps"] for own in candidates if len(own) > k), default=None)}
            | value((own for own in first.planned if own.candidate == k), UNPLANNED)
            for k in range(first.candidates)
        ],
        "rating": _rating(played, task),
        "exploitability": responses,
        "self_play": {figure: _figure(played, figure) for figure in OWN_FIGURES},
        "situations": dict(sorted((first.content["situations"] or {}).items())),
    }


def over_seeds(values: Sequence[float | None], absent: str = MISSING) -> Value:
    """Return a value from those of planned seeds; None: not there. absent: The status if none is there."""
    each = [value for value in values if value is not None]
    if not each:
        return {"status": absent}
    status = PARTLY if len(each) < len(values) else FEW if len(each) < LEAST else MEASURED
    mean = {} if status == PARTLY else _estimate(statistics.mean, {"": each}, name="mean")  # a lost seed gains nothing
    return {"status": status, **mean, "seeds": rounded(each)}


def _rating(played: Played, task: Task) -> Value:
    """Return the rating on the fixed scale of the suite, and its errors over games by seed. It needs LEAST seeds."""
    rated = {Pairing(TRAINED, name): own.rating for name, own in suite(task).members.items() if own.rating is not None}
    full = [rated.keys() <= own.keys() for own in played]
    if not rated or not any(full):
        return {"status": MISSING if rated else UNPLANNED}
    own = list(itertools.compress(played, full))
    won, drawn, lost = (np.array([[each[pairing][key] for pairing in rated] for each in own]) for key in NUMBERS)
    ratings, errors = map(iter, anchored(won, drawn, lost, np.array([*rated.values()])))
    value = over_seeds([float(next(ratings)) if there else None for there in full]) | {"errors": rounded([*errors])}
    known = value["status"] == MEASURED
    return {key: own for key, own in value.items() if known or key not in ("mean", "low", "high")}


def _figure(played: Played, name: str) -> Value:
    """Return a figure of games against itself; NEVER if there was no occasion to measure it in any seed."""
    matches = [own.get(Pairing(TRAINED, SELF)) for own in played]
    pairs = [match["figures"].get(name) if match else None for match in matches]
    return over_seeds([pair[0] if pair else None for pair in pairs], NEVER if any(matches) else MISSING)


def _pairs(manifest: Manifest, tasks: Mapping[str, Scores]) -> list[Scores]:
    """Return the planned comparisons, as one family: the level of each interval is 95 % for all of them together.

    "difference" is that of the scores, a mean over tasks; "direct" the share of games that the first won against the
    second. "verdict" says whether the difference is certainly larger than the effect of the manifest, or smaller.
    """
    found, effect = [], manifest.content["effect"]
    level = 1 - (1 - statistics.LEVEL) / max(1, len(manifest.content["pairs"]))
    for one, other in manifest.content["pairs"]:
        values = [{task.name: tasks[task.name][agent]["score"] for task in manifest.tasks} for agent in (one, other)]
        each = [{name: own["seeds"] if "mean" in own else [] for name, own in of.items()} for of in values]
        fewest, verdict = min(len(seeds) for own in each for seeds in own.values()), "open"
        difference: Value = {"status": MEASURED if fewest >= LEAST else FEW if fewest else MISSING}
        if fewest > 1:
            difference |= _estimate(
                lambda a, b: statistics.mean(a) - statistics.mean(b), *each, level=level, name="mean"
            )
        if fewest >= LEAST:
            low, high = difference["low"], difference["high"]
            equal = "equal" if max(-low, high) < effect else "open"
            verdict = "more" if low > effect else "less" if high < -effect else equal
        entry = {"one": one, "other": other, "effect": effect, "direct": _direct(manifest, one, other)}
        found.append(entry | {"difference": difference, "verdict": verdict})
    return found


def _direct(manifest: Manifest, one: str, other: str) -> Value:
    """Return the share of games that one agent won against another one, a mean over tasks."""
    values = list[float | None]()
    for seed in manifest.content["seeds"]:
        each = list[float]()
        for entry in (Entry(manifest, one, task, seed) for task in manifest.tasks):
            match, rival = entry.matches.get(Pairing(TRAINED, AGENT + other)), entry.rival(other).content["policy"]
            if match and rival and match["opponent"] == rival["digest"]:
                each.append(share(match))
        values.append(float(np.mean(each)) if len(each) == len(manifest.tasks) else None)
    return over_seeds(values)


def _over_tasks(tasks: Mapping[str, Scores]) -> Scores:
    """Return interquartile means and performance profiles over tasks that several agents have played."""
    played = dict[str, dict[str, list[float]]]()
    for name, agent in ((name, agent) for name, of_task in tasks.items() for agent in of_task):
        if "mean" in (score := tasks[name][agent]["score"]):
            played.setdefault(agent, {})[name] = score["seeds"]
    agents, common = _compared(played) if played else ([], [])
    each = {agent: {name: played[agent][name] for name in common} for agent in agents if common}
    profile = functools.partial(statistics.performance_profile, thresholds=THRESHOLDS)
    profiles = {agent: _estimate(profile, own) for agent, own in each.items()}
    return {
        "compared": agents,
        "common": common,
        "iqm": {agent: _estimate(statistics.iqm, own) for agent, own in each.items()},
        "profile": {"thresholds": rounded(THRESHOLDS), **profiles},
    }


def _compared(played: Mapping[str, Iterable[str]]) -> tuple[list[str], list[str]]:
    """Return agents and tasks for scores over tasks, where each of these agents has played each of these tasks.

    Of all such choices with several agents, the one with the most results is taken; none if no two share a task.
    """
    choices = {frozenset(own) for own in played.values()}
    while more := {one & other for one in choices for other in choices} - choices:
        choices |= more
    found = [(sorted(agent for agent, own in played.items() if tasks <= {*own}), sorted(tasks)) for tasks in choices]
    able = [each for each in found if len(each[0]) >= min(2, len(played))]
    return max(able, key=lambda each: (len(each[0]) * len(each[1]), len(each[0]), each[1]))


def _estimate(
    statistic: Callable[..., Any], *own: Sample, level: float = statistics.LEVEL, name: str = "value"
) -> Value:
    """Return a statistic over tasks and seeds, with its interval where every task has two seeds or more."""
    if any(len(seeds) < 2 for values in own for seeds in values.values()):
        return {name: rounded(statistic(*own))}
    found = statistics.stratified_bootstrap(statistic, *own, level=level)
    return {name: rounded(found.value), "low": rounded(found.low), "high": rounded(found.high)}


def rounded(values: Any) -> Any:
    """Round numbers, as lists where there are several: their last digits depend on a machine's order of summation."""
    if np.ndim(values):
        return [rounded(value) for value in values]
    return float(f"{float(values):.{DIGITS}g}")


def named(each: Scores) -> Iterator[tuple[str, Value]]:
    """Yield the values of an agent in a task, by name."""
    yield from (("score", each["score"]), ("rating", each["rating"]))
    for key in ("exploitability", "games", "suite", "mates", "self_play"):
        yield from ((f"{key}/{name}", value) for name, value in each[key].items())
    yield from ((f"curve/{value['steps']}", value) for value in each["curve"])
    yield from ((f"situations/{name}", over_seeds([share])) for name, share in each["situations"].items())


def by_agent(found: Scores) -> Iterator[tuple[str, Scores, str, str, Scores]]:
    """Yield the budget and its scores, the task, the agent and the scores of that agent."""
    for budget, own in found["budgets"].items():
        for task, of_task in sorted(own["tasks"].items()):
            yield from ((budget, own, task, agent, each) for agent, each in sorted(of_task.items()))


def absent(found: Scores) -> int:
    """Return the number of planned values that are missing."""
    return sum(value["status"] in (MISSING, PARTLY) for *_, each in by_agent(found) for _, value in named(each))


def lines(found: Scores) -> Iterator[str]:
    """Yield a summary of the scores, as lines to print."""
    last = ""
    for budget, own, task, agent, each in by_agent(found):
        if budget != last:
            yield f"{int(budget):,} agent-steps" + (f", track {own['track']}" if own["track"] else ", of no track")
        last, score, rating = budget, each["score"], each["rating"]
        mean = f"{score['mean']:.3f}" if "mean" in score else score["status"]
        elo = f", Elo {rating['mean']:.0f}" if "mean" in rating else ""
        yield f"  {task}, {agent}: score {mean}{elo}, seeds {len(each['seeds'])}"
