"""Scenarios as JSON: the form of the files that `Scenario.save` writes."""

from collections.abc import Mapping, Sequence
from typing import Any

from outlast.ecs import Module
from outlast.ecs.checks.code_hash import full_name

from ..errors import ScenarioError
from ..storage import strict_json
from . import varying_json
from .derivation import leaders
from .mechanics import imported_code, rebuilt_mechanics
from .varying_json import plain, restored

VERSION = 1
NEEDED = ("version", "name", "about", "modules", "numbers", "order")
OPTIONAL = ("origin", "added", "policies", *varying_json.KEYS)
MOST = 2.0**128  # numbers are smaller than this


def as_form(scenario: Any) -> dict[str, Any]:
    """Return the whole scenario, with mechanics by the full names of their classes.

    It includes what the scenario was derived from ("origin"), and what "added" mechanics began with: these determine
    which numbers follow others, and how derived scenarios are called.
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

    Raises:
        ScenarioError, NumberError: The scenario is not possible.
        KeyError, TypeError, AttributeError: It is something else.
    """
    strict_json.check_version(form, VERSION)
    strict_json.check_keys(form, NEEDED, OPTIONAL)
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
    """Return the function of that full name. Raises ScenarioError if its module is not imported."""
    if (found := imported_code(name)) is None:
        raise ScenarioError(
            f"the policy {name:.200} is not imported, as nothing that a file names is: import it first, as by --import "
            "FILE.py"
        )
    return found


def added(form: Mapping[str, Any], modules: Sequence[Module]) -> dict[str, tuple[Any, Any]]:
    """Return what "added" mechanics began with: by name, a number that follows another one, and that other one.

    Raises:
        ScenarioError: Such a number does not follow another one, or cannot be scaled.
    """
    found, following = {}, leaders(modules)
    for name, pair in form.get("added", {}).items():
        value, leader = pair if isinstance(pair, list) and len(pair) == 2 else (pair, None)
        values = tuple(value) if isinstance(value, list) else (value,)
        if name not in following or not all(map(_is_finite, (leader, *values))):
            raise ScenarioError(f"added {name} = {pair!r:.60} is not a number and the one that it follows")
        found[name] = (values if isinstance(value, list) else value), leader
    return found


def _is_finite(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < MOST
