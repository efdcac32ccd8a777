"""Tables in Markdown that compare outlast with the paper: tests, check values, statistics, training."""

import ast
import csv
import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from catalogue import shown
from sources import code, grid

import outlast
from outlast import systems
from outlast.training.base.quantities import NONE, pivot
from outlast.training.plots.plot import compare
from outlast.training.research.claims import claims_table, findings
from outlast.training.research.compare import markdown, side_by_side
from outlast.training.research.reproduce import CORRECTED, ORIGINAL, Experiment, experiments
from outlast.training.research.results import PaperGroup, group_runs, load_runs

DOCS = Path(__file__).resolve().parent.parent
RESULTS = DOCS.parent / "results"
TESTS = DOCS.parent / "tests"
RULES = TESTS / "mechanics"
TEXT = "text"  # the folder and preset of the runs that follow the paper's text
COMPARED = [RESULTS / folder / "ffa_4-original-0" for folder in (ORIGINAL, "worlds-64")]
CONSTANTS = {"test_fidelity.py": ("FREE_TOLERANCE", "CONTACT_TOLERANCE"), "test_statistics.py": ("ERRORS", "EPISODES")}


def constants() -> dict[str, Any]:
    """Return constants of the tests by name, from their source: the tests are not imported."""
    found: dict[str, Any] = {}
    for file, names in CONSTANTS.items():
        for line in ast.parse((RULES / file).read_text()).body:
            if isinstance(line, ast.Assign):
                target = ast.unparse(line.targets[0]).strip("()").split(", ")
                values = line.value.elts if isinstance(line.value, ast.Tuple) else [line.value]
                pairs = zip(target, values, strict=False)
                found |= {name: ast.literal_eval(value) for name, value in pairs if name in names}
    return found


def rules() -> str:
    """The tests of the rules as a list, under the docstrings of their files; a test's name is a sentence."""
    lines = []
    for file in sorted(RULES.glob("test_fidelity*.py")):
        tree = ast.parse(file.read_text())
        lines.append(f"\n{_note(tree).rpartition(': ')[2].capitalize()}\n")
        for test in tree.body:
            if isinstance(test, ast.FunctionDef) and test.name.startswith("test_"):
                note = _note(test)
                says = test.name.removeprefix("test_").replace("_", " ")
                lines.append(f"- {says}. *{note}*" if note else f"- {says}")
    return "\n".join(lines)


def _note(tree: ast.Module | ast.FunctionDef) -> str:
    """Return a docstring as one paragraph, without its references."""
    return re.sub(r" \(rules[^)]*\)", "", " ".join((ast.get_docstring(tree) or "").split()))


def checks() -> str:
    """The trajectories that are compared."""
    data = json.loads((TESTS / "data" / "check-values.json").read_text())
    rows = []
    for name, check in data.items():
        listed = next(value for key, value in check.items() if key.startswith("states"))
        rows.append([code(name), check["what"], listed[-1][0], len(listed)])
    return grid(["name", "what happens", "ticks", "compared"], rows)


def compared() -> str:
    """Statistics under random actions, from docs/statistics.csv."""
    with (DOCS / "statistics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    lines, before = [], ""
    for row in rows:
        name = code(outlast.envs.scenarios.variants.ALIASES[row["variant"]])
        numbers = (row["original"], f"{float(row['outlast']):.3g}", row["errors apart"])
        lines.append([name if name != before else "", row["quantity"], *numbers])
        before = name
    return grid(["variant", "quantity", "original", "outlast", "errors apart"], lines)


def deviations() -> str:
    """Numbers whose default follows the paper's text, while all variants set them to another value."""
    played = [scenario.numbers() for scenario in outlast.VARIANTS.values()]
    rows = []
    for kind in (getattr(systems, name) for name in systems.__all__):
        for item in dataclasses.fields(kind):
            key = f"{kind.name}_{item.name}"
            runs = {repr(own[key]): own[key] for own in played if isinstance(own.get(key), type(item.default))}
            if len(runs) == 1 and repr(item.default) not in runs:
                rows.append([code(key), shown(item.default), *map(shown, runs.values()), code(kind.__name__)])
    return grid(["number", "the paper's text", "its runs", "explained at"], rows)


def kept(folder: str = ORIGINAL) -> list[PaperGroup]:
    """The results in a folder of results, by variant."""
    return group_runs(load_runs([RESULTS / folder]))


def beside_the_paper() -> str:
    """End values of all variants beside the paper's, and which runs have not been trained yet."""
    return side_by_side(kept()) + _missing(ORIGINAL, lambda each: code(each.game))


def _missing(part: str, name: Callable[[Experiment], str]) -> str:
    """Return a paragraph on runs of a part of the reproduction that have not been trained yet; "" if all have."""
    planned = [(name(each), _lacking(each)) for each in experiments([part])]
    missing = [f"{each} ({', '.join(map(str, lacking))})" for each, lacking in planned if lacking]
    return f"\n\nNot trained yet, with the seeds that are missing: {', '.join(missing)}." if missing else ""


def _lacking(experiment: Experiment) -> list[int]:
    """Return the seeds of an experiment whose results are not kept."""
    return [seed for seed in range(experiment.seeds) if not experiment.steps_done(RESULTS, seed)]


def trained() -> str:
    """Figure, end values and film of each variant that was trained as in the paper."""
    parts, place = [], Path("../results", ORIGINAL)
    for group in kept():
        parts.append(f"### {group.variant}")
        parts.append(f"![Learning curves of {group.variant}: ours and the paper's]({place / group.name}.png)")
        parts.append(markdown(group))
        parts.append(f"[An episode of {group.variant} after training]({place / group.name}.webm)")
    return "\n\n".join(parts)


def ends(folder: str) -> str:
    """End values of the results in a folder of results, a table for each variant."""
    return "\n\n".join(map(markdown, kept(folder)))


def as_written() -> str:
    """End values of runs by the paper's text beside runs by its code, and which have not been trained yet."""
    table = (RESULTS / TEXT / "ends.md").read_text().partition("\n\n")[0]
    return table + _missing(TEXT, lambda each: f"{code(each.game)} {code(each.preset)}")


def claimed() -> str:
    """What the paper says, measured in our runs."""
    return claims_table(list(findings(kept())))


def mended(*games: str) -> str:
    """What agents do in these games of results/mended: a column for each, without rows of zeros."""
    lines = (RESULTS / CORRECTED / "measured.md").read_text().splitlines()
    heads, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    by_game = {row[0]: row for row in rows}
    columns = [[code(game.replace("+", " +")), *by_game[game][1:]] for game in games]
    first, *others = zip(heads, *columns, strict=True)
    numbers = ([float(cell.split()[0].replace(",", "")) for cell in row[1:] if cell != NONE] for row in others)
    return grid(list(first), [list(row) for row, own in zip(others, numbers, strict=True) if any(own)])


def long_run(name: str) -> str:
    """A file of results/long_run: figures or cross-play of the checkpoints of each run, or best responses to some."""
    with (RESULTS / "long_run" / f"{name}.csv").open(newline="") as file:
        found = list(csv.reader(file))[1:]
    if name == "responses":
        found.sort(key=lambda row: int(row[3]))  # so that its columns ascend
    rows = [[*map(_millions, row[:-2]), *row[-2:]] for row in found]
    if name == "responses":
        begins = {"no": "begun anew", "yes": "begun with its weights"}
        rows = [[f"{run}, {against}, {begins[warm]}", steps, *wins] for _, run, against, steps, warm, *wins in rows]
        return _pivoted(rows, 0, 1, "games won against")
    down, across, about = (2, 1, "") if name == "figures" else (1, 2, "games won of, against")
    runs = dict.fromkeys(row[0] for row in rows)
    return "\n\n".join(_pivoted([row for row in rows if row[0] == run], down, across, about or run) for run in runs)


def _millions(cell: str) -> str:
    """Return agent-steps in millions, and any other cell as it is."""
    return f"{int(cell) / 1e6:.0f} M" if cell.isdecimal() else cell


def _pivoted(rows: list[list[str]], down: int, across: int, about: str) -> str:
    heads, lines = pivot(rows, down, across)
    return grid([about, *heads], lines)


def compared_runs() -> str:
    """The table of `outlast plot` for the runs that the pages use as its example."""
    return str(compare(COMPARED))
