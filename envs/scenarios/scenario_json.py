"""Scenarios as JSON: the form of the files that `Scenario.save` writes; in fingerprints, some of it is the same.

Mechanics have the full names of their classes. Nothing that a file names is imported.
"""

import dataclasses
import functools
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from outlast import systems
from outlast.ecs import Distribution, Module, NumberError, Role, Roles, role
from outlast.ecs.checks.code_hash import full_name
from outlast.ecs.declarations import distributions
from outlast.ecs.declarations.distributions import NAMES
from outlast.ecs.declarations.roles import LONGEST
from outlast.ecs.kernels.errors import did_you_mean
from outlast.ecs.memory.numbers import checked_roles, place
from outlast.systems import hide_and_seek

from ..errors import ScenarioError
from ..storage import inputs
from .derivation import leaders

VERSION = 1
NEEDED = ("version", "name", "about", "modules", "numbers", "order")
OPTIONAL = ("origin", "added", "policies", "varied", "observed", "roles")
MOST = 2.0**128  # numbers are smaller than this
KNOWN: dict[str, type[Module]] = {
    full_name(kind): kind
    for package in (systems, hide_and_seek)
    for kind in (getattr(package, name) for name in package.__all__)
}


def as_form(scenario: Any) -> dict[str, Any]:
    """Return the scenario, with its "origin" and what "added" mechanics began with.

    These determine which numbers follow others, and how derived scenarios are called.
    """
    form = {
        "version": VERSION,
        "name": scenario.name,
        "about": scenario.about,
        "modules": [full_name(type(module)) for module in scenario.modules],
        "numbers": scenario.numbers(),
        "order": scenario.order,
    }
    if scenario.origin:
        form["origin"] = as_form(scenario.origin)
    if scenario.policies:
        form["policies"] = {name: full_name(policy) for name, policy in scenario.policies}
    if scenario.added:
        form["added"] = dict(scenario.added)
    return form | plain(scenario)


def arguments(form: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments for `Scenario` from the result of `as_form`.

    Raises ScenarioError or NumberError if it is not possible; KeyError, TypeError, AttributeError for anything else.
    """
    inputs.check_version(form, VERSION)
    inputs.check_keys(form, NEEDED, OPTIONAL)
    name, about, names, order = form["name"], form["about"], form["modules"], form["order"]
    texts = [name, about, *names, *(label for chain in order for label in chain)]
    if not all(isinstance(each, str) and each.isprintable() for each in texts):
        raise ScenarioError("its names cannot be")
    modules = rebuilt_mechanics(names, dict(form["numbers"].items()))
    return {
        "name": name,
        "about": about,
        "modules": modules,
        "order": tuple(map(tuple, order)),
        "policies": {key: _policy(each) for key, each in form.get("policies", {}).items()},
        **restored(modules, form),
    }


def _policy(name: Any) -> Any:
    if (found := imported_code(name)) is None:
        why = "is not imported, as nothing that a file names is: import it first, as by --import FILE.py"
        raise ScenarioError(f"the policy {name:.200} {why}")
    return found


def added(form: Mapping[str, Any], modules: Sequence[Module]) -> dict[str, tuple[Any, Any]]:
    """Return what "added" mechanics began with: by name, a number that follows another one, and that other one.

    Raises ScenarioError if such a number does not follow another one, or cannot be scaled.
    """
    found, following = {}, leaders(modules)
    for name, pair in form.get("added", {}).items():
        value, leader = pair if isinstance(pair, list) and len(pair) == 2 else (pair, None)
        values = tuple(value) if isinstance(value, list) else (value,)
        finite = all(isinstance(each, int | float) and abs(each) < MOST for each in (leader, *values))
        if name not in following or not finite:
            raise ScenarioError(f"added {name} = {pair!r:.60} is not a number and the one that it follows")
        found[name] = (values if isinstance(value, list) else value), leader
    return found


def plain(scenario: Any) -> dict[str, Any]:
    """Return the differences as JSON, without entries that would be empty.

    "varied": what numbers are drawn from: by name, the name of a distribution and its values. "observed": which of them
    agents observe. "roles": see `plain_roles`.
    """
    found: dict[str, Any] = {
        "varied": {name: plain_distribution(drawn) for name, drawn in scenario.varied},
        "observed": list(scenario.observed),
        "roles": plain_roles(scenario.by_role) if scenario.by_role else {},
    }
    return {key: value for key, value in found.items() if value}


def same_for_all(scenario: Any) -> dict[str, Any]:
    """Return the numbers with one value in all worlds, and for all agents whose role does not set another one."""
    differing = {name for name, _ in scenario.varied} | {*(scenario.by_role.in_all if scenario.by_role else ())}
    return {name: value for name, value in scenario.numbers().items() if name not in differing}


def restored(modules: Sequence[Module], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of `plain` as arguments for a Scenario of these mechanics. NumberError, ScenarioError."""
    varied = {name: distribution_of(*entry) for name, entry in given.get("varied", {}).items()}
    place(list(modules), varied)
    observed = tuple(given.get("observed", ()))
    if len({*observed}) < len(observed):
        raise ScenarioError(f"{', '.join(observed)}: a number is observed twice there")
    if missing := {*observed} - varied.keys():
        raise ScenarioError(f"the number {min(missing)} is observed there, and does not vary")
    by_role = checked_roles(modules, roles_of(given["roles"])) if "roles" in given else None
    return {"varied": tuple(sorted(varied.items())), "observed": observed, "by_role": by_role}


def plain_distribution(distribution: Distribution) -> list[Any]:
    """Return a distribution as JSON: the name of its kind, and its values."""
    return [NAMES[distribution.kind], *(list(v) if isinstance(v, tuple) else v for v in distribution.values)]


def distribution_of(name: Any, *values: Any) -> Distribution:
    """Return the distribution from the result of `plain_distribution`. NumberError if it is not possible."""
    makers: dict[str, Callable[..., Distribution]] = {each: getattr(distributions, each) for each in NAMES}
    made, counts = makers.get(str(name)), {"choice": len(values), "free": 1}
    if made is None or len(values) != counts.get(str(name), 2):
        hint = did_you_mean(name, makers, after=" ", count=1, cutoff=0.75) if made is None else ""
        raise NumberError(
            f"{[name, *values]!r:.80} is not a distribution: {hint}uniform(low, high), log_uniform(low, high), "
            "integers(low, high), choice(value, value, ...) or free(value) is needed"
        )
    return made(*values)


def plain_roles(roles: Roles) -> dict[str, Any]:
    """Return roles as JSON: {"drawn": ..., "roles": [{"name", "count" or "agents", "numbers": {name: value}}]}.

    A distribution becomes a list that begins with the name of its kind: ["uniform", low, high].
    """
    return {"drawn": roles.drawn, "roles": [_plain_role(each) for each in roles.roles]}


def _plain_role(own: Role) -> dict[str, Any]:
    who: dict[str, Any] = {"agents": list(own.agents)} if own.agents else {"count": own.count}
    numbers = {
        name: plain_distribution(value) if isinstance(value, Distribution) else value for name, value in own.numbers
    }
    return {"name": own.name, **who, "numbers": numbers} | ({"without": [*own.without]} if own.without else {})


def roles_of(given: Any) -> Roles:
    """Return the roles from the result of `plain_roles`. NumberError for anything else."""
    if not isinstance(given, Mapping) or given.keys() != {"drawn", "roles"} or not isinstance(given["roles"], list):
        raise NumberError(f'roles: {given!r:.80} is not {{"drawn": ..., "roles": [...]}}')
    return Roles(tuple(map(_role_of, given["roles"][: LONGEST + 1])), given["drawn"])


def _role_of(given: Any) -> Role:
    if (
        not isinstance(given, Mapping)
        or given.keys() - {"count", "without"} not in ({"name", "numbers"}, {"name", "agents", "numbers"})
        or {"count", "agents"} <= given.keys()
        or not isinstance(given["name"], str)
        or not isinstance(given["numbers"], Mapping)
        or not all(isinstance(given.get(key, []), list) for key in ("agents", "without"))
    ):
        raise NumberError(
            f'roles: {given!r:.80} is not {{"name": ..., "count" or "agents": ..., "numbers": {{...}}}}; only one role '
            "can leave out who has it, and gets the agents that are left"
        )
    numbers = {
        str(name): distribution_of(*value) if isinstance(value, list) else value
        for name, value in given["numbers"].items()
    }
    found = role(given.get("count"), agents=given.get("agents", ()), without=given.get("without", ()))
    return dataclasses.replace(found, name=given["name"], numbers=tuple(sorted(numbers.items())))


def foreign(names: Iterable[str]) -> list[str]:
    """Return the full names among these that are not classes of outlast's own mechanics."""
    return [name for name in names if name not in KNOWN]


def imported() -> dict[str, type[Module]]:
    """Return all mechanics of this process by full name: outlast's own, and those of the user's that are imported."""
    found: dict[str, type[Module]] = {}
    for kind in Module.imported()[1:]:
        module, before = sys.modules.get(kind.__module__), found.get(full_name(kind))
        if module is not None and (before is None or getattr(module, kind.__name__, None) is not before):
            # if a file was imported several times: the class that is in the module now, or else the last one
            found[full_name(kind)] = kind
    return found | KNOWN


def imported_code(name: str) -> Any:
    """Return the function or class of that full name, if its module is imported; else None. Nothing is imported."""
    parts = name.split(".")
    for k in range(len(parts) - 1, 0, -1):
        found: Any = sys.modules.get(".".join(parts[:k]))
        if found is not None:
            return functools.reduce(lambda within, part: getattr(within, part, None), parts[k:], found)
    return None


def rebuilt_mechanics(names: Iterable[str], numbers: Mapping[str, Any], strict: bool = True) -> tuple[Module, ...]:
    """Make mechanics of these classes, which this process must have imported, with these numbers by full name.

    strict: Whether exactly these numbers must exist. If not, missing numbers get their defaults, and unknown ones,
    which other versions of outlast may have, are ignored. Raises ScenarioError; NumberError for a value.
    """
    left, made, known = dict(numbers), [], imported()
    for name in names:
        if name not in known and name.startswith("__main__."):
            raise ScenarioError(
                f"the mechanic {name.removeprefix('__main__.')} was defined by the script or notebook that saved this; "
                "define it in a file of its own, import it from there, and save again"
            )
        if name not in known:
            raise ScenarioError(
                f"the mechanic {name} is not one of outlast's own, and what a file names is not imported: import it "
                "first, or name what has it, as in --import FILE.py or scenario=..."
            )
        kind = known[name]
        own = {item.name: f"{kind.name}_{item.name}" for item in dataclasses.fields(kind)}
        if strict and (missing := [full for full in own.values() if full not in left]):
            raise ScenarioError(f"the number {missing[0]} is missing; was it made by another version of outlast?")
        made.append(kind(**{item: left.pop(full) for item, full in own.items() if full in left}))
    if strict and left:
        raise ScenarioError(f"unknown number {next(iter(left))}; was it made by another version of outlast?")
    return tuple(made)
