"""Scores: all values in the tables of agents, from results alone; the same results give the same bytes.

The score of an entry is its mean win rate against the suite, where a draw counts half and every opponent counts the
same; in tasks of generalisation, it is the win rate in the games outside of training. In every task it is from 0 to 1,
so that tasks can be compared.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..arena.ratings import anchored
from ..base import statistics
from ..base.errors import TrainingError
from . import crossplay
from .kept import TRAINED, find
from .result import BEST, SELF, Content, Result
from .suite import missing, other_games, suite
from .tasks import PROTOCOL, Task, task_of, track_of

NAME = "scores.json"
DIGITS = 6  # significant digits of computed values
THRESHOLDS = np.linspace(0, 1, 101)  # of the performance profile
OWN_FIGURES = (
    *("length", "kills", "damage_dealt", "deaths_melee", "deaths_zone", "strikes", "strikes_landed", "heals_used"),
    *("heals_in_need", "heals_given", "boxes_placed", "boxes_between", "enemy_distance", "mate_distance"),
)  # of self-play; not the return, which is nearly constant in zero-sum games
Scores = dict[str, Any]
Values = list[float]  # one for each seed


def by_budget(places: Path) -> dict[int, list[Result]]:
    """Return the results in a folder, by budget. Raises TrainingError."""
    found: dict[int, list[Result]] = {}
    for entry in find(places):
        _check_place(entry)
        found.setdefault(entry.content["budget"], []).append(entry)
    return dict(sorted(found.items()))


def task_folders(entries: Sequence[Result]) -> dict[Path, list[Result]]:
    """Return the results by the folder of their task."""
    found: dict[Path, list[Result]] = {}
    for entry in entries:
        found.setdefault(entry.task_folder, []).append(entry)
    return found


def scores(places: Path) -> Scores:
    """Return all scores of the results in a folder, by budget. Raises TrainingError."""
    budgets = {str(budget): _budget(budget, entries) for budget, entries in by_budget(places).items()}
    return {"version": PROTOCOL, "budgets": budgets}


def _budget(budget: int, entries: Sequence[Result]) -> Scores:
    """Return the scores of entries of one budget: of each task, and over tasks that several agents have played."""
    folders = task_folders(entries)
    first = dict[str, Path]()
    for folder in folders:
        if (other := first.setdefault(folder.name, folder)) != folder:
            raise TrainingError(f"{other} and {folder} both hold results of {folder.name}: move them into one folder")
    tasks = {folder.name: _task(folder, own) for folder, own in sorted(folders.items())}
    played: dict[str, dict[str, Values]] = {}
    for name, task in tasks.items():
        for agent, found in task["agents"].items():
            played.setdefault(agent, {})[name] = found["score"]["seeds"]
    agents, (compared, common) = sorted(played), _compared(played)
    each = {agent: {name: played[agent][name] for name in common} for agent in compared if common}
    found = sorted({entry.content["games"] for entry in entries})
    if len(found) > 1:
        raise TrainingError(
            f"matches of {' and '.join(map(str, found))} games cannot be compared: score them one by one"
        )
    (games,) = found
    return {
        "track": track_of(budget, games),
        "games": games,
        "tasks": tasks,
        "compared": compared,
        "common": common,
        "iqm": {agent: _estimate(statistics.iqm, own) for agent, own in each.items()},
        "improvement": {one: {other: _improvement(played[one], played[other]) for other in agents} for one in agents},
        "profile": {"thresholds": _rounded(THRESHOLDS), **{agent: _profile(own) for agent, own in each.items()}},
    }


def _compared(played: Mapping[str, Iterable[str]]) -> tuple[list[str], list[str]]:
    """Return agents and tasks for scores over tasks, where each of these agents has played each of these tasks.

    Of all such choices with several agents, the one with the most results is taken. There are no tasks if no two
    agents share one.

    played: The tasks of each agent.
    """
    choices = {frozenset(own) for own in played.values()}
    while more := {one & other for one in choices for other in choices} - choices:
        choices |= more
    found = [(sorted(agent for agent, own in played.items() if tasks <= {*own}), sorted(tasks)) for tasks in choices]
    able = [each for each in found if len(each[0]) >= min(2, len(played))]
    return max(able, key=lambda each: (len(each[0]) * len(each[1]), len(each[0]), each[1]))


def _improvement(one: Mapping[str, Values], other: Mapping[str, Values]) -> Scores | None:
    """Return the probability that one agent scores more in the tasks that both have played; None without such tasks."""
    both = [name for name in one if name in other]
    if not both:
        return None
    pair = ({name: own[name] for name in both} for own in (one, other))
    return _estimate(statistics.probability_of_improvement, *pair) | {"tasks": len(both)}


def _task(folder: Path, entries: Sequence[Result]) -> Scores:
    task, agents = task_of(folder.name), dict[str, list[Result]]()
    for entry in sorted(entries, key=lambda entry: entry.content["seed"]):
        agents.setdefault(entry.content["agent"], []).append(entry)
    return {
        "agents": {agent: _agent(task, own) for agent, own in sorted(agents.items())},
        "cross_play": _cross_play(folder, entries),
    }


def _agent(task: Task, entries: Sequence[Result]) -> Scores:
    """Return the scores of an agent in a task: for each seed, with means and intervals over seeds."""
    members = {member.name: member for member in suite(task)}
    for entry in entries:
        if absent := missing(entry, task, members):
            raise TrainingError(f"{entry.folder} is not complete: {absent[0][1]} is missing; run it again to continue")
        if other := other_games(entry.content, task):
            raise TrainingError(f"{entry.folder}: {other}")
        for match in entry.matches:
            name = match["against"]
            if name in members and match["opponent"] != members[name].digest:
                raise TrainingError(f"{entry.folder}: its opponent {name} is not the one of the suite")
    _check_trainings(entries)
    rates = {game.name: [_suite_rate(entry, game.name, members) for entry in entries] for game in task.games}
    outside = [name for name in rates if name != TRAINED]
    score = np.mean([rates[name] for name in outside or [TRAINED]], 0)
    own = [entry.against[TRAINED, SELF]["figures"][0] for entry in entries]
    return {
        "seeds": [entry.content["seed"] for entry in entries],
        "steps": [entry.content["policy"]["steps"] for entry in entries],
        "of_task": all(_is_of_track(entry) for entry in entries),
        "met": sorted({name for entry in entries for name in entry.content["policy"]["met"]}),
        "score": _over_seeds(score),
        "games": {name: _over_seeds(values) for name, values in rates.items()},
        "suite": {name: _over_seeds([rate(entry.against[TRAINED, name]) for entry in entries]) for name in members},
        "self_play": {
            name: _over_seeds([each[name][0] for each in own])
            for name in OWN_FIGURES
            if all(name in each for each in own)
        },
        "rating": _ratings(entries, members),
        "exploitability": _exploitability(entries),
        "seconds": _seconds(entries),
    }


def _check_trainings(entries: Sequence[Result]) -> None:
    """Raise TrainingError for seeds with the same policy: their interval would not cover other trainings."""
    seeds: dict[str, int] = {}
    for entry in entries:
        policy, seed = entry.content["policy"], entry.content["seed"]
        first = seeds.setdefault(policy["digest"], seed)
        if first != seed and policy["steps"] is not None:  # functions get the seed
            raise TrainingError(f"{entry.folder}: its policy is that of seed {first}, not another training: remove it")


def rate(match: Content) -> float:
    """Return the share of games that the first policy won; a draw counts half."""
    return float((match["won"] + match["drawn"] / 2) / match["games"])


def _suite_rate(entry: Result, game: str, members: dict[str, Any]) -> float:
    return float(np.mean([rate(entry.against[game, name]) for name in members]))


def _is_of_track(entry: Result) -> bool:
    """Return whether a policy was trained in the game of the task, and no longer than the budget, by its own file.

    Only complete rollouts are collected, so it may be a little longer.
    """
    policy = entry.content["policy"]
    return bool(policy["of_task"] and policy["steps"] <= 1.01 * entry.content["budget"] + 2**16)


def _ratings(entries: Sequence[Result], members: dict[str, Any]) -> Scores | None:
    """Return ratings against the opponents of fixed rating; None if the task has none.

    "errors" are over games, one for each seed; "low" and "high" are over seeds.
    """
    rated = [name for name, member in members.items() if member.rating is not None]
    if not rated:
        return None
    wins, draws, losses = (
        np.array([[entry.against[TRAINED, name][key] for name in rated] for entry in entries], np.float64)
        for key in ("won", "drawn", "lost")
    )
    ratings, errors = anchored(wins, draws, losses, np.array([members[name].rating for name in rated]))
    return _over_seeds(ratings) | {"errors": _rounded(errors)}


def _exploitability(entries: Sequence[Result]) -> Scores | None:
    """Return the win rates of best responses; None unless every seed has one."""
    found = [entry.against.get((TRAINED, BEST)) for entry in entries]
    known = [match for match in found if match is not None]
    return _over_seeds([1 - rate(match) for match in known]) if len(known) == len(found) else None


def _seconds(entries: Sequence[Result]) -> Scores:
    """Return the seconds of a seed by the kind of work, means over seeds: CPU and wall clock."""
    names = sorted({name for entry in entries for name in entry.content["seconds"]})
    return {name: _rounded(np.mean([entry.content["seconds"].get(name, 0) for entry in entries])) for name in names}


def _cross_play(folder: Path, entries: Sequence[Result]) -> Scores:
    """Win rates of the agent of each row against that of each column: means over all pairs of their seeds.

    For an agent against itself, it is the mean over pairs of seeds of the lower seed's win rate. None: not yet played.
    """
    known, found, matches = crossplay.load(folder), dict[tuple[str, str], list[float]](), 0
    for one, other in crossplay.pairs(entries):
        match = known.get((one.name, other.name))
        if match is not None and crossplay.is_of(match, one, other):
            matches += 1
            pair = one.content["agent"], other.content["agent"]
            found.setdefault(pair, []).append(rate(match))
            if pair[0] != pair[1]:
                found.setdefault(pair[::-1], []).append(1 - rate(match))
    agents = sorted({entry.content["agent"] for entry in entries})
    wins = [[_mean(found.get((one, other), [])) for other in agents] for one in agents]
    return {"agents": agents, "wins": wins, "matches": matches}


def _mean(values: Sequence[float]) -> float | None:
    return float(_rounded(np.mean(values))) if values else None


def _over_seeds(values: Any) -> Scores:
    """Return the values of seeds, with their mean and its 95 % interval; for one seed without an interval."""
    low, high = statistics.interval(values) or (None, None)
    known = {} if low is None else {"low": _rounded(low), "high": _rounded(high)}
    return {"seeds": _rounded(values), "mean": _rounded(np.mean(values)), **known}


def _estimate(statistic: Callable[..., Any], *each: Any) -> Scores:
    """Return a statistic over tasks and seeds, with its 95 % interval where every task has two seeds or more."""
    if any(len(values) < 2 for own in each for values in own.values()):
        return {"value": _rounded(statistic(*each))}
    return {key: _rounded(value) for key, value in statistics.stratified_bootstrap(statistic, *each)._asdict().items()}


def _profile(own: Any) -> Scores:
    return _estimate(lambda given: statistics.performance_profile(given, THRESHOLDS), own)


def _rounded(values: Any) -> Any:
    """Round numbers, as lists where there are several: their last digits depend on a machine's order of summation."""
    if np.ndim(values):
        return [_rounded(value) for value in values]
    return float(f"{float(values):.{DIGITS}g}")


def _check_place(entry: Result) -> None:
    """Raise TrainingError for a result in a folder of another name: the folder decides the comparisons."""
    content, parts = entry.content, entry.folder.resolve().parts
    wanted = (str(content["budget"]), content["task"], content["agent"], str(content["seed"]))
    if parts[-len(wanted) :] != wanted:
        raise TrainingError(f"{entry.folder} holds the result of {'/'.join(wanted)}: move it to a folder of that name")


def lines(found: Scores) -> Iterator[str]:
    """Yield a summary of the scores, as lines to print."""
    for budget, own in found["budgets"].items():
        yield f"{int(budget):,} agent-steps" + (f", track {own['track']}" if own["track"] else ", of no track")
        for task, of_task in own["tasks"].items():
            for agent, each in of_task["agents"].items():
                rating = each["rating"]
                elo = f", Elo {rating['mean']:.0f}" if rating else ""
                yield f"  {task}, {agent}: score {each['score']['mean']:.3f}{elo}, seeds {len(each['seeds'])}"
