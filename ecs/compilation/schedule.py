"""The schedule: phases in order of time, systems within a phase by their declarations. Ambiguity is an error."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ..declarations.access import SELECTIONS
from ..declarations.component import Component, Singleton
from ..declarations.event import Event
from ..declarations.module import Module
from ..declarations.phase import PhaseBase, When
from ..declarations.system import System
from ..kernels.errors import ScheduleError, did_you_mean

CONFLICTS = {("read", "write"), ("read", "add"), ("add", "write"), ("write", "write")}
OPTIONAL = "A mechanic that need not be there is better left to components (after=Body) or to scenario.ordered(...)"


Asked = Mapping[tuple[str, str], Collection[str]]
"""By labels of the first and the second of two systems of a phase, which of them order the two so by a component."""


@dataclass(frozen=True)
class Schedule:
    """The systems of one tick, in order. `str(schedule)` is the printed table."""

    systems: tuple[System, ...]

    @property
    def touched(self) -> set[type[Component]]:
        """The components that systems read or write in ticks in which no episode begins."""
        parameters = [p for system in self.systems if system.phase.when is not When.RESET for p in system.access]
        return {c for p in parameters if p.kind not in SELECTIONS.values() for c in p.components}

    def __str__(self) -> str:
        lines = [f"{'phase':<9} {'runs on':<12} {'system':<22} {'reads':<34} {'writes':<30} adds"]
        phase = None
        for system in self.systems:
            if system.phase is not phase:
                phase = system.phase
                lines.append(f"{phase.name:<9} {phase.when.value:<12} # {phase.postcondition}")
            reads, writes, adds = (_touched(system, kind) for kind in ("read", "write", "add"))
            python = "" if system.compiled else "  (python)"
            lines.append(f"{'':<22} {system.label:<22} {reads:<34} {writes:<30} {adds}{python}".rstrip())
        return "\n".join(lines)


def order(
    systems: Iterable[System], present: Iterable[type[Component]], chains: Sequence[Sequence[str]] = ()
) -> Schedule:
    """Return the schedule of a scenario's systems, given in any order; the scenario has the components `present`.

    chains: labels of systems or names of mechanics; each one of a chain runs before the next.

    Raises:
        ScheduleError: Two systems have one label or one random stream; a system needs a component that nothing brings;
            `after`, `before` or a chain has an unknown name or one of another phase, or they form a circle; systems
            of a phase use a component in conflicting ways without an order; or a system reads an event
            that is emitted only later in the tick.
    """
    systems = sorted(systems, key=lambda system: system.label)
    for one, two in pairwise(systems):
        if one.label == two.label:
            raise ScheduleError(
                f"two systems are called {one.label} ({one.function.__module__} and {two.function.__module__}): their "
                "name decides their order and their random numbers; rename one of the functions or its mechanic"
            )
    present, owners = set(present), dict[str, System]()
    for system in systems:
        _check_present(system, present)
        draws = any(parameter.kind == "random" for parameter in system.parameters)
        if draws and (other := owners.setdefault(system.stream, system)) is not system:
            raise ScheduleError(
                f"{other.label} and {system.label} have one random stream, {system.stream}, and would draw the same "
                f"numbers: give {system.module} a stream of its own, or rename one of the functions"
            )
    phases: dict[PhaseBase, list[System]] = {}
    for system in systems:
        phases.setdefault(system.phase, []).append(system)
    known = [*systems, *Module.imported_systems()]
    pairs = [pair for chain in chains for pair in pairwise(chain)]
    for pair in pairs:
        _check_pair(pair, known)
    ordered, errors = list[System](), list[str]()
    for phase in sorted(phases, key=lambda phase: phase.position):
        ordered += _order_phase(phases[phase], known, pairs, errors)
    if errors:
        raise ScheduleError("\n".join(errors))
    _check_events(ordered, known)
    return Schedule(tuple(ordered))


def _touched(system: System, kind: str) -> str:
    return " ".join(dict.fromkeys(c.__name__ for p in system.access if p.kind == kind for c in p.components))


def _check_present(system: System, present: set[type[Component]]) -> None:
    for parameter in system.access:
        for component in parameter.components:
            if parameter.kind not in SELECTIONS.values() and component not in present:
                cure = _bring(component, shared=issubclass(component, Event))  # any user of an event may bring it
                raise ScheduleError(
                    f"{system.label} needs {component.__name__} (parameter '{parameter.name}'), but no module of this "
                    f"scenario brings it; {cure}, or leave {system.module} out"
                )


def _check_events(systems: Sequence[System], known: Sequence[System]) -> None:
    """Raise ScheduleError if a system reads an event before any system can emit it: the list would always be empty.

    known: all systems, also those of mechanics that are left out, since one of them may emit the event in time.
    """
    labels = {system.label for system in systems}
    events = {c for s in systems for p in s.access for c in p.components if issubclass(c, Event)}
    for event in sorted(events, key=lambda event: event.name):
        emitting = [system for system in systems if system.touches(event, "write")]
        for k, system in enumerate(systems):
            if not (emitting and system.touches(event, "read")):
                continue
            here, first = system.phase, emitting[0]
            ahead = [s.phase for s in systems[:k] if s.touches(event, "write")]
            absent = [s.phase for s in known if s.touches(event, "write") and s.label not in labels]
            ahead += [phase for phase in absent if type(phase) is type(here) and phase.position <= here.position]
            if not any(When.ALWAYS in (phase.when, here.when) or phase.when is here.when for phase in ahead):
                raise ScheduleError(
                    f"{system.label} in phase {here.name} ({here.when.value}) reads {event.__name__}, but the first "
                    f"one that emits it is {first.label} in phase {first.phase.name} ({first.phase.when.value}): "
                    "the list begins empty in each tick; move the reader behind it, or keep what it needs in a column"
                )


def check_brought(systems: Iterable[System], brought: Collection[type[Component]]) -> None:
    """Refuse a user's system that could never run, because no imported mechanic has a component of its entities.

    A system whose `Rows` or `needs` name a component that is not `brought` here is left out, like the component itself.
    """
    for system in systems:
        rows = [c for p in system.parameters if p.kind in SELECTIONS.values() for c in p.components]
        for component in (*rows, *system.needs) if system.outside else ():
            if component not in brought and not Module.providing(_brings(component)):
                twin = component.__name__ in (other.__name__ for other in brought)
                hint = "; another class of that name is there: define both anew" if twin else ""
                raise ScheduleError(
                    f"{system.label} is for entities with {component.__name__}, which no mechanic brings, so it would "
                    f"never run: {_bring(component)}{hint}"
                )


def _bring(component: type[Component], shared: bool = True) -> str:
    """Return a part of a message: how a scenario gets the component. shared: not by adding a mechanic that has it."""
    if not shared and (providers := Module.providers(_brings(component))):
        return f"add {providers}"
    if issubclass(component, Singleton):
        return f"bring it, as in def singletons(self): return [{component.__name__}()]"
    return f'bring it, as in def archetypes(self): return [Archetype("agent", ({component.__name__}(),))]'


def _brings(component: type[Component]) -> Callable[[Module], bool]:
    """Return a check of whether a mechanic brings the component."""

    def brings(module: Module) -> bool:
        parts = [part for archetype in module.archetypes() for part in archetype.parts]
        return component in map(type, [*module.singletons(), *parts])

    return brings


def _order_phase(
    systems: Sequence[System], known: Sequence[System], pairs: Iterable[tuple[str, str]], errors: list[str]
) -> list[System]:
    """Sort topologically by after/before, ties by label; then check that all conflicting pairs have an order.

    known: the systems of the scenario and of all imported mechanics, to distinguish a typo in after/before from a
    mechanic that is left out. errors: a list to which errors of pairs without an order are added.
    """
    by_component = _asked(systems)
    earlier = _predecessors(systems, known, pairs, by_component)
    ordered, waiting = list[System](), list(systems)
    while waiting:
        done = {system.label for system in ordered}
        ready = next((s for s in waiting if earlier[s.label] <= done), None)
        if ready is None:
            names = ", ".join(s.label for s in waiting)
            raise ScheduleError(
                f"the after/before of these systems run in a circle: {names}; leave one of them out"
                + (", or a part of scenario.ordered(...)" if pairs else "")
            )
        ordered.append(ready)
        waiting.remove(ready)
    for k, second in enumerate(ordered):
        ahead = _all_earlier(second.label, earlier)
        for first in (each for each in ordered[:k] if each.label not in ahead):
            errors += filter(None, [_ambiguity(first, second, by_component, brief=bool(errors))])
    return ordered


def _predecessors(
    systems: Sequence[System], known: Sequence[System], pairs: Iterable[tuple[str, str]], by_component: Asked
) -> dict[str, set[str]]:
    """Return, by label of each system, the labels of those that must run earlier.

    Labels, names and chains have priority: a component orders two systems only if those do not contradict.
    """
    earlier: dict[str, set[str]] = {system.label: set() for system in systems}
    for system in systems:
        for name in (each for each in system.after if isinstance(each, str)):
            earlier[system.label] |= _named(name, system, systems, known)
        for name in (each for each in system.before if isinstance(each, str)):
            for later in _named(name, system, systems, known):
                earlier[later].add(system.label)
    for first, second in pairs:
        for later in _stands_for(second, systems, known):
            earlier[later] |= _stands_for(first, systems, known) - {later}
    named = {label: _all_earlier(label, earlier) for label in earlier}
    for first, second in by_component:
        if second not in named[first] and (second, first) not in by_component:
            earlier[second].add(first)
    return earlier


def _all_earlier(label: str, earlier: dict[str, set[str]]) -> set[str]:
    found: set[str] = set()
    ahead = [label]
    while ahead:
        new = earlier[ahead.pop()] - found
        found |= new
        ahead += new
    return found


def _named(name: str, asking: System, systems: Sequence[System], known: Sequence[System]) -> set[str]:
    """Return labels of the systems of a phase that `name` stands for in the after/before of the system `asking`."""
    phases = _phases(name, f"{asking.label} is to run after or before '{name}'", known, asking.phase)
    if asking.phase not in phases:
        raise ScheduleError(
            f"{asking.label} in phase {asking.phase.name} is to run after or before '{name}', which is in "
            f"{_listed(phases)}: the order of phases is fixed, so leave that out, or name something of the same phase"
        )
    return _stands_for(name, systems, known) - ({asking.label} if "." not in name else set())


def _stands_for(name: str, systems: Sequence[System], known: Sequence[System]) -> set[str]:
    """Return labels of the `systems` that a label or a mechanic's name stands for.

    A label stands for its system, also if another mechanic inherits that system, or has the same one in its slot. A
    mechanic's name stands for all systems of the mechanic in its slot. A `known` name that is not in the scenario
    stands for nothing.
    """
    meant = [system for system in known if name in (system.label, system.module)]
    in_slot = [system for system in systems if system.slot in {each.slot for each in meant}]
    if "." not in name:
        return {system.label for system in in_slot}
    alike = {name}.union(*(system.aliases for system in meant))
    inherited = [system for system in systems if name in system.aliases]
    return {s.label for s in (*in_slot, *inherited) if not alike.isdisjoint((s.label, *s.aliases))}


def _phases(name: str, who: str, known: Sequence[System], phase: PhaseBase | None = None) -> set[PhaseBase]:
    """Return the phases of a label or mechanic. If it is unknown, raise a ScheduleError that begins with `who`."""
    if meant := {system.phase for system in known if name in (system.label, system.module)}:
        return meant
    names = {each for system in known for each in (system.label, system.module)}
    here = sorted({system.label for system in known if system.phase is phase})
    raise ScheduleError(
        f"{who}, which no module registers"
        + (did_you_mean(name, sorted(names), before="; ", cutoff=0.5) or ".")
        + (f" In phase {phase.name} there are {', '.join(here)}. {OPTIONAL}" if phase else "")
    )


def _listed(phases: Iterable[PhaseBase]) -> str:
    return " and ".join(sorted(phase.name for phase in phases))


def _check_pair(pair: tuple[str, str], known: Sequence[System]) -> None:
    """Raise ScheduleError if a link of a chain has an unknown name, or two that never share a phase."""
    first, second = (_phases(name, f"the scenario orders '{name}'", known) for name in pair)
    if not first & second:
        raise ScheduleError(
            f"the scenario orders '{pair[0]}' and '{pair[1]}', which are in {_listed(first)} and in {_listed(second)}: "
            "the order of phases is fixed, so leave that out"
        )


def _asked(systems: Sequence[System]) -> Asked:
    """Return the orders requested by components in after= and before=."""
    found = dict[tuple[str, str], set[str]]()
    for asking in systems:
        for other in (each for each in systems if each is not asking):
            if any(other.touches(c, "write", "add") for c in asking.after if not isinstance(c, str)):
                found.setdefault((other.label, asking.label), set()).add(asking.label)
            if any(other.touches(c, "read", "write", "add") for c in asking.before if not isinstance(c, str)):
                found.setdefault((asking.label, other.label), set()).add(asking.label)
    return found


def _ambiguity(first: System, second: System, by_component: Asked, brief: bool) -> str:
    """Return the error for two systems of a phase that need an order and have none; "" if they need none.

    brief: whether another error comes before, which has the general cures.
    """
    if (shared := _conflict(first, second)) is None:
        return ""
    asked, other = (first, second) if first.outside and not second.outside else (second, first)
    cancelled = {(first.label, second.label), (second.label, first.label)} <= by_component.keys()
    if cancelled:  # `other` may keep a limit, such as that of hit points, and should stay last
        keyword = "before" if other.label in by_component[asked.label, other.label] else "after"
    else:
        keyword = "after" if other.touches(shared, "write", "add") else "before"
    cure = f'Say {keyword if cancelled else "after"}="{other.label}" on {asked.label} ('
    named = shared in (*first.after, *first.before, *second.after, *second.before)  # naming it is not enough
    cure += ("" if named else f"or {keyword}={shared.__name__}, ") + "or the other way round)"
    if not brief:
        cure += (
            ", put one into another phase, or declare Add where both only add; "
            f'where neither is yours, take scenario.ordered("{other.label}", "{asked.label}")'
        )
    return (
        f"the order of {first.label} and {second.label} in phase {first.phase.name} is ambiguous"
        + ("" if brief else f": both touch {shared.__name__} and one of them writes it")
        + (", and their orders by components cancel out" if cancelled else "")
        + f". {cure}"
    )


def _conflict(first: System, second: System) -> type[Component] | None:
    """Return a component for which the order of two systems matters; None if it does not matter."""
    for one in first.access:
        for two in second.access:
            if (one.kind, two.kind) not in CONFLICTS and (two.kind, one.kind) not in CONFLICTS:
                continue
            for component in one.components:
                if component in two.components:
                    here, there = _fields(first, component), _fields(second, component)
                    if not (here and there) or here & there:
                        return component
    return None


def _fields(system: System, component: type[Component]) -> set[str]:
    """Return the names of a system's Offsets into an observation: it touches only these fields.

    Empty: it touches all fields.
    """
    return {name for (owner, _), names in system.offsets().items() if owner is component for name in names}
