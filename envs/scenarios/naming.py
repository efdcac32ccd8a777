"""What a user names where a scenario is asked for. What files say is never named here, as naming may import."""

import difflib
import re
from collections.abc import Iterable, Mapping

from ..errors import ScenarioError
from .ablations import ablated
from .imports import scenario_in_file, scenario_in_module
from .plugins import installed, scenario_of_package
from .scenario import Number, Scenario
from .variants import ALIASES, VARIANTS, variant

NAME = re.compile(r"(?P<place>.+\.py|[^:+]*)(:(?P<name>[^:+]*))?(?P<ablations>(\+[^:+]*)*)")
OWN = "one of your own is FILE.py:NAME or package.module:NAME"


def named(text: str) -> Scenario:
    """The scenario of a name, as users give it.

    Args:
        text: "teams_2", a variant; "FILE.py:NAME" or "package.module:NAME", a Scenario, or a function without arguments
            that returns one, in a file or module, which is imported; "FILE.py", the only Scenario in it; or the name of
            an installed package's scenario. Each may be followed by ablations, as in "teams_2+health_cap".

    Raises:
        ScenarioError: There is no such scenario, an ablation does not fit it, or what is imported raises an exception.
    """
    match = NAME.fullmatch(text)
    if match is None:
        raise ScenarioError(f"{text!r} is no name of a scenario; {OWN}")
    place, name = match["place"], match["name"]
    ablations = match["ablations"].split("+")[1:]
    if place.endswith(".py"):
        found = scenario_in_file(place, name or "")
    elif name is not None:
        found = scenario_in_module(place, name)
    elif place in installed():
        found = scenario_of_package(installed()[place])
    elif place in VARIANTS or place in ALIASES:
        return variant(text)
    else:
        known = [*VARIANTS, *ALIASES, *installed()]
        near = difflib.get_close_matches(place, known, 2)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise ScenarioError(f"there is no variant '{place}'; {hint}known: {', '.join(known)}; {OWN}")
    return ablated(found, ablations) if ablations else found


def resolve(
    scenario: Scenario | str, numbers: Mapping[str, Number] | None = None, options: Iterable[str] = ()
) -> Scenario:
    """The scenario that a function was asked for: its name or itself, with other numbers.

    Args:
        scenario: A name, see `named`, or a Scenario.
        numbers: Numbers to change, as `Scenario.replace` takes them; what a factory got as `**numbers`.
        options: Names of the function's own keywords, so that "thread" is answered with "did you mean threads?".

    Raises:
        ScenarioError: `scenario` is neither, or there is no such scenario.
        NumberError: A number that the scenario does not have, or a value that is out of its range.
    """
    if isinstance(scenario, str):
        scenario = named(scenario)
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"{scenario!r}: a Scenario or the name of one is needed; {OWN}")
    if not numbers:
        return scenario
    for name in numbers:
        scenario.find_number(name, options)
    return scenario.replace(**numbers)
