"""What differs between the worlds, and between the agents, of a scenario, as JSON for files and fingerprints."""

from collections.abc import Mapping, Sequence
from typing import Any

from outlast.ecs import Module
from outlast.ecs.declarations import distributions, roles
from outlast.ecs.memory.numbers import checked_roles, place

from ..errors import ScenarioError

KEYS = ("varied", "observed", "roles")


def plain(scenario: Any) -> dict[str, Any]:
    """Return the differences as JSON, without entries that would be empty.

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
    """Return the numbers with one value in all worlds, and for all agents whose role does not set another one."""
    differing = {name for name, _ in scenario.varied} | {*(scenario.by_role.in_all if scenario.by_role else ())}
    return {name: value for name, value in scenario.numbers().items() if name not in differing}


def restored(modules: Sequence[Module], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of `plain` as arguments for a Scenario of these mechanics.

    Raises:
        NumberError: A number cannot vary or differ in that way.
        ScenarioError: A number is observed twice, or does not vary.
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
