"""The units of a tick, in order and in segments; a thread runs a segment by one call."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from ..declarations.access import Service
from ..declarations.component import Action, Component, Entity, Observation, Signal
from ..declarations.phase import When
from ..declarations.system import System
from ..kernels.jit import compiled
from ..memory.clock import RESET, STEP
from ..memory.draw import published_rows
from ..memory.layout import MemoryLayout
from ..memory.numbers import NumbersView
from .tick import Generator, Unit

MODES = {When.RESET: 1 << RESET, When.STEP: 1 << STEP, When.ALWAYS: 1 << RESET | 1 << STEP}  # bitsets


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

    as_python = {s.label for s in systems if python or not s.compiled or s.label in interpret}
    aside = {s.label for s in systems if split or (compiled() and not python and s.label in as_python)}
    anew = stale_services(systems, aside)
    some_absent = any(number.kinds for number in layout.varied.values())
    signals = [*_written_outside(layout, systems, Signal)]
    units = [new().clock(), *([new().draw()] if layout.keyed else []), *([new().assign()] if layout.roles else [])]
    stale = [*_read_in_resets(layout, systems), *(each for each, _ in _written_outside(layout, systems, Observation))]
    units += [new().zero(stale, When.RESET)] if stale else []
    for system in systems:
        first = [signal for signal, writer in signals if writer is system]
        units += [new().zero(first, When.ALWAYS)] if first else []
        making = new(system.label in as_python, system.outside)
        units.append(making.system(modules[system.module], system, anew[system.label]))
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


def stale_services(systems: Sequence[System], aside: Collection[str]) -> dict[str, dict[Service, int]]:
    """Return by label of a system in which modes each of its services is to be made anew: a bitset, as in MODES.

    It is kept in the modes in which an earlier system of the tick has had it, and no system since then writes what it
    is made of. So what happens between ticks (a reset, a state that is set, a table that is written) needs no care.

    aside: labels of systems with a segment of their own, which does not share memory with others.
    """
    fresh, found = dict[Service, int](), dict[str, dict[Service, int]]()
    for system in systems:
        modes = MODES[system.phase.when]
        if system.label in aside:
            fresh.clear()
        services = [p.service for p in system.parameters if p.service]
        found[system.label] = {service: modes & ~fresh.get(service, 0) for service in services}
        fresh |= {service: fresh.get(service, 0) | modes for service in services}
        for service in fresh:
            if any(system.touches(part, "write", "add") for each in service.parameters for part in each.components):
                fresh[service] &= ~modes
        if system.label in aside:
            fresh.clear()
    return found


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
