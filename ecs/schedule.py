"""The order of a tick: phases in time, systems within a phase by what they declare; ambiguity is an error."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from .access import SELECTIONS
from .component import Component
from .errors import ScheduleError
from .module import Module
from .phase import Phase
from .system import System

CONFLICTS = {("read", "write"), ("read", "add"), ("add", "write"), ("write", "write")}


@dataclass(frozen=True)
class Schedule:
    """The systems of one tick, in order. `str(schedule)` is the printed table."""

    systems: tuple[System, ...]

    def __str__(self) -> str:
        lines = [f"{'phase':<9} {'runs on':<12} {'system':<22} {'reads':<34} {'writes':<30} adds"]
        phase = None
        for system in self.systems:
            if system.phase is not phase:
                phase = system.phase
                lines.append(f"{phase.name:<9} {phase.when.value:<12} # {phase.says}")
            reads, writes, adds = (_touched(system, kind) for kind in ("read", "write", "add"))
            python = "" if system.compiled else "  (python)"
            lines.append(f"{'':<22} {system.label:<22} {reads:<34} {writes:<30} {adds}{python}".rstrip())
        return "\n".join(lines)


def order(systems: Iterable[System], present: Iterable[type[Component]]) -> Schedule:
    """Put systems in order. The order in which they are given never matters.

    Raises ScheduleError when two systems have one label, when a system needs a component that nothing brings, when
    `after`/`before` names an unknown system or runs in a circle, when two systems have one random stream, and when two
    systems of a phase touch a component in conflicting ways without saying who goes first.
    """
    systems = sorted(systems, key=lambda system: system.label)
    for one, two in pairwise(systems):
        if one.label == two.label:
            raise ScheduleError(
                f"two systems are called {one.label} ({one.function.__module__} and {two.function.__module__}): their "
                "name decides their order and their random numbers; rename one of the functions or its mechanic"
            )
    _check_present(systems, set(present))
    _check_streams(systems)
    phases: dict[Phase, list[System]] = {}
    for system in systems:
        phases.setdefault(system.phase, []).append(system)
    ordered: list[System] = []
    for phase in sorted(phases, key=lambda phase: phase.position):
        ordered += _order_phase(phases[phase])
    return Schedule(tuple(ordered))


def _touched(system: System, kind: str) -> str:
    return " ".join(c.__name__ for p in system.parameters if p.kind == kind for c in p.components)


def _check_present(systems: Sequence[System], present: set[type[Component]]) -> None:
    for system in systems:
        for parameter in system.parameters:
            for component in parameter.components:
                if parameter.kind not in SELECTIONS.values() and component not in present:
                    raise ScheduleError(
                        f"{system.label} needs {component.__name__} (parameter '{parameter.name}'), but no module of "
                        f"this scenario brings it; add the module that does, or leave {system.module} out"
                    )


def _check_streams(systems: Sequence[System]) -> None:
    owners: dict[str, System] = {}
    for system in systems:
        if any(parameter.kind == "random" for parameter in system.parameters):
            other = owners.setdefault(system.stream, system)
            if other is not system:
                raise ScheduleError(
                    f"{other.label} and {system.label} have one random stream, {system.stream}, and would draw the "
                    f"same numbers: give {system.module} a stream of its own, or rename one of the functions"
                )


def _order_phase(systems: Sequence[System]) -> list[System]:
    """Topological order by after/before, ties by label; then every conflicting pair must be connected."""
    earlier: dict[str, set[str]] = {system.label: set() for system in systems}
    named: dict[str, set[str]] = {}  # the labels that a name stands for: a system's own, and those it is inherited by
    for system in systems:
        for name in (system.label, *system.aliases):
            named.setdefault(name, set()).add(system.label)
    for system in systems:
        for label in system.after + system.before:
            if label not in named and label not in Module.labels():
                raise ScheduleError(f"{system.label} is to run after or before '{label}', which no module registers")
        for label in system.after:
            earlier[system.label] |= named.get(label, set())
        for label in system.before:
            for later in named.get(label, ()):
                earlier[later].add(system.label)
    ordered: list[System] = []
    reach: dict[str, set[str]] = {}
    waiting = list(systems)
    while waiting:
        ready = next((s for s in waiting if earlier[s.label] <= reach.keys()), None)
        if ready is None:
            names = ", ".join(s.label for s in waiting)
            raise ScheduleError(f"the after/before of these systems run in a circle: {names}")
        reach[ready.label] = set().union(*({name} | reach[name] for name in earlier[ready.label]))
        ordered.append(ready)
        waiting.remove(ready)
    _check_conflicts(ordered, reach)
    return ordered


def _check_conflicts(systems: Sequence[System], reach: dict[str, set[str]]) -> None:
    for k, second in enumerate(systems):
        for first in systems[:k]:
            shared = _conflict(first, second)
            if shared and first.label not in reach[second.label]:
                raise ScheduleError(
                    f"the order of {first.label} and {second.label} in phase {first.phase.name} is ambiguous: both "
                    f'touch {shared.__name__} and one of them writes it. Say after="{first.label}" on {second.label} '
                    "(or the other way round), put one into another phase, or declare Add where both only add"
                )


def _conflict(first: System, second: System) -> type[Component] | None:
    for one in first.parameters:
        for two in second.parameters:
            if {one.kind, two.kind} & set(SELECTIONS.values()):
                continue
            kinds = (one.kind, two.kind)
            for component in one.components:
                if component in two.components and (kinds in CONFLICTS or kinds[::-1] in CONFLICTS):
                    return component
    return None
