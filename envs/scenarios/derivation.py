"""Changes that derive a scenario: names and sentences for them, and numbers that follow other numbers."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from outlast.ecs import Distribution, Module, NumberError, Roles
from outlast.ecs.declarations.distributions import CHOICE, FREE, INTEGERS, LOG_UNIFORM

LONGEST = 60  # characters of all changes in a name (a hash stands for the rest), and of one change in a sentence


def changes(before: Sequence[Module], after: Sequence[Module], began: Mapping[str, Any]) -> list[str]:
    """Return in words and by name what is different: "without boxes", "with swamp", "melee_damage=20".

    That includes numbers of new mechanics that differ from their defaults, but not those that only follow others.
    began: The numbers of the first scenario of all, which decide what follows what; see `following`.
    """
    there, here = ({module.slot(): type(module) for module in modules} for modules in (before, after))
    new = [module for module in after if there.get(module.slot()) is not type(module)]
    usual = numbers(before) | {f"{m.name}_{item.name}": item.default for m in new for item in dataclasses.fields(m)}
    now = numbers(after)
    leading = {*leaders(after).values()}
    led = following(before, {**usual, **began}, {name: value for name, value in now.items() if name in leading})
    usual |= {name: value for name, (_, value) in led.items()}
    found = [f"without {module.name}" for module in before if module.slot() not in here]
    found += [f"with {module.name}" for module in new]
    return found + [f"{_short(name)}={shown(value)}" for name, value in now.items() if value != usual[name]]


def in_full(name: str) -> str:
    """Return the name of the number that n_NAME stands for; other names as they are."""
    return f"{name[2:]}_count" if name.startswith("n_") else name


def by_full_name(find: Callable[[str], tuple[str, str]], given: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return values by the numbers' full names ("agents_count"). find: Scenario.find_number.

    Raises NumberError if a number is unknown or given twice, such as by two of its names.
    """
    found = dict[str, Any]()
    for name, value in given:
        if (full := "_".join(find(str(name)))) in found:
            raise NumberError(f"{full} is given twice; remove one of them")
        found[full] = value
    return found


def defaults(modules: Iterable[Module]) -> set[str]:
    """Return the full names of the numbers that have their default value in these mechanics, whether set or not."""
    fields = [(module, item) for module in modules for item in dataclasses.fields(module)]
    return {f"{m.name}_{item.name}" for m, item in fields if getattr(m, item.name) == item.default}


def numbers(modules: Iterable[Module]) -> dict[str, Any]:
    """Return every number of these mechanics by its full name, sorted by mechanics."""
    ordered = sorted(modules, key=lambda module: module.name)
    return {f"{m.name}_{item.name}": getattr(m, item.name) for m in ordered for item in dataclasses.fields(m)}


def all_replaced(modules: Iterable[Module], given: Mapping[tuple[str, str], Any]) -> tuple[Module, ...]:
    """Return copies with other numbers, which are given by names of mechanic and number."""
    return tuple(
        _replaced(module, {name: value for (own, name), value in given.items() if own == module.name})
        for module in modules
    )


def _replaced(module: Module, given: dict[str, Any]) -> Module:
    """Return a copy with other numbers; the error for a count of 0 names the cure."""
    try:
        return module.replace(**given)
    except NumberError as error:
        count = given.get("count")
        if isinstance(count, int) and count == 0 and module.name != "agents":
            cure = f"--without {module.name}, or Scenario.without({module.name!r})"
            raise NumberError(f"{error}; for none, leave it out: {cure}") from None
        raise


def titles(origin: Any, made: Any) -> tuple[str, str]:
    """Return the name and the sentence (`about`) of a scenario derived from another one, whose name it extends."""
    root, name = origin.root, derived_name(origin.name, differing(origin, made, short=True))
    return name, derived_about(root.about, differing(root, made, short=False))


def differing(origin: Any, made: Any, short: bool) -> list[str]:
    """Return the changes of a derived scenario, as typed or, if `short`, for a name: "n_agents=2..6"."""
    changed = changes(origin.modules, made.modules, origin.root.numbers())
    changed += [f"ordered {' '.join(chain)}" for chain in made.order if chain not in origin.order]
    # other changes of drawn numbers have no effect, so they are not mentioned
    drawn_anew = {_short(name) for name, _ in made.varied}
    found = [each for each in changed if each.partition("=")[0] not in drawn_anew]
    for name, drawn in made.varied:
        if (name, drawn) not in origin.varied:
            found.append(f"{_short(name)}={_drawn_from(drawn) if short else drawn}")
    if made.observed != origin.observed:
        found.append(f"observed {' '.join(map(_short, made.observed)) or 'no numbers'}")
    if made.by_role and made.by_role != origin.by_role:
        shown = "" if "with observe_roles" in found else " unobserved"
        roles = _roles(made.by_role) if short else made.by_role
        found = [each for each in found if each != "with observe_roles"] + [f"roles {roles}{shown}"]
    return found


def _drawn_from(drawn: Distribution) -> str:
    """Return a distinct text for each distribution: "2..6", "0.5..2.0", "log_0.1..10.0", "1_or_3", "free_1"."""
    if drawn.kind in (CHOICE, FREE):
        return "free_" * (drawn.kind == FREE) + "_or_".join(map(shown, drawn.values))
    low, high = (str(value) if drawn.kind == INTEGERS else repr(float(value)) for value in drawn.values)
    return f"{'log_' * (drawn.kind == LOG_UNIFORM)}{low}..{high}"


def _roles(roles: Roles) -> str:
    """Return roles in words, for a name, with the numbers that they change."""
    numbers = [
        f"{role.name} {_short(name)}={_drawn_from(value) if isinstance(value, Distribution) else shown(value)}"
        for role in roles.roles
        for name, value in role.numbers
    ]
    ids = [f"{role.name} {role.agents}" for role in roles.roles if role.agents]
    return " ".join([str(roles), *ids, *numbers])


def _short(name: str) -> str:
    """Return a number's short name: n_agents for agents_count."""
    return f"n_{name.removesuffix('_count')}" if name.endswith("_count") else name


def shown(value: Any) -> str:
    """Return a number as it is typed after --set."""
    if isinstance(value, tuple):
        return ",".join(map(shown, value))
    return repr(value).removesuffix(".0") if isinstance(value, float) else str(value)


def derived_name(name: str, changed: Sequence[str]) -> str:
    """Return a scenario's name with its changes, "teams_3-without_boxes-n_agents=6"; unique for each set of changes."""
    suffix = as_filename("".join(f"-{each}" for each in changed))
    if len(suffix) > LONGEST:
        suffix = f"{suffix[: LONGEST - 9]}-{hashlib.sha256(suffix.encode()).hexdigest()[:8]}"
    return name + suffix


def derived_about(about: str, changed: Sequence[str]) -> str:
    """Return a scenario's sentence (`about`) with its changes."""
    short = [each if len(each) <= LONGEST else f"{each[: LONGEST - 3]}..." for each in changed]
    return "; ".join(filter(None, (about, f"changed: {', '.join(short)}" if changed else "")))


def as_filename(text: str) -> str:
    """Return the text as a possible file name: all but letters, digits and ._,=+- are replaced."""
    return re.sub(r"[^\w.,=+-]", "_", text)


def following(
    modules: Sequence[Module],
    origin: Mapping[str, Any],
    given: Mapping[str, Any],
    added: Mapping[str, tuple[Any, Any]] = MappingProxyType({}),
) -> dict[str, tuple[str, Any]]:
    """Return the numbers that change in proportion to given ones, as declared by `scales_with` of ecs.number.

    A number only follows another one while it has, in proportion, the value with which the scenario began: not if it
    has been set explicitly, nor if it began as 0. Other numbers may follow it in turn.

    Args:
        modules: The mechanics with their present numbers.
        origin: All numbers with which the scenario began.
        given: New numbers.
        added: For mechanics that were added later, the number and the one that it follows, at that time.

    All are by full name. So are the results: the number that it follows, and its new value.
    """
    now, values = numbers(modules), dict(given)
    found, known = dict[str, tuple[str, Any]](), 0
    while len(values) > known:
        known = len(values)
        for name, leader in leaders(modules).items():
            if leader not in values or name in values or leader not in now:
                continue
            if {name, leader} <= origin.keys():
                first = origin[name], origin[leader]
            elif name in added:
                first = added[name]
            else:
                continue
            if first[1] and now[name] == _scaled(*first, now[leader]):
                values[name] = _scaled(*first, values[leader])
                found[name] = leader, values[name]
    return found


def leaders(modules: Sequence[Module]) -> dict[str, str]:
    """Return the numbers that scale with another one, by full name, and the number that each scales with."""
    items = ((f"{module.name}_{item.name}", item) for module in modules for item in dataclasses.fields(module))
    return {name: item.metadata["scales_with"] for name, item in items if item.metadata.get("scales_with")}


def _scaled(value: Any, old: float, new: float) -> Any:
    if isinstance(value, tuple):
        return tuple(_scaled(each, old, new) for each in value)
    return value / old * new  # in this order half of the room stays exactly half of it
