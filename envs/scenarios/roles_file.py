"""Roles from a JSON file, for commands."""

import os
from typing import Any

from outlast.ecs import NumberError

from ..errors import ScenarioError
from ..storage import strict_json
from ..storage.limited_read import read_text
from .scenario import Scenario
from .varying_json import roles_of

FORM = '{"drawn": "never", "roles": [{"name": "hunter", "count": 1, "numbers": {"melee_damage": 20}}, ...]}'


def with_roles(scenario: Scenario, path: str | os.PathLike[str]) -> Scenario:
    """Return the scenario with the roles in a file, which has the form FORM; see varying_json.plain_roles.

    Raises:
        ScenarioError: The file cannot be read, or is something else.
        NumberError: The roles are not possible in this scenario.
    """
    name = os.fspath(path)
    try:
        given = strict_json.parse(read_text(path))
        found = roles_of(given)
    except OSError as error:
        raise ScenarioError(f"{name} cannot be read: {error.strerror}") from error
    except strict_json.BROKEN as error:
        said = f"{error}; " if isinstance(error, ValueError) else ""
        raise ScenarioError(f"{name} does not say roles: {said}as in {FORM}") from error
    try:
        named: Any = {each.name: each for each in found.roles}
        return scenario.roles(drawn=found.drawn, **named)
    except NumberError as error:
        raise NumberError(f"{name}: {error}") from None
