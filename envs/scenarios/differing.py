"""What differs between the worlds and the agents of a scenario, as JSON has it in files and fingerprints."""

from collections.abc import Mapping, Sequence
from typing import Any

from outlast.ecs import Module, distributions, roles
from outlast.ecs.per_agent import checked_roles
from outlast.ecs.varied import place

from ..errors import ScenarioError

KEYS = ("varied", "observed", "roles")


def plain(scenario: Any) -> dict[str, Any]:
    """Of each only what there is.

    "varied": what numbers are drawn from: by name, the name of a distribution and its values. "observed": which of them
    agents observe. "roles": see ecs.roles.plain.
    """
    found: dict[str, Any] = {
        "varied": {name: distributions.plain(drawn) for name, drawn in scenario.varied},
        "observed": list(scenario.observed),
        "roles": roles.plain(scenario.by_role) if scenario.by_role else {},
    }
    return {key: value for key, value in found.items() if value}


def same_for_all(scenario: Any) -> dict[str, Any]:
    """The numbers that are one value, in all worlds and for all agents that have no other one by their role."""
    differing = {name for name, _ in scenario.varied} | {*(scenario.by_role.in_all if scenario.by_role else ())}
    return {name: value for name, value in scenario.numbers().items() if name not in differing}


def restored(modules: Sequence[Module], given: Mapping[str, Any]) -> dict[str, Any]:
    """What `plain` made, as arguments of a Scenario of these mechanics.

    Raises:
        NumberError: A number that cannot vary or differ in that way.
        ScenarioError: Numbers are observed that do not vary.
    """
    varied = {name: distributions.from_plain(*entry) for name, entry in given.get("varied", {}).items()}
    place(list(modules), varied)
    observed = tuple(given.get("observed", ()))
    if len({*observed}) < len(observed):
        raise ScenarioError(f"{', '.join(observed)}: a number is observed twice there")
    if missing := {*observed} - varied.keys():
        raise ScenarioError(f"the number {min(missing)} is observed there, and does not vary")
    by_role = checked_roles(modules, roles.from_plain(given["roles"])) if "roles" in given else None
    return {"varied": tuple(sorted(varied.items())), "observed": observed, "by_role": by_role}
