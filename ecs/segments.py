"""The units of a tick in order, in segments: those that a thread runs by one call."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from .component import Action, Component, Entity, Signal
from .draw import plan, published_rows
from .layout import Layout
from .phase import When
from .system import System
from .tick import Generator, Unit
from .varied import NumbersView


@dataclass(frozen=True)
class Segment:
    """Units that a thread runs by one call: those between two that run as Python, or one of these."""

    units: Sequence[Unit]
    compiled: bool


def segments(
    layout: Layout,
    systems: Sequence[System],
    split: bool = False,
    interpret: Collection[str] = (),
    specialize: bool = False,
) -> list[Segment]:
    """Generate the units of a tick.

    Args:
        layout: Of the worlds.
        systems: In the order of the schedule.
        split: Whether each system gets a segment of its own, the first with the clock.
        interpret: Labels of systems to run as Python.
        specialize: Whether machine code is for this layout alone.
    """
    modules = {module.name: module for module in layout.modules}

    tables: dict[Any, tuple[Any, str]] = {}

    def generator(**options: bool) -> Generator:
        return Generator(layout, specialize=specialize, tables=tables, **options)

    units = [generator().clock(), *([generator().draw()] if layout.keyed else [])]
    units += [generator().assign()] if layout.roles else []
    units += [generator().zero(*each) for each in _cleared(layout, systems)]
    some_absent = layout.keyed and len(plan(layout).absences)
    for system in systems:
        python = not system.compiled or system.label in interpret
        units.append(generator(python=python, outside=system.outside).system(modules[system.module], system))
        if some_absent and system.outside and system.touches(Entity, "write"):
            units.append(generator().check_absent(system))
    if NumbersView in layout.components:
        units.append(generator().show())
    units += [generator().clear(*each) for each in published_rows(layout)]
    found = [Segment(tuple(part), compiled) for compiled, part in groupby(units, lambda unit: unit.compiled)]
    if split:
        found = [Segment((unit,), unit.compiled) for unit in units]
    return found


def _cleared(layout: Layout, systems: Sequence[System]) -> Iterator[tuple[type[Component], str, When]]:
    """What is set to 0 ahead of all systems, and in which ticks, where a system from outside of outlast needs it.

    Actions in the tick that starts an episode, if they are read there: those in the table are of the episode before.
    Signals in every tick, if they are written from outside only: a system that adds to rewards begins at 0.
    """
    for component in layout.components:
        reading = [s for s in systems if s.phase.when is not When.STEP and s.touches(component, "read", "write", "add")]
        writing = [s.outside for s in systems if s.touches(component, "write", "add")]
        if issubclass(component, Action) and reading:
            yield from ((component, name, When.RESET) for name in component.columns)
        if issubclass(component, Signal) and writing and all(writing):
            yield from ((component, name, When.ALWAYS) for name in component.columns)
