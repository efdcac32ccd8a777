"""outlast schedule: the tick of a variant as a table or as generated code, or its components and who uses them."""

import argparse
from itertools import zip_longest
from typing import Any

from outlast.ecs import Component, Entity, Worlds

from ..text_table import text_table
from .options import add_scenario, scenario


def add(commands: Any) -> None:
    """Add the command to a parser's commands."""
    examples = [
        ("schedule ffa_1", "the systems in the order in which they run, phase by phase"),
        ("schedule teams_4 --components", "which systems write and read each component"),
        ("schedule ffa_1 --source", "the generated code"),
    ]
    description = (
        "Print what happens in a tick: the systems, in the order in which they run, with their phases. Nothing is "
        "compiled or run."
    )
    text = "print what happens in a tick of a game, as a table"
    table = commands.add_parser("schedule", help=text, description=description, examples=examples, run=run)
    add_scenario(table)
    kind = table.add_mutually_exclusive_group()
    text = "print the components instead, with the systems that write and read each"
    kind.add_argument("--components", action="store_true", help=text)
    text = "print the generated code instead, one function for each system"
    kind.add_argument("--source", action="store_true", help=text)


def run(options: argparse.Namespace) -> int:
    """Print the table."""
    worlds = scenario(options).worlds(1)
    if options.source:
        print(worlds.source())
    else:
        print(_components(worlds) if options.components else worlds.schedule)
    return 0


def _components(worlds: Worlds) -> str:
    """Return a table of every component in the order of storage: its kind, who has it, and who writes and reads it."""
    heads, lines = ("component", "kind", "archetypes", "written by", "read by"), list[tuple[str, ...]]()
    for component in worlds.components:
        columns = [[component.__name__], [component.__bases__[0].__name__], *uses(worlds, component)]
        lines += zip_longest(*columns, fillvalue="")
    return text_table(lines, heads)


def uses(worlds: Worlds, component: type[Component]) -> tuple[list[str], list[str], list[str]]:
    """Return the archetypes that have a component, and the systems that write it, or only add to it, and read it."""
    writers, readers = [], []
    for system in worlds.schedule.systems:
        kinds = {parameter.kind for parameter in system.parameters if component in parameter.components}
        if kinds & {"write", "add"}:
            writers.append(system.label if "write" in kinds else f"{system.label} (adds)")
        if "read" in kinds:
            readers.append(system.label)
    archetypes = worlds.layout.archetypes.items()
    having = [name for name, each in archetypes if component is Entity or component in map(type, each.parts)]
    return having, writers, readers
