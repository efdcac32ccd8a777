"""Runs beside the paper's, as tables in Markdown and as files: end values, claims, figures."""

from collections.abc import Sequence

from outlast.envs.errors import install

from ..base.curves import KILLS
from ..base.errors import TrainingError
from ..base.tables import ENDS, markdown_table, number, with_spread
from .claims import claims_table, findings
from .end_values import csv_table, markdown, rows
from .results import PaperGroup

PAPER = "the paper"


def side_by_side(groups: Sequence[PaperGroup]) -> str:
    """End values of every variant, with all presets beside each other and 95 % intervals over seeds, in Markdown.

    Values of sides are averaged; kills are summed.
    """
    presets = list(dict.fromkeys(group.preset for group in groups))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for group in groups:
        for quantity in dict.fromkeys(row.quantity for row in rows(group)):
            own = [row for row in rows(group) if row.quantity == quantity]
            sides = 1 if quantity == KILLS else len(own)
            each = [sum(row.ours[k].mean for row in own) / sides for k in range(len(group.ended))]
            line = cells.setdefault((group.variant, quantity.name), {})
            line[group.preset] = with_spread(each)
            if own[0].theirs:
                line[PAPER] = number(sum(row.theirs.mean for row in own if row.theirs) / sides)
    heads = ("variant", "at the end", PAPER, *(f"preset `{name}`" for name in presets))
    lines = [[*key, *(line.get(name, "") for name in (PAPER, *presets))] for key, line in sorted(cells.items())]
    return markdown_table(heads, lines)


def report(groups: Sequence[PaperGroup], beside: Sequence[PaperGroup] = ()) -> str:
    """End values of all presets beside each other, those of each group, and the paper's claims, in Markdown."""
    parts = [markdown(group) for group in groups]
    if len({group.preset for group in (*beside, *groups)}) > 1:
        parts.insert(0, side_by_side([*beside, *groups]))
    for name in dict.fromkeys(group.preset for group in groups):
        if found := list(findings([group for group in groups if group.preset == name])):
            parts.append(f"What the paper says, and runs of preset `{name}`:\n\n{claims_table(found)}")
    return "\n\n".join(parts) + "\n"


def figures_and_tables(groups: Sequence[PaperGroup], form: str, beside: Sequence[PaperGroup] = ()) -> dict[str, bytes]:
    """The contents of all files, by name: the figures, the tables in Markdown, and the end values as CSV.

    groups: What is drawn and reported. form: Format of the figures: "png" or "svg". beside: Runs with other presets, to
    compare with in the table of all presets. Raises TrainingError: there is no matplotlib.
    """
    try:
        from .figures import picture
    except ModuleNotFoundError as error:
        raise TrainingError(f"figures need {error.name}: {install('plot')}") from error
    figures = {f"{group.name}.{form}": picture(group, form) for group in groups}
    return {**figures, "ends.md": report(groups, beside).encode(), ENDS: csv_table(groups).encode()}
