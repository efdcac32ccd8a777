"""The units of a tick, in order and in segments; a thread runs a segment by one call."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from ..declarations.component import Action, Component, Entity, Observation, Signal
from ..declarations.phase import When
from ..declarations.system import System
from ..memory.draw import published_rows
from ..memory.layout import MemoryLayout
from ..memory.numbers import NumbersView
from .tick import Generator, Unit


@dataclass(frozen=True)
class Segment:
    """Successive units that a thread runs by one call: all are machine code, or all run as Python."""

    units: Sequence[Unit]
    compiled: bool


def segments(
    layout: MemoryLayout,
    systems: Sequence[System],
    split: bool = False,
    interpret: Collection[str] = (),
    specialize: bool = False,
    python: bool = False,
) -> list[Segment]:
    """Generate the units of a tick of these systems, in order.

    split: whether each unit gets a segment of its own. interpret: labels of systems to run as Python; python: all of
    them. specialize: whether the machine code is for this layout alone.
    """
    modules, tables = {module.name: module for module in layout.modules}, dict[Any, tuple[Any, str]]()

    def new(as_python: bool = python, outside: bool = False) -> Generator:
        return Generator(layout, python=as_python, outside=outside, specialize=specialize, tables=tables)

    some_absent = any(number.kinds for number in layout.varied.values())
    signals = [*_written_outside(layout, systems, Signal)]
    units = [new().clock(), *([new().draw()] if layout.keyed else []), *([new().assign()] if layout.roles else [])]
    stale = [*_read_in_resets(layout, systems), *(each for each, _ in _written_outside(layout, systems, Observation))]
    units += [new().zero(stale, When.RESET)] if stale else []
    for system in systems:
        first = [signal for signal, writer in signals if writer is system]
        units += [new().zero(first, When.ALWAYS)] if first else []
        making = new(python or not system.compiled or system.label in interpret, system.outside)
        units.append(making.system(modules[system.module], system))
        if system.outside:
            units += [new().check_range(system, *found) for found in _ranges(layout, system)]
        if some_absent and system.outside and system.touches(Entity, "write", "add"):
            units.append(new().check_absent(system))
    if paid := [component for component in layout.components if issubclass(component, Signal)]:
        units.append(new().zero(paid, When.RESET))  # no action has led to the tick that starts an episode
    if NumbersView in layout.components:
        units.append(new().show())
    units += [new().clear(*each) for each in published_rows(layout)]
    if split:
        return [Segment((unit,), unit.compiled) for unit in units]
    return [Segment(tuple(part), compiled) for compiled, part in groupby(units, lambda unit: unit.compiled)]


def _read_in_resets(layout: MemoryLayout, systems: Sequence[System]) -> Iterator[type[Component]]:
    """The actions that are read in the tick that starts an episode: the table still has those of the last episode."""
    for component in layout.components:
        if issubclass(component, Action):
            reading = [system for system in systems if system.touches(component, "read", "write", "add")]
            if any(system.phase.when is not When.STEP for system in reading):
                yield component


def _written_outside(
    layout: MemoryLayout, systems: Sequence[System], kind: type[Component]
) -> Iterator[tuple[type[Component], System]]:
    """Components of a kind that only systems from outside of outlast write, each with the first of these.

    They may leave observations of the last episode, and may just add to signals.
    """
    for component in layout.components:
        if issubclass(component, kind):
            writing = [system for system in systems if system.touches(component, "write", "add")]
            if writing and all(system.outside for system in writing):
                yield component, writing[0]


def _ranges(layout: MemoryLayout, system: System) -> Iterator[tuple[type[Component], str, int, int]]:
    """The columns to check after a system: component, name, and the lowest and the highest integer of each."""
    for component in layout.components:
        if system.touches(component, "write", "add"):
            for name, column in component.columns.items():
                if column.dtype != bool and (ends := column.range(layout.dims)):
                    yield component, name, *ends
