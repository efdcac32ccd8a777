"""Scores: all values in the tables of agents, from results alone; the same results give the same bytes.

A value is a dict with a "status", and with "mean", "low", "high" (95 % bootstrap interval over seeds) and "seeds" if
something was measured. What was not measured has no number, and never counts as 0.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ..arena.ratings import anchored
from ..base import statistics
from ..base.errors import TrainingError
from .agents import Agent
from .manifest import Manifest
from .policy_facts import most_steps
from .result import AGENT, NUMBERS, SELF, Content, Pairing, Result, share
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


def scores(manifests: Sequence[Manifest]) -> Scores:
    """Return all scores of the results of these manifests, by budget. Raises TrainingError.

    Agents of several manifests are compared over tasks where their budgets and numbers of games are equal. An agent of
    two manifests must have another task in each.
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
                of_task[name] = _agent(manifest, name, task)
        own["pairs"] += _pairs(manifest, own["tasks"])
    for own in budgets.values():
        own |= _over_tasks(own["tasks"])
    return {"version": PROTOCOL, "manifests": [each.digest for each in manifests], "budgets": budgets}


def _agent(manifest: Manifest, name: str, task: Task) -> Scores:
    """Return the scores of an agent in a task."""
    agent, known, seeds = manifest.agents[name], suite(task), manifest.content["seeds"]
    results = {seed: manifest.result(name, task, seed) for seed in seeds}
    for found in results.values():
        check_planned(manifest, found, task)
    played = {seed: found.matches for seed, found in results.items()}

    def value(pairings: Iterable[Pairing], absent: str = MISSING) -> Value:
        """Return the mean share of games won in several matches."""
        each, of_seed = [*pairings], dict[int, float | None]()
        for seed, own in played.items():
            shares = [share(own[pairing]) for pairing in each if pairing in own]
            of_seed[seed] = float(np.mean(shares)) if each and len(shares) == len(each) else None
        return over_seeds(of_seed, absent)

    games = {game.name: value(Pairing(game.name, other) for other in known.members) for game in task.tests}
    outside = [game.name for game in task.tests if game.name != TRAINED] or [TRAINED]
    curve = [
        {"steps": _steps(results.values(), k)}
        | value((own for own in manifest.validations(agent, task) if own.candidate == k), UNPLANNED)
        for k in range(manifest.candidates(agent))
    ]
    first = results[seeds[0]].content["situations"] or {}
    policies = [found.content["policy"] for found in results.values() if found.content["policy"]]
    return {
        "seeds": [seed for seed in seeds if results[seed].content["policy"]],
        "steps": [policy["steps"] for policy in policies],
        "of_task": bool(policies) and all(_is_of_track(policy, manifest.content["budget"]) for policy in policies),
        "met": sorted({name for policy in policies for name in policy["met"]}),
        "score": value(Pairing(game, other) for game in outside for other in known.members),
        "games": games,
        "suite": {other: value([Pairing(TRAINED, other)]) for other in known.members},
        "mates": {
            mate: value(Pairing(TRAINED, other, mate) for other in known.mates)
            for mate in ((SELF, *known.mates) if task.mates else ())
        },  # against the same opponents
        "curve": curve,
        "rating": _rating(played, task),
        "exploitability": _exploitability(manifest, agent, played[seeds[0]]),
        "self_play": {figure: _figure(played, figure) for figure in OWN_FIGURES},
        "situations": dict(sorted(first.items())),
    }


def over_seeds(values: Mapping[int, float | None], absent: str = MISSING) -> Value:
    """Return a value from those of planned seeds; None: not there. absent: The status if none is there."""
    known = {seed: value for seed, value in values.items() if value is not None}
    if not known:
        return {"status": absent}
    each = [*known.values()]
    status = PARTLY if len(known) < len(values) else FEW if len(known) < LEAST else MEASURED
    low, high = statistics.interval(each) or (None, None)
    ends = {} if low is None else {"low": rounded(low), "high": rounded(high)}
    mean = {"mean": rounded(np.mean(each)), **ends} if status != PARTLY else {}  # who leaves out a seed gains nothing
    return {"status": status, **mean, "seeds": rounded(each)}


def check_planned(manifest: Manifest, found: Result, task: Task) -> None:
    """Raise TrainingError for matches that were not planned: nobody may choose among several plans afterwards."""
    agent, seed = manifest.agents[found.content["agent"]], found.content["seed"]
    planned = manifest.planned(agent, task, seed)
    if found.content["policy"] is None and any(pairing.candidate < 0 for pairing in found.matches):
        raise TrainingError(f"{found.name} has tests, but no policy that was chosen for them")
    responses = (name for name in found.content["responses"] if name not in manifest.responses(agent, seed))
    if more := [*responses, *(pairing for pairing in found.matches if pairing not in planned)]:
        raise TrainingError(f"{found.name}: {more[0]} is not in the manifest")
    for pairing, match in found.matches.items():
        games = sum(match[name] for name in NUMBERS)
        if games != manifest.games(pairing):
            raise TrainingError(f"{found.name}: {pairing} has {games} games, and {manifest.games(pairing)} are planned")


def _steps(results: Iterable[Result], number: int) -> int | None:
    """Return the largest number of agent-steps of a candidate over seeds; None: unknown."""
    found = [own.content["candidates"][number]["steps"] for own in results if len(own.content["candidates"]) > number]
    return max(found, default=None)


def _is_of_track(policy: Content, budget: int) -> bool:
    """Return whether a policy was trained in the game of the task, and no longer than the budget, by its own file.

    Only complete rollouts are collected, so it may be a little longer.
    """
    return bool(policy["of_task"] and policy["steps"] <= most_steps(budget))


def _rating(played: Mapping[int, Mapping[Pairing, Content]], task: Task) -> Value:
    """Return the rating on the fixed scale of the suite, and its errors over games by seed. It needs LEAST seeds."""
    rated = {name: member.rating for name, member in suite(task).members.items() if member.rating is not None}
    wanted = [Pairing(TRAINED, name) for name in rated]
    full = [seed for seed, own in played.items() if all(pairing in own for pairing in wanted)]
    if not rated or not full:
        return {"status": MISSING if rated else UNPLANNED}
    wins, draws, losses = (
        np.array([[played[seed][pairing][key] for pairing in wanted] for seed in full], np.float64) for key in NUMBERS
    )
    ratings, errors = anchored(wins, draws, losses, np.array([*rated.values()]))
    of_seed: dict[int, float | None] = dict.fromkeys(played) | dict(zip(full, ratings.tolist(), strict=True))
    value = over_seeds(of_seed) | {"errors": rounded(errors)}
    if value["status"] != MEASURED:
        value = {key: each for key, each in value.items() if key not in ("mean", "low", "high")}
    return value


def _exploitability(manifest: Manifest, agent: Agent, first: Mapping[Pairing, Content]) -> dict[str, Value]:
    """Return the shares of games that best responses win, by their names. first: The matches of the first seed."""
    if agent.function:
        return {"best response": {"status": IMPOSSIBLE}}
    seed, found = manifest.content["seeds"][0], dict[str, Value]()
    for name in manifest.responses(agent, seed):
        match = first.get(Pairing(TRAINED, name))
        found[name] = over_seeds({seed: None if match is None else 1 - share(match)})
    return found or {"best response": {"status": UNPLANNED}}


def _figure(played: Mapping[int, Mapping[Pairing, Content]], name: str) -> Value:
    """Return a figure of games against itself; NEVER if there was no occasion to measure it in any seed."""
    matches = {seed: own.get(Pairing(TRAINED, SELF)) for seed, own in played.items()}
    pairs = {seed: match["figures"].get(name) if match else None for seed, match in matches.items()}
    values = {seed: pair[0] if pair else None for seed, pair in pairs.items()}
    return over_seeds(values, NEVER if any(matches.values()) else MISSING)


def _pairs(manifest: Manifest, tasks: Mapping[str, Scores]) -> list[Scores]:
    """Return the planned comparisons, as one family: the level of each interval is 95 % for all of them together.

    "difference" is that of the scores, a mean over tasks; "direct" the share of games that the first won against the
    second. "verdict" says whether the difference is certainly larger than the effect of the manifest, or smaller.
    """
    found, effect = [], manifest.content["effect"]
    level = 1 - (1 - statistics.LEVEL) / max(1, len(manifest.content["pairs"]))
    for one, other in manifest.content["pairs"]:
        names = [task.name for task in manifest.tasks]
        each = [{name: _complete(tasks[name][agent]["score"]) for name in names} for agent in (one, other)]
        fewest = min(len(values) for own in each for values in own.values())
        entry: Scores = {"one": one, "other": other, "effect": effect, "direct": _direct(manifest, one, other)}
        if fewest < 2:
            found.append(entry | {"difference": {"status": FEW if fewest else MISSING}, "verdict": "open"})
            continue
        value, low, high = statistics.stratified_bootstrap(
            lambda a, b: statistics.mean(a) - statistics.mean(b), *each, level=level
        )
        verdict = (
            "more" if low > effect else "less" if high < -effect else "equal" if max(-low, high) < effect else "open"
        )
        status = MEASURED if fewest >= LEAST else FEW
        difference = {"status": status, "mean": rounded(value), "low": rounded(low), "high": rounded(high)}
        found.append(entry | {"difference": difference} | {"verdict": verdict if status == MEASURED else "open"})
    return found


def _complete(value: Value) -> list[float]:
    """Return the values of all planned seeds; none if one is missing."""
    return list(value["seeds"]) if "mean" in value else []


def _direct(manifest: Manifest, one: str, other: str) -> Value:
    """Return the share of games that one agent won against another one, a mean over tasks."""
    values = dict[int, float | None]()
    for seed in manifest.content["seeds"]:
        pairing, each = Pairing(TRAINED, AGENT + other), list[float]()
        for task in manifest.tasks:
            match = manifest.result(one, task, seed).matches.get(pairing)
            rival = manifest.result(other, task, seed).content["policy"]
            if match is not None and rival is not None and match["opponent"] == rival["digest"]:
                each.append(share(match))
        values[seed] = float(np.mean(each)) if len(each) == len(manifest.tasks) else None
    return over_seeds(values)


def _over_tasks(tasks: Mapping[str, Scores]) -> Scores:
    """Return interquartile means and performance profiles over tasks that several agents have played."""
    played = dict[str, dict[str, list[float]]]()
    for name, of_task in tasks.items():
        for agent, found in of_task.items():
            if "mean" in found["score"]:
                played.setdefault(agent, {})[name] = found["score"]["seeds"]
    agents, common = _compared(played) if played else ([], [])
    each = {agent: {name: played[agent][name] for name in common} for agent in agents if common}
    profile = {
        agent: _estimate(lambda given: statistics.performance_profile(given, THRESHOLDS), own)
        for agent, own in each.items()
    }
    return {
        "compared": agents,
        "common": common,
        "iqm": {agent: _estimate(statistics.iqm, own) for agent, own in each.items()},
        "profile": {"thresholds": rounded(THRESHOLDS), **profile},
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


def _estimate(statistic: Callable[..., Any], own: Mapping[str, Sequence[float]]) -> Scores:
    """Return a statistic over tasks and seeds, with its 95 % interval where every task has two seeds or more."""
    if any(len(values) < 2 for values in own.values()):
        return {"value": rounded(statistic(own))}
    return {key: rounded(value) for key, value in statistics.stratified_bootstrap(statistic, own)._asdict().items()}


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
    yield from ((f"situations/{name}", over_seeds({0: share})) for name, share in each["situations"].items())


def absent(found: Scores) -> int:
    """Return the number of planned values that are missing."""
    every = (
        each for own in found["budgets"].values() for of_task in own["tasks"].values() for each in of_task.values()
    )
    return sum(value["status"] in (MISSING, PARTLY) for each in every for _, value in named(each))


def lines(found: Scores) -> Iterator[str]:
    """Yield a summary of the scores, as lines to print."""
    for budget, own in found["budgets"].items():
        yield f"{int(budget):,} agent-steps" + (f", track {own['track']}" if own["track"] else ", of no track")
        for task, of_task in own["tasks"].items():
            for agent, each in of_task.items():
                mean = f"{each['score']['mean']:.3f}" if "mean" in each["score"] else each["score"]["status"]
                rating = f", Elo {each['rating']['mean']:.0f}" if "mean" in each["rating"] else ""
                yield f"  {task}, {agent}: score {mean}{rating}, seeds {len(each['seeds'])}"
