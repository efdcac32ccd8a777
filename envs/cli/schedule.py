"""outlast schedule: the tick of a variant as a table or as generated code, or its components and who uses them."""

import argparse
from itertools import zip_longest
from typing import Any, NamedTuple

from outlast.ecs import Component, Entity, Worlds

from ..text_table import text_table
from .options import add_scenario, scenario


class ComponentUse(NamedTuple):
    """A row of the table of components.

    Attributes:
        component: The name of its class.
        kind: The name of its base class.
        archetypes: Kinds of entities that have it; empty if it belongs to the world.
        writers: Labels of the systems that write it, in the order of the tick; "heals.heal (adds)" only adds to it.
        readers: Labels of the systems that read it.
    """

    component: str
    kind: str
    archetypes: list[str]
    writers: list[str]
    readers: list[str]


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
    table = commands.add_parser("schedule", help=text, description=description, examples=examples)
    add_scenario(table)
    kind = table.add_mutually_exclusive_group()
    text = "print the components instead, with the systems that write and read each"
    kind.add_argument("--components", action="store_true", help=text)
    text = "print the generated code instead, one function for each system"
    kind.add_argument("--source", action="store_true", help=text)
    table.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Print the table."""
    worlds = scenario(options).worlds(1)
    if options.source:
        print(worlds.source())
    else:
        print(as_text(uses(worlds)) if options.components else worlds.schedule)
    return 0


def uses(worlds: Worlds) -> list[ComponentUse]:
    """Return every component of these worlds, in the order of storage."""
    return [_use(worlds, component) for component in worlds.components]


def _use(worlds: Worlds, component: type[Component]) -> ComponentUse:
    writers, readers = [], []
    for system in worlds.schedule.systems:
        kinds = {parameter.kind for parameter in system.parameters if component in parameter.components}
        if kinds & {"write", "add"}:
            writers.append(system.label if "write" in kinds else f"{system.label} (adds)")
        if "read" in kinds:
            readers.append(system.label)
    having = [
        name
        for name, archetype in worlds.layout.archetypes.items()
        if component is Entity or component in map(type, archetype.parts)
    ]
    return ComponentUse(component.__name__, component.__bases__[0].__name__, having, writers, readers)


def as_text(rows: list[ComponentUse]) -> str:
    """Return columns of text, one archetype or system a line."""
    heads = ("component", "kind", "archetypes", "written by", "read by")
    cells = [([row.component], [row.kind], *row[2:]) for row in rows]
    return text_table([line for row in cells for line in zip_longest(*row, fillvalue="")], heads)
