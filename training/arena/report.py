"""The results of an evaluation, as tables to read and as files."""

import csv
import io
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.scenarios.scenario import Scenario
from outlast.envs.storage import strict_json
from outlast.envs.text_table import text_table

from ..base.errors import TrainingError
from ..base.files import check_results, read_text, write_files
from .groups import Groups, group_policies
from .match import Array, Estimates, Pairing
from .players import Contender

RESULTS = ("wins", "wins_first", "wins_second", "length", "life", "return", "kills")  # and deaths by damage type
FILES = TABLES, FIGURES, RATINGS, GROUPS = "evaluation.json", "figures.csv", "ratings.csv", "groups.csv"
FIRST = ("policy", "against")
INTERVAL = ("value", "low", "high")
CERTAIN = 3.0  # standard errors from which on a difference between the sides is worth a line
OVER_GAMES = "std. errors (±) are over games of these very policies, and say nothing of other training seeds"
OVER_SEEDS = "95 % intervals over training seeds and games, by bootstrap"
UNBOUNDED = "; inf: no game bounds the rating on that side"


class EvaluationResult(Protocol):
    """What a report needs of an Evaluation."""

    scenario: Scenario
    chosen: list[Contender]
    pairings: list[Pairing]
    seed: int
    worlds: int
    each: int

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairings that there will be."""

    @property
    def episodes(self) -> int:
        """Episodes of each pairing."""

    @property
    def complete(self) -> bool:
        """Whether all pairings have been played."""

    def ratings(self) -> tuple[Array, Array] | None:
        """Return Elo ratings and their standard errors."""

    def groups(self) -> Groups | None:
        """Return ratings and wins of groups of runs. Raises TrainingError."""


def text(evaluation: EvaluationResult, width: int | None = None) -> str:
    """Return all tables under a heading; of an incomplete evaluation, the tables of what is complete.

    width: characters in a line of a table, see envs.text_table.
    """
    if not evaluation.pairings:
        return "no pairing is complete"
    parts = [_heading(evaluation), _ratings(evaluation), _wins(evaluation, width), _sides(evaluation)]
    parts += _groups(evaluation, width)
    names = list(evaluation.pairings[0].results.figures)
    results = [*RESULTS, *(name for name in names if name.startswith("deaths_"))]
    others = [name for name in names if name not in results]
    parts += [_figures(evaluation, some, width) for some in (results, others)]
    return "\n\n".join(filter(None, parts))


def _heading(evaluation: EvaluationResult) -> str:
    """What was played, and the files of those policies whose labels do not name them."""
    name, each, worlds = evaluation.scenario.name, evaluation.each, evaluation.worlds
    played = f"{len(evaluation.pairings)} pairings of {evaluation.episodes:,} episodes"
    lines = [f"{name}, seed {evaluation.seed}: {played}, {each} in each of {worlds} worlds"]
    lines += [f"{chosen.label}: {chosen.text}" for chosen in evaluation.chosen if chosen.text != chosen.label]
    lines += [OVER_GAMES]
    return "\n".join(lines)


def write_tables(evaluation: EvaluationResult, folder: Path) -> list[Path]:
    """Write evaluation.json with everything; figures.csv, ratings.csv and groups.csv with the numbers.

    Raises TrainingError.
    """
    figures = [(*names, name, *row) for names, rows in _rows(evaluation) for name, row in rows.items()]
    contents = {
        TABLES: json.dumps(_json(_everything(evaluation)), indent=1, allow_nan=False) + "\n",
        FIGURES: _csv((*FIRST, "figure", "mean", "error"), figures),
        RATINGS: _csv(("policy", "elo", "error"), _rated(evaluation)),
        GROUPS: _csv(("group", "runs", "against", "figure", *INTERVAL), _group_rows(evaluation)),
    }
    write_files({folder / name: content.encode() for name, content in contents.items()})
    return [folder / name for name in contents]


def check_folder(evaluation: EvaluationResult, folder: Path) -> None:
    """Raise TrainingError if tables cannot be written, or would replace those of another evaluation.

    That is one of another game or of other policies.
    """
    check_results(folder / name for name in FILES)
    path, now = folder / TABLES, json.loads(json.dumps(_json(_played(evaluation))))
    if not path.exists():
        return
    cure = "choose another folder with --out, or remove what is there"
    try:
        found = json.loads(read_text(path))
        there = {key: found[key] for key in now}
        who = ", ".join(policy["policy"] for policy in there["policies"])
        about = f"{there['scenario']['name']} with {who}"
    except (*strict_json.BROKEN, LookupError):
        raise TrainingError(f"{path} is no evaluation, and would be replaced: {cure}") from None
    if there != now:
        raise TrainingError(f"{folder} holds another evaluation, of {about}: {cure}")


def _ratings(evaluation: EvaluationResult) -> str:
    rows = sorted(_rated(evaluation), key=lambda row: -row[1])
    cells = [(label, f"{rating:.0f}", f"{error:.0f}") for label, rating, error in rows]
    return text_table(cells, ("Elo (mean 1000)", "rating", "std. error"), left=1) if cells else ""


def _wins(evaluation: EvaluationResult, width: int | None) -> str:
    """Shares of episodes that each policy wins against each other; draws count half."""
    labels = [contender.label for contender in evaluation.chosen]
    rates = {(i, j): rows["wins"] for (i, j), rows in _estimates(evaluation)}
    rows = [
        (label, *(_cell(*rates.get((i, j), (np.nan, 0))) for j in range(len(labels)))) for i, label in enumerate(labels)
    ]
    return text_table(rows, ("wins of, against", *labels), left=1, width=width)


def _sides(evaluation: EvaluationResult) -> str:
    """A line on the pairing in which the share of wins depends most on the side played; "" if it does in none."""
    found = {}
    for pair, figures in _rows(evaluation):
        (first, one), (second, other) = figures["wins_first"], figures["wins_second"]
        error = np.hypot(one, other) + 2 / evaluation.episodes  # not 0 where all of a few games were won
        if abs(first - second) > CERTAIN * error:
            found[pair] = abs(first - second), _cell(first, one), _cell(second, other)
    if not found:
        return ""
    most = max(found, key=lambda pair: found[pair][0])
    wins = "{} against {} wins {} on the first side, {} on the second".format(*most, *found[most][1:])
    many = len({frozenset(pair) for pair in found})
    return f"the side matters in {many} of {len(evaluation.pairings)} pairings, see wins_first and wins_second: {wins}"


def _groups(evaluation: EvaluationResult, width: int | None) -> Iterator[str]:
    """Tables of groups of runs, and a line on the policies whose errors say nothing about other seeds."""
    try:
        groups, found = group_policies(evaluation.chosen), evaluation.groups()
    except TrainingError as error:
        yield f"no groups of training seeds: {error}"
        return
    if found is not None:
        yield _group_ratings(evaluation, found)
        yield _group_wins(found, width)
    if alone := [group.label for group in groups if group.trained and len(group.members) == 1]:
        one, each = "one run: its error is of games alone, and says", "one run each: errors are of games alone, and say"
        yield f"{', '.join(alone)}: {one if len(alone) == 1 else each} nothing of other seeds"


def _group_ratings(evaluation: EvaluationResult, found: Groups) -> str:
    rows = [
        (group.label, str(len(group.members)) if group.trained else "-", f"{value:.0f}", f"[{low:.0f}, {high:.0f}]")
        for group, value, low, high in zip(found.groups, *found.ratings, strict=True)
    ]
    several = [group for group in found.groups if len(group.members) > 1]
    who = [f"{group.label}: {', '.join(evaluation.chosen[k].label for k in group.members)}" for group in several]
    table = text_table(rows, ("Elo of groups (mean 1000)", "runs", "rating", "95 % interval"), left=1)
    return "\n".join([table, *who, OVER_SEEDS + ("" if np.isfinite(found.ratings).all() else UNBOUNDED)])


def _group_wins(found: Groups, width: int | None) -> str:
    names = [group.label for group in found.groups]
    rows = [
        (name, *(_between(*ends) for ends in zip(*three, strict=True)))
        for name, *three in zip(names, *found.wins, strict=True)
    ]
    return text_table(rows, ("wins of group, against", *names), left=1, width=width)


def _between(value: float, low: float, high: float) -> str:
    return "-" if np.isnan(value) else f"{value:.3f} [{low:.3f}, {high:.3f}]"


def _group_rows(evaluation: EvaluationResult) -> list[tuple[Any, ...]]:
    """The rows of groups.csv; none where there is no table of groups."""
    try:
        found = evaluation.groups()
    except TrainingError:
        found = None  # the report says why
    if found is None:
        return []
    rows: list[tuple[Any, ...]] = []
    for g, group in enumerate(found.groups):
        first = (group.label, len(group.members) if group.trained else 0)
        rows.append((*first, "", "elo", *(float(ends[g]) for ends in found.ratings)))
        rows += [
            (*first, other.label, "wins", *(float(ends[g, h]) for ends in found.wins))
            for h, other in enumerate(found.groups)
            if g != h
        ]
    return rows


def _figures(evaluation: EvaluationResult, names: Sequence[str], width: int | None) -> str:
    known = [name for name in names if name in evaluation.pairings[0].results.figures]
    rows = [(*pair, *(_cell(*figures[name]) for name in known)) for pair, figures in _rows(evaluation)]
    return text_table(rows, (*FIRST, *known), left=len(FIRST), width=width)


def _cell(mean: float, error: float) -> str:
    """Mean and error, to the error's second digit."""
    if np.isnan(mean):
        return "-"
    if np.isnan(error):  # it was measured in one episode only
        return f"{mean:.2f} ± -"
    if not error:  # all episodes were alike
        return f"{mean:.2f}"
    digits = int(np.clip(1 - np.floor(np.log10(error)), 0, 4))
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def _rated(evaluation: EvaluationResult) -> list[tuple[str, float, float]]:
    """Label, rating and its error of each policy; empty until games join all policies."""
    found = evaluation.ratings()
    labels = [contender.label for contender in evaluation.chosen]
    return [] if found is None else [(label, float(r), float(e)) for label, r, e in zip(labels, *found, strict=True)]


def _estimates(evaluation: EvaluationResult) -> Iterable[tuple[tuple[int, int], Estimates]]:
    """The estimates of each policy, by its index and that of its opponent; against itself once."""
    for pairing in evaluation.pairings:
        for role in range(len(set(pairing.pair))):
            yield pairing.pair if role == 0 else pairing.pair[::-1], pairing.estimates(role)


def _rows(evaluation: EvaluationResult) -> list[tuple[tuple[str, str], Estimates]]:
    chosen = evaluation.chosen
    return [
        ((chosen[i].label, chosen[j].label), figures)
        for (i, j), figures in sorted(_estimates(evaluation), key=lambda entry: entry[0])
    ]


def _everything(evaluation: EvaluationResult) -> dict[str, Any]:
    return {
        **_played(evaluation),
        "seed": evaluation.seed,
        "worlds": evaluation.worlds,
        "episodes": evaluation.episodes,
        "complete": evaluation.complete,
        "ratings": [dict(zip(("policy", "elo", "error"), row, strict=True)) for row in _rated(evaluation)],
        "groups": [
            dict(zip(("group", "runs", "against", "figure", *INTERVAL), row, strict=True))
            for row in _group_rows(evaluation)
        ],
        "pairings": [_pairing(evaluation, pairing) for pairing in evaluation.pairings],
    }


def _played(evaluation: EvaluationResult) -> dict[str, Any]:
    """What tells one evaluation from another."""
    policies = [{"label": chosen.label, "policy": chosen.text} for chosen in evaluation.chosen]
    return {"scenario": fingerprint(evaluation.scenario), "policies": policies}


def _pairing(evaluation: EvaluationResult, pairing: Pairing) -> dict[str, Any]:
    names = [evaluation.chosen[k].label for k in pairing.pair]
    figures = [{name: {"mean": m, "error": e} for name, (m, e) in pairing.estimates(role).items()} for role in (0, 1)]
    return {"policies": names, "won, drawn, lost": pairing.won_drawn_lost(), "figures": figures}


def _json(value: Any) -> Any:
    """The value with null in place of NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _json(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_json(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows([head, *rows])
    return file.getvalue()
