"""Identity of a game in files: the scenario's name, numbers and order, and the code of users' mechanics.

A fingerprint and the names of the classes of its mechanics make the scenario again.
"""

import json
from collections.abc import Iterator
from typing import Any

from outlast.ecs import MemoryLayout
from outlast.ecs.checks.code_hash import PYTHON, code_digest, full_name
from outlast.ecs.kernels.frozen_values import is_outside

from ..errors import ScenarioError
from .scenario import Scenario
from .scenario_json import plain, rebuilt_mechanics, restored

LARGEST = 2**22  # bytes of the state of one world at most
LONGEST = 200  # characters of a name or another word at most
DEEPEST = 8  # lists and objects within each other
KINDS = {"numbers": dict, "code": dict, "order": list, "varied": dict, "observed": list, "roles": dict}
MORE = {  # optional entries of a fingerprint, and their meanings
    "varied": "what numbers are drawn from",
    "observed": "which numbers are observed",
    "roles": "who has which role",
}


def fingerprint(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario's name and numbers as JSON. The name lacks characters that cannot be shown in a line.

    For a derived scenario it is the name of its root, and the "label" is its own. If there is any, the fingerprint also
    has "order", the chains of `Scenario.ordered`; "code", for mechanics that are not outlast's own: by name, the full
    name of the class, the version of Python and the hash of its code; and the entries of `scenario_json.plain`.
    """
    numbers: dict[str, Any] = json.loads(json.dumps(scenario.numbers()))
    name, label = (
        "".join(letter if letter.isprintable() else "?" for letter in each.name[:LONGEST])
        for each in (scenario.root, scenario)
    )
    users = [module for module in scenario.modules if is_outside(type(module))]
    more = {
        "label": label if label != name else "",
        "order": [list(chain) for chain in scenario.order],
        "code": {each.name: [full_name(type(each))[:LONGEST], PYTHON, code_digest(each)] for each in users},
    }
    return {"name": name, "numbers": numbers} | {key: value for key, value in more.items() if value} | plain(scenario)


def is_fingerprint(given: Any) -> bool:
    """Return whether it could be one: a name, and entries of the right kinds that hold numbers and words only."""
    return (
        isinstance(given, dict)
        and {"name", "numbers"} <= given.keys()
        and all(is_word(given.get(key, "")) for key in ("name", "label"))
        and all(isinstance(given.get(key, kind()), kind) for key, kind in KINDS.items())
        and all(isinstance(entry, list) and len(entry) == 3 for entry in given.get("code", {}).values())
        and _is_plain(given)
    )


def _is_plain(given: Any, depth: int = DEEPEST) -> bool:
    """Return whether it is a number, a word or nothing, or a list or an object of such."""
    if isinstance(given, dict):
        return all(map(is_word, given)) and _is_plain([*given.values()], depth)
    if isinstance(given, list):
        return depth > 0 and all(_is_plain(each, depth - 1) for each in given)
    return given is None or isinstance(given, int | float) or is_word(given)


def is_word(given: Any) -> bool:
    """Return whether it is a text that can be shown in a line."""
    return isinstance(given, str) and len(given) <= LONGEST and given.isprintable()


def difference(given: Any, own: dict[str, Any]) -> str:
    """Return the name in that fingerprint and its first difference from the own one; "" without a difference."""
    if not is_fingerprint(given):
        return "(it does not name one)"
    found = next(_differences(given, own), "")
    return found and f"({given['name']!r}): {found}"


def _differences(given: dict[str, Any], own: dict[str, Any]) -> Iterator[str]:
    numbers = given["numbers"]
    for key in sorted(own["numbers"].keys() | numbers.keys()):
        mine, its = own["numbers"].get(key, "not there"), numbers.get(key, "not there")
        if mine != its:
            yield f"{key} is {its} there and {mine} here"
    code, other = own.get("code", {}), given.get("code", {})
    for name in sorted(code.keys() | other.keys()):
        yield from _code_differences(name, other.get(name), code.get(name))
    for key, about in MORE.items():
        if given.get(key) != own.get(key):
            yield f"{about} is {given.get(key, 'nothing')} there and {own.get(key, 'nothing')} here"
    if given.get("order", []) != own.get("order", []):
        yield f"the order of systems is {given.get('order', [])} there and {own.get('order', [])} here"


def _code_differences(name: str, its: list[str] | None, mine: list[str] | None) -> Iterator[str]:
    if its is None or mine is None:
        where, other, (kind, *_) = ("here", "there", mine or [""]) if its is None else ("there", "here", its)
        yield f"{where} the mechanic {name} is {kind}; {other}, nothing is known of its code"
    elif its[0] != mine[0]:
        yield f"the mechanic {name} is {its[0]} there and {mine[0]} here"
    elif its[1] != mine[1]:
        yield f"the code of {name} ({mine[0]}) was Python {its[1]}'s there, and not comparable to {mine[1]}'s here"
    elif its[2] != mine[2]:
        yield f"the code of the mechanic {name} ({mine[0]}) is another one there than here"


def classes(scenario: Scenario) -> list[str]:
    """Return the full names of the classes of its modules, in order."""
    return sorted(full_name(type(module)) for module in scenario.modules)


def rebuilt(fingerprint: dict[str, Any], names: list[str], strict: bool = True) -> Scenario:
    """Make the scenario of a fingerprint and the full names of its classes. Raises ScenarioError, NumberError."""
    modules = rebuilt_mechanics(sorted(names), fingerprint["numbers"], strict)
    name = str(fingerprint.get("label") or fingerprint["name"])
    try:
        order = tuple(map(tuple, fingerprint.get("order", ())))
        return Scenario(name, modules, order=order, **restored(modules, fingerprint))
    except TypeError as error:
        raise ScenarioError(f"its entries cannot be: {error}") from error


def planned(scenario: Scenario) -> tuple[int, int]:
    """Return how many agents a world has, and how many bytes it takes, while allocating next to nothing.

    Raises ScenarioError if a world is absurdly large or has no agents, and the errors of MemoryLayout.
    """
    layout = MemoryLayout(scenario.modules, dict(scenario.varied), scenario.observed, scenario.by_role)
    if "agents" not in layout.dims:
        raise ScenarioError("it has no agents")
    if layout.world_bytes > LARGEST:
        raise ScenarioError(f"a world would have {layout.world_bytes} bytes of state: at most {LARGEST} is possible")
    beside = sum(place.nbytes for place in layout.places if place.offset < 0)
    return layout.dims["agents"], layout.world_bytes + beside
