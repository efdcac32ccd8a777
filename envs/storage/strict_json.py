"""JSON files written by people: input that would be misread raises an error."""

import json
from collections.abc import Collection
from typing import Any

from ..errors import ScenarioError

# The errors that reading JSON of another form may raise: they are about the file, not about this process.
BROKEN = (ValueError, KeyError, TypeError, AttributeError, RecursionError, MemoryError)


def parse(text: str) -> Any:
    """Return what the text holds. Raises ValueError: not JSON, a number too long, or a name twice in an object."""

    def once(items: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict[str, Any]()
        for name, value in items:
            if name in found:
                raise ScenarioError(f"it has {name!r:.60} twice")
            found[name] = value
        return found

    return json.loads(text, object_pairs_hook=once)


def check_version(given: Any, version: int) -> None:
    """Raise ScenarioError unless `given` is an object with that "version"."""
    found = given.get("version") if isinstance(given, dict) else None
    if type(found) is not int or found != version:
        raise ScenarioError(f"it has version {found!r:.20} of the format: this outlast reads version {version}")


def check_keys(given: Any, needed: Collection[str], optional: Collection[str] = ()) -> None:
    """Raise ScenarioError unless `given` is an object with all needed keys, and no others except optional ones."""
    known = ", ".join((*needed, *optional))
    if not isinstance(given, dict):
        raise ScenarioError(f"it has {given!r:.60} where an object with {known} is needed")
    if missing := sorted({*needed} - given.keys()):
        raise ScenarioError(f"it lacks {missing[0]!r:.60}; its keys are {known}")
    if unknown := sorted(given.keys() - {*needed, *optional}):
        raise ScenarioError(f"it has {unknown[0]!r:.60}; its keys are {known}")
