"""The errors for two systems without an order: why there is none, and what to write on which of them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from ..declarations.component import Component
from ..declarations.system import System

CONFLICTS = {("read", "write"), ("read", "add"), ("add", "write"), ("write", "write")}


class Reason(NamedTuple):
    """A component in after= or before= of the system `asking`, by which `other` runs before or after it."""

    asking: System
    other: System
    keyword: str
    component: type[Component]


Reasons = Mapping[tuple[str, str], Sequence[Reason]]
"""By labels of the first and the second of two systems of a phase, what orders them so."""


def reasons_of(systems: Sequence[System]) -> Reasons:
    """Return the orders that components in after= and before= ask for."""
    found = dict[tuple[str, str], list[Reason]]()
    for asking in systems:
        for other in (each for each in systems if each is not asking):
            for keyword, given in (("after", asking.after), ("before", asking.before)):
                pair = (other.label, asking.label) if keyword == "after" else (asking.label, other.label)
                kinds = ("write", "add") if keyword == "after" else ("read", "write", "add")
                for component in (each for each in given if not isinstance(each, str)):
                    if other.touches(component, *kinds):
                        found.setdefault(pair, []).append(Reason(asking, other, keyword, component))
    return found


def ambiguity(first: System, second: System, reasons: Reasons, brief: bool) -> str:
    """Return the error for two systems that need an order and have none; "" if they need none.

    Args:
        first: A system.
        second: Another one of the same phase.
        reasons: What `reasons_of` returns for the phase.
        brief: Whether another error comes before, which has what can be done in general.
    """
    if (shared := conflict(first, second)) is None:
        return ""
    asked, other = (first, second) if first.outside and not second.outside else (second, first)
    there, back = (reasons.get(pair, ()) for pair in ((other.label, asked.label), (asked.label, other.label)))
    contrary = (*there, *back) if there and back else ()
    own, others = ([each for each in contrary if each.asking is system] for system in (asked, other))
    if own and others and asked.outside and not other.outside:  # `other` may keep a limit, as that of hit points
        where, keyword = ("last", "after") if others[0].keyword == "after" else ("first", "before")
        cure = (
            f"{other.label} is to run {where}: {_replaced(own, other, reasons)}; or add {keyword}="
            f'"{other.label}", to run {keyword} it all the same'
        )
    else:
        keyword = "after" if other.touches(shared, "write", "add") else "before"
        named = shared in (*first.after, *first.before, *second.after, *second.before)  # which is not enough
        named |= any(each.other is asked and each[2:] == (keyword, shared) for why in reasons.values() for each in why)
        cure = f'Say after="{other.label}" on {asked.label} ('
        cure += ("" if named else f"or {keyword}={shared.__name__}, ") + "or the other way round)"
        if not brief:
            cure += (
                ", put one into another phase, or declare Add where both only add; "
                f'where neither is yours, say scenario.ordered("{other.label}", "{asked.label}")'
            )
    return (
        f"the order of {first.label} and {second.label} in phase {first.phase.name} is ambiguous"
        + ("" if brief else f": both touch {shared.__name__} and one of them writes it")
        + (f", and {_said(contrary)}, which cancels out" if contrary else "")
        + f". {cure}"
    )


def _said(contrary: Sequence[Reason]) -> str:
    """Return, as a part of a message, by which after= and before= two systems are ordered both ways."""
    said = {f"{each.keyword}={each.component.__name__}": list[str]() for each in contrary}
    for each in contrary:
        said[f"{each.keyword}={each.component.__name__}"].append(each.asking.label)
    return " and ".join(
        f"both say {words}" if len({*labels}) > 1 else f"{labels[0]} says {words}" for words, labels in said.items()
    )


def _replaced(own: Sequence[Reason], other: System, reasons: Reasons) -> str:
    """Return what to write in place of the components that a system gives and that order it and `other` both ways."""
    asked, dropped = own[0].asking, {(each.keyword, each.component) for each in own}
    kept = dict[str, set[str]]()
    for pair, each in ((pair, each) for pair, found in reasons.items() for each in found if each.asking is asked):
        needed = (each.keyword, each.component) in dropped and each.other is not other and pair[::-1] not in reasons
        if needed and conflict(asked, each.other):
            kept.setdefault(each.keyword, set()).add(f'"{each.other.label}"')
    names = " and ".join(sorted(f"{keyword}={component.__name__}" for keyword, component in dropped))
    words = [
        f"{keyword}=" + (f"({', '.join(sorted(labels))})" if len(labels) > 1 else min(labels))
        for keyword, labels in kept.items()
    ]
    if not words:
        return f"leave out {names} on {asked.label}"
    return f"say {' and '.join(words)} on {asked.label} in place of {names}"


def conflict(first: System, second: System) -> type[Component] | None:
    """Return a component for which the order of two systems matters; None if there is none."""
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
    """Names of a system's Offsets into an observation: it touches only these fields. Empty: it touches all of them."""
    return {name for (owner, _), names in system.offsets().items() if owner is component for name in names}
