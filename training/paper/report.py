"""Runs beside the paper's, as tables in Markdown and as files: end values, claims, figures."""

from collections.abc import Sequence

from outlast.envs.errors import install

from ..errors import TrainingError
from .claims import claims_table, findings
from .end_values import csv_table, markdown
from .results import RunGroup


def report(groups: Sequence[RunGroup]) -> str:
    """The end values of all groups, then the paper's claims, for each preset, in Markdown."""
    parts = [markdown(group) for group in groups]
    for name in dict.fromkeys(group.preset for group in groups):
        if found := list(findings([group for group in groups if group.preset == name])):
            parts.append(f"What the paper says, and runs of preset `{name}`:\n\n{claims_table(found)}")
    return "\n\n".join(parts) + "\n"


def figures_and_tables(groups: Sequence[RunGroup], form: str) -> dict[str, bytes]:
    """The contents of all files, by name: the figures, the tables in Markdown, and the end values as CSV.

    Raises TrainingError without matplotlib.
    """
    try:
        from .figures import picture
    except ModuleNotFoundError as error:
        raise TrainingError(f"figures need {error.name}: {install('plot')}") from error
    figures = {f"{group.name}.{form}": picture(group, form) for group in groups}
    return {**figures, "ends.md": report(groups).encode(), "ends.csv": csv_table(groups).encode()}
