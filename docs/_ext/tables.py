"""Tables of the pages, made from the code while the site is built, and numbers of the game in running text.

```{outlast} observations teams_4
```
is replaced by the table that the function of this name (in TABLES) returns as Markdown;
{value}`safe_zone_stand + safe_zone_shrink` is replaced by the value
of the expression, which uses the numbers of teams_4, as that has every mechanic of the paper; and
{value}`100 / melee_damage | .1f` by a value in the format behind the bar.
"""

import math
import re
from collections.abc import Callable
from typing import Any

import catalogue
import commands
import evidence
from docutils import nodes
from docutils.parsers.rst.states import Inliner
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import outlast

TABLES: dict[str, Callable[..., str]] = {
    made.__name__: made
    for made in (
        catalogue.variants,
        catalogue.cards,
        catalogue.ablations,
        catalogue.numbers,
        catalogue.ppo,
        catalogue.columns,
        catalogue.benchmark_tasks,
        catalogue.suite_ratings,
        catalogue.actions,
        catalogue.observations,
        catalogue.fields,
        catalogue.statistics,
        catalogue.all_components,
        catalogue.component_uses,
        catalogue.events,
        catalogue.phases,
        catalogue.schedule,
        catalogue.views,
        commands.commands,
        evidence.rules,
        evidence.checks,
        evidence.compared,
        evidence.deviations,
        evidence.beside_the_paper,
        evidence.as_written,
        evidence.claimed,
        evidence.trained,
        evidence.ends,
        evidence.compared_runs,
        evidence.mended,
        evidence.long_run,
    )
}


class Table(SphinxDirective):
    """The directive `outlast`: its arguments are the name of a table, and the arguments of the table's function."""

    required_arguments = 1
    optional_arguments = 50

    def run(self) -> list[nodes.Node]:
        """Replace the directive with what the table's function returns."""
        name, *about = self.arguments
        if name not in TABLES:
            raise self.error(f"there is no table '{name}'; known: {', '.join(TABLES)}")
        return self.parse_text_to_nodes(TABLES[name](*about), allow_section_headings=True)


def value(
    role: str, raw: str, text: str, line: int, inliner: Inliner, options: Any = None, content: Any = None
) -> tuple[list[nodes.Node], list[nodes.system_message]]:
    """The role `value`: an expression with numbers of the game, optionally with a format behind a bar."""
    expression, _, form = text.partition(" | ")
    names = outlast.variant(catalogue.FULL).numbers() | evidence.constants()
    found = eval(expression, {"math": math}, names)
    return [nodes.Text(format(found, form.strip()) if form else catalogue.shown(found))], []


def plain(app: Sphinx, what: str, name: str, documented: Any, options: Any, lines: list[str]) -> None:
    """Escape bars in docstrings, which docutils would replace, and write headings, as "## Rewards", in bold."""
    text = "\n".join(line if line.startswith(">>>") else line.replace("|", "\\|") for line in lines)
    lines[:] = re.sub(r"^## (.+)$", r"**\1**\n", text, flags=re.MULTILINE).split("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the extension; called by Sphinx."""
    app.add_directive("outlast", Table)
    app.add_role("value", value)
    app.connect("autodoc-process-docstring", plain)
    return {"parallel_read_safe": True}
