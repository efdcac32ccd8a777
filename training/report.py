"""What an evaluation found, as tables to read and as files."""

import csv
import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.storage.atomic_write import atomic_write

from .evaluate import Evaluation, Figures, Meeting

RESULTS = ("wins", "length", "life", "return", "kills")  # and deaths by cause
WORLD = ("length", "first_death")  # of both alike
FIRST = ("policy", "against")


def text(evaluation: Evaluation) -> str:
    """All tables. Of incomplete evaluations, what is complete."""
    if not evaluation.meetings:
        return "no pairing is complete"
    parts = [_ratings(evaluation), _wins(evaluation)]
    names = list(evaluation.meetings[0].games.figures)
    results = [*RESULTS, *(name for name in names if name.startswith("deaths_"))]
    parts += [_figures(evaluation, results), _figures(evaluation, [name for name in names if name not in results])]
    return "\n\n".join(filter(None, parts))


def write(evaluation: Evaluation, folder: Path) -> list[Path]:
    """evaluation.json with everything, figures.csv and ratings.csv with the numbers; each whole or not at all."""
    figures = [(*names, name, *row) for names, rows in _rows(evaluation) for name, row in rows.items()]
    contents = {
        "evaluation.json": json.dumps(_known(_about(evaluation)), indent=1, allow_nan=False) + "\n",
        "figures.csv": _csv((*FIRST, "figure", "mean", "error"), figures),
        "ratings.csv": _csv(("policy", "elo", "error"), _rated(evaluation)),
    }
    for name, content in contents.items():
        with atomic_write(folder / name) as place:
            place.write_text(content, encoding="utf-8", newline="\n")
    return [folder / name for name in contents]


def _ratings(evaluation: Evaluation) -> str:
    rows = sorted(_rated(evaluation), key=lambda row: -row[1])
    cells = [(label, f"{rating:.0f}", f"{error:.0f}") for label, rating, error in rows]
    return _table(("Elo (mean 1000)", "rating", "std. error"), cells) if cells else ""


def _wins(evaluation: Evaluation) -> str:
    """Who wins how often against whom; half of what is drawn."""
    labels = [contender.label for contender in evaluation.chosen]
    rates = {(i, j): rows["wins"] for (i, j), rows in _figures_of(evaluation)}
    rows = [
        (label, *(_cell(*rates.get((i, j), (np.nan, 0))) for j in range(len(labels)))) for i, label in enumerate(labels)
    ]
    return _table(("wins of, against", *labels), rows)


def _figures(evaluation: Evaluation, names: Sequence[str]) -> str:
    known = [name for name in names if name in evaluation.meetings[0].games.figures]
    rows = [(*pair, *(_cell(*figures[name]) for name in known)) for pair, figures in _rows(evaluation)]
    return _table((*FIRST, *known), rows, left=len(FIRST))


def _cell(mean: float, error: float) -> str:
    """To the second digit of the error."""
    if np.isnan(mean):
        return "-"
    if not error:  # all episodes were alike
        return f"{mean:.2f}"
    digits = int(np.clip(1 - np.floor(np.log10(error)), 0, 4))
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1) -> str:
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = (
        [
            cell.ljust(width) if k < left else cell.rjust(width)
            for k, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        for row in (head, *rows)
    )
    return "\n".join("  ".join(line).rstrip() for line in lines)


def _rated(evaluation: Evaluation) -> list[tuple[str, float, float]]:
    """Label, rating and its error of each policy; none until all are joined."""
    found = evaluation.ratings()
    labels = [contender.label for contender in evaluation.chosen]
    return [] if found is None else [(label, float(r), float(e)) for label, r, e in zip(labels, *found, strict=True)]


def _figures_of(evaluation: Evaluation) -> Iterable[tuple[tuple[int, int], Figures]]:
    """The figures of a policy, by its number and that of whom it met; against itself once."""
    for meeting in evaluation.meetings:
        for role in range(len(set(meeting.pair))):
            yield meeting.pair if role == 0 else meeting.pair[::-1], meeting.figures(role)


def _rows(evaluation: Evaluation) -> list[tuple[tuple[str, str], Figures]]:
    chosen = evaluation.chosen
    return [
        ((chosen[i].label, chosen[j].label), figures) for (i, j), figures in sorted(_figures_of(evaluation), key=_pair)
    ]


def _pair(entry: tuple[tuple[int, int], Figures]) -> tuple[int, int]:
    return entry[0]


def _about(evaluation: Evaluation) -> dict[str, Any]:
    return {
        "scenario": fingerprint(evaluation.scenario),
        "seed": evaluation.seed,
        "worlds": evaluation.env.num_worlds,
        "episodes": evaluation.episodes,
        "complete": len(evaluation.meetings) == len(evaluation.pairs),
        "policies": [{"label": chosen.label, "policy": chosen.text} for chosen in evaluation.chosen],
        "ratings": [dict(zip(("policy", "elo", "error"), row, strict=True)) for row in _rated(evaluation)],
        "pairings": [_meeting(evaluation, meeting) for meeting in evaluation.meetings],
    }


def _meeting(evaluation: Evaluation, meeting: Meeting) -> dict[str, Any]:
    names = [evaluation.chosen[k].label for k in meeting.pair]
    figures = [{name: {"mean": m, "error": e} for name, (m, e) in meeting.figures(role).items()} for role in (0, 1)]
    return {"policies": names, "won, drawn, lost": meeting.results(), "figures": figures}


def _known(value: Any) -> Any:
    """The same with null for NaN, which JSON has not."""
    if isinstance(value, dict):
        return {key: _known(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_known(entry) for entry in value]
    return None if isinstance(value, float) and np.isnan(value) else value


def _csv(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerows([head, *rows])
    return file.getvalue()
